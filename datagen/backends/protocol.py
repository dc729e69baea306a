"""What a renderer does: `render(job) -> LayerStack`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from pydantic import PositiveInt

from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.storage.object_variants import ALL, Variant, variants_of
from multilight.lights.spec import LightRig
from multilight.scenes.errors import MultilightError
from multilight.scenes.frozen import Frozen
from multilight.scenes.spec import Camera, SceneSpec

LARGE = 1 << 19
"""Pixels of a picture above which memory is saved: sums over its samples, and its layers, wait on disk meanwhile."""


class RenderSettings(Frozen):
    """How to render: samples a pixel (or other numbers at their cost, where that is better), path length, CPU threads
    (0: all cores)."""

    spp: PositiveInt = 16
    max_bounces: PositiveInt = 8
    threads: int = 0


@dataclass(frozen=True)
class RenderJob:
    """One variant (`datagen.storage.object_variants`) of one view; `scratch` is a folder where what a large picture
    takes may wait."""

    scene: SceneSpec
    rig: LightRig
    settings: RenderSettings
    view: int
    variant: str = ALL
    scratch: Path | None = None


class Backend(Protocol):
    """A renderer that keeps its copy of the last scene between jobs."""

    name: str

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` with the value and the remedy."""
        ...


class BackendError(MultilightError):
    """The renderer cannot do what was asked: names the value and the remedy."""


def view_camera(job: RenderJob) -> Camera:
    """Return the camera of a job's view; raises `BackendError` where the scene has no such view."""
    cameras = job.scene.cameras
    if not 0 <= job.view < len(cameras):
        raise BackendError(f"view {job.view} is not in 0..{len(cameras) - 1}")
    return cameras[job.view]


def split_variant(scene: SceneSpec, variant: str) -> tuple[str, str | None]:
    """Split a variant into its action (`all`, `without`, `foreground`) and the object's name, None for `all`."""
    named = Variant(variant)
    if named not in variants_of(scene.insertable):
        raise BackendError(
            f"variant {variant!r} is not 'all', 'without_<object>' or 'foreground_<object>' "
            f"with an object of {list(scene.insertable)}"
        )
    return named.action, named.object or None
