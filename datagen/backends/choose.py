"""Which renderers are here, which is the fastest, and starting one; a renderer is imported only then."""

import importlib.util
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import Backend, BackendError
from multilight.datagen.config.dataset import RendererName

if TYPE_CHECKING:  # reading a dataset needs none of what reads meshes
    from multilight.scenes.assets.library import AssetLibrary


def has_mitsuba() -> bool:
    """Tell whether Mitsuba is installed; does not import it."""
    return importlib.util.find_spec("mitsuba") is not None


def pick_renderer() -> tuple[RendererName, str]:
    """Return the fastest renderer that runs here, and why it is that one."""
    why = "Mitsuba is not installed"
    if has_mitsuba():
        choice = choose_variant()
        if choice.variant is not None:
            return "mitsuba", choice.why
        why = f"Mitsuba cannot run: {choice.why}"
    if importlib.util.find_spec("bpy") is not None:
        return "cycles", why
    return "analytic", f"{why}, and Blender is not installed"


def resolve_renderer(wanted: str) -> RendererName:
    """Turn `auto` into the fastest renderer that runs here; raises `BackendError` where one cannot."""
    match wanted:
        case "auto":
            return pick_renderer()[0]
        case "mitsuba" if not has_mitsuba():
            raise BackendError("renderer 'mitsuba' needs the package mitsuba: pip install mitsuba")
        case "mitsuba" if choose_variant().variant is None:
            raise BackendError(
                f"renderer 'mitsuba' cannot run here, {choose_variant().why}: run `multilight doctor --fetch`, "
                "or use --renderer cycles"
            )
        case "cycles" if importlib.util.find_spec("bpy") is None:
            raise BackendError("renderer 'cycles' needs the package bpy: pip install 'bpy==4.5.*'")
        case "mitsuba" | "cycles" | "analytic":
            return wanted
        case _:
            raise BackendError(f"renderer {wanted!r} is not available; choose auto, mitsuba, cycles or analytic")


def open_backend(name: RendererName, library: "AssetLibrary") -> AbstractContextManager[Backend]:
    """Start a renderer; use as a context manager. Imports the renderer only now."""
    match name:
        case "mitsuba":
            try:
                from multilight.datagen.backends.mitsuba import MitsubaBackend
            except ImportError as error:
                raise BackendError(f"renderer 'mitsuba' cannot be loaded: {error}; see `multilight doctor`") from error
            return MitsubaBackend(library)
        case "cycles":
            try:
                from multilight.datagen.backends.blender import BlenderBackend
            except ImportError as error:
                raise BackendError(
                    f"renderer 'cycles' cannot be loaded: {error}; `make system-libraries` installs what it needs"
                ) from error
            return BlenderBackend(library)
        case "analytic":
            from multilight.datagen.backends.analytic import AnalyticBackend

            return AnalyticBackend()
