"""Renderers behind one small protocol: `render(job) -> LayerStack`."""

import importlib.util
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol

from pydantic import PositiveInt

from datagen.layers import LayerStack
from lights.spec import LightRig
from scenes.frozen import Frozen
from scenes.spec import SceneSpec

if TYPE_CHECKING:  # reading a dataset needs none of what reads meshes
    from scenes.assets.library import AssetLibrary

RendererName = Literal["mitsuba", "cycles", "analytic"]


class RenderSettings(Frozen):
    """How to render: samples a pixel (or other numbers at their cost, where that is better), path length, CPU threads
    (0: all cores)."""

    spp: PositiveInt = 16
    max_bounces: PositiveInt = 8
    threads: int = 0


@dataclass(frozen=True)
class RenderJob:
    """One variant of one view: `all`, `without_<object>` (removed for good: no shadow, no reflection),
    or `foreground_<object>` (only what the camera sees of the object, as lit in the whole scene)."""

    scene: SceneSpec
    rig: LightRig
    settings: RenderSettings
    view: int
    variant: str = "all"


class Backend(Protocol):
    """A renderer that keeps its copy of the last scene between jobs."""

    name: str

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` with the value and the remedy."""
        ...


class BackendError(RuntimeError):
    """The renderer cannot do what was asked: names the value and the remedy."""


def split_variant(scene: SceneSpec, variant: str) -> tuple[str, str | None]:
    """Split a variant into its action (`all`, `without`, `foreground`) and the object's name."""
    if variant == "all":
        return "all", None
    action, _, name = variant.partition("_")
    if action not in ("without", "foreground") or name not in scene.insertable:
        raise BackendError(
            f"variant {variant!r} is not 'all', 'without_<object>' or 'foreground_<object>' "
            f"with an object of {list(scene.insertable)}"
        )
    return action, name


def has_mitsuba() -> bool:
    """Tell whether Mitsuba and our backend for it are installed; imports neither."""
    room = importlib.util.find_spec("datagen.backends.mitsuba")
    return room is not None and room.origin is not None and importlib.util.find_spec("mitsuba") is not None


def pick_renderer() -> tuple[RendererName, str]:
    """Return the fastest renderer that is installed, and why it is that one."""
    has_cycles = importlib.util.find_spec("bpy") is not None
    if has_mitsuba():
        from datagen.backends.variants import choose_variant

        choice = choose_variant()
        if choice.variant != "scalar_rgb":
            return "mitsuba", choice.why
        if not has_cycles:
            return "mitsuba", f"{choice.why}, and no Blender"
        return "cycles", f"Mitsuba would be slower: {choice.why}"
    if has_cycles:
        return "cycles", "Blender is installed"
    return "analytic", "neither Mitsuba nor Blender is installed"


def resolve_renderer(wanted: str) -> RendererName:
    """Turn `auto` into the fastest renderer that is installed; raises `BackendError` where one is missing."""
    match wanted:
        case "auto":
            return pick_renderer()[0]
        case "mitsuba" if not has_mitsuba():
            raise BackendError("renderer 'mitsuba' needs the package mitsuba: pip install mitsuba")
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
                from datagen.backends.mitsuba import MitsubaBackend
            except ImportError as error:
                raise BackendError(f"renderer 'mitsuba' cannot be loaded: {error}; see `multilight doctor`") from error
            return MitsubaBackend(library)
        case "cycles":
            try:
                from datagen.backends.blender import BlenderBackend
            except ImportError as error:
                raise BackendError(
                    f"renderer 'cycles' cannot be loaded: {error}; `make system-libraries` installs what it needs"
                ) from error
            return BlenderBackend(library)
        case "analytic":
            from datagen.backends.analytic import AnalyticBackend

            return AnalyticBackend()
