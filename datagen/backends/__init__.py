"""Renderers behind one small protocol: `render(job) -> LayerStack`."""

import importlib.util
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal, Protocol

from pydantic import PositiveInt

from datagen.layers import LayerStack
from lights.spec import LightRig
from scenes.assets.library import AssetLibrary
from scenes.frozen import Frozen
from scenes.spec import SceneSpec

RendererName = Literal["cycles", "analytic"]


class RenderSettings(Frozen):
    """How to render: samples a pixel, path length, CPU threads (0: all cores)."""

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


def resolve_renderer(wanted: str) -> RendererName:
    """Turn `auto` into the fastest renderer that is installed; raises `BackendError` where one is missing."""
    has_cycles = importlib.util.find_spec("bpy") is not None
    match wanted:
        case "auto":
            return "cycles" if has_cycles else "analytic"
        case "cycles" if not has_cycles:
            raise BackendError("renderer 'cycles' needs the package bpy: pip install 'bpy==4.5.*'")
        case "cycles" | "analytic":
            return wanted
        case _:
            raise BackendError(f"renderer {wanted!r} is not available; choose auto, cycles or analytic")


def open_backend(name: RendererName, library: AssetLibrary) -> AbstractContextManager[Backend]:
    """Start a renderer; use as a context manager. Imports the renderer only now."""
    match name:
        case "cycles":
            try:
                from datagen.backends.blender import BlenderBackend
            except ImportError as error:
                raise BackendError(
                    f"renderer 'cycles' cannot be loaded: {error}; `make setup` installs what it needs"
                ) from error
            return BlenderBackend(library)
        case "analytic":
            from datagen.backends.analytic import AnalyticBackend

            return AnalyticBackend()
