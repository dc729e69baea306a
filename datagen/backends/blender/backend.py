"""`BlenderBackend`: one job in, one `LayerStack` out."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Self

import bpy
import numpy as np

from multilight.datagen.backends.blender.film import Passes, beauty_filter, centre_filter, configure, render_passes
from multilight.datagen.backends.blender.materials import ALBEDO_AOV, SURFACE_AOV, deciding
from multilight.datagen.backends.blender.scene import SyncedScene, place_camera, projected_border
from multilight.datagen.backends.protocol import RenderJob, RenderSettings, split_variant, view_camera
from multilight.datagen.storage.layers import GeometryBuffers, LayerStack
from multilight.lights.spec import LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import Camera, SceneSpec

_NOTHING = 1e9
"""Cycles writes 1e10 metres where a ray hits nothing."""
RAYS = ("camera", "diffuse", "glossy", "transmission", "shadow", "volume_scatter")


class BlenderBackend:
    """Renders with Cycles, light by light in one pass through its light groups.

    The scene stays in Blender between jobs; only camera, seed and visibility change then. Blender is one to a
    process: of several backends, the one that rendered last holds it.
    """

    name = "cycles"
    _holder: ClassVar["BlenderBackend | None"] = None

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._key: tuple[SceneSpec, LightRig, RenderSettings] | None = None
        self._seeds = 0
        self.synced: SyncedScene | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if BlenderBackend._holder is self:
            bpy.ops.wm.read_factory_settings(use_empty=True)
            BlenderBackend._holder = None
        self._key = self.synced = None

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` with the value and the remedy."""
        action, name = split_variant(job.scene, job.variant)
        camera = view_camera(job)
        synced = self.sync(job)
        place_camera(camera)
        # One seed for all variants of a view: pixels that the object does not touch come out the same.
        bpy.context.scene.cycles.seed = (self._seeds + job.view) % 2**31
        if name is None:
            passes = _beauty(synced, job.settings)
            return _stack(passes, job.rig, geometry=_geometry(camera, passes))
        if action == "foreground":
            return _render_foreground(synced, job, name)
        with hidden(synced, name):
            return _stack(_beauty(synced, job.settings), job.rig)

    def sync(self, job: RenderJob, *, keep: bool = True) -> SyncedScene:
        """Have the job's scene in Blender; whoever goes on to change it does not `keep` it for the next job."""
        key = (job.scene, job.rig, job.settings)
        if self.synced is None or BlenderBackend._holder is not self or key != self._key:
            self._key, BlenderBackend._holder = None, self
            self.synced = SyncedScene(job.scene, job.rig, self._library)
            configure(job.settings, job.rig.names)
            _settle(self.synced)
            self._seeds = int(job.scene.sha256()[:8], 16)
        self._key = key if keep else None
        return self.synced


def _settle(synced: SyncedScene) -> None:
    """Render a few pixels with a body hidden, and throw them away.

    The first change of visibility puts Cycles' lamps into another order, and with it the random choices of
    every later render: the variants rendered before it would share no random numbers with those after it.
    """
    beauty_filter(1)
    small = _changed([bpy.context.scene.render], resolution_x=4, resolution_y=4)
    with small, hidden(synced, next(iter(synced.objects))):
        render_passes()


def _beauty(synced: SyncedScene, settings: RenderSettings) -> Passes:
    """Render all lights: what Blender can hold at once, then each further environment with the lamps off.

    A glowing body stays on in those renders, since its material is not touched; its light falls into its own
    group and is left out.
    """
    beauty_filter(settings.spp)
    passes = render_passes()
    for number, name in enumerate(synced.sky.names[1:], start=1):
        with _lit_by(synced, number):
            layer = render_passes()[f"Combined_{synced.sky.names[0]}"]
        passes[f"Combined_{name}"] = layer
        passes["Combined"][..., :3] += layer[..., :3]
    return passes


@contextlib.contextmanager
def _lit_by(synced: SyncedScene, environment: int) -> Iterator[None]:
    """Let another environment light the scene, without any lamp.

    `hide_render` would take the lamps out of Cycles' scene and put them back in another order.
    """
    with _changed([lamp.data for lamp in synced.lamps], energy=0.0):
        synced.sky.shine(environment)
        try:
            yield
        finally:
            synced.sky.shine(0)


def _stack(passes: Passes, rig: LightRig, **more: Any) -> LayerStack:
    return LayerStack(
        lights=rig.names,
        radiance=np.stack([passes[f"Combined_{name}"][..., :3] for name in rig.names]),
        combined=np.ascontiguousarray(passes["Combined"][..., :3]),
        guide_albedo=passes["Denoising Albedo"],
        guide_normal=passes["Denoising Normal"],
        **more,
    )


def _geometry(camera: Camera, beauty: Passes) -> GeometryBuffers:
    """Render once more through the pixel centres; only `environment` comes from the full render."""
    centre_filter()
    with _changed(deciding(), default_value=1.0):
        passes = render_passes()
    hit = passes["Depth"] < _NOTHING
    surface = passes[SURFACE_AOV][..., :3] * hit[..., None]
    return GeometryBuffers(
        z_depth=np.where(hit, passes["Depth"], np.float32(0)),
        normal_world=_towards_camera(camera, passes["Normal"]) * hit[..., None],
        albedo=passes[ALBEDO_AOV][..., :3] * hit[..., None],
        roughness=np.ascontiguousarray(surface[..., 0]),
        metallic=np.ascontiguousarray(surface[..., 1]),
        instance_id=np.where(hit, np.rint(passes["IndexOB"]), 0).astype(np.uint16),
        environment=np.clip(1 - beauty[SURFACE_AOV][..., 2], 0, 1),
    )


def _towards_camera(camera: Camera, normal: Float32) -> Float32:
    """Normalize each normal and turn it against its pixel's viewing ray, H x W x 3.

    Cycles gives see-through surfaces that it counts as hit no normal; theirs faces the camera.
    """
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack(np.broadcast_arrays(x, -y[:, None], -1.0), axis=-1) @ camera.pose()[:3, :3].T
    normal = np.where((normal == 0).all(axis=-1, keepdims=True), -rays, normal).astype(np.float32)
    facing = np.where((normal * rays).sum(axis=-1, keepdims=True) > 0, -normal, normal)
    return facing / np.linalg.norm(facing, axis=-1, keepdims=True)


def _render_foreground(synced: SyncedScene, job: RenderJob, name: str) -> LayerStack:
    camera = view_camera(job)
    border = projected_border(camera, synced.box(name))
    if border is None:
        unseen = np.zeros((camera.height, camera.width, 3), np.float32)
        layers = np.zeros((len(job.rig.names), *unseen.shape), np.float32)
        return LayerStack(
            job.rig.names, layers, unseen, coverage=unseen[..., 0], guide_albedo=unseen, guide_normal=unseen
        )
    with _alone(synced, name), _bordered(camera, border):
        passes = _beauty(synced, job.settings)
    return _stack(passes, job.rig, coverage=np.clip(passes["Combined"][..., 3], 0, 1))


def hidden(synced: SyncedScene, name: str) -> contextlib.AbstractContextManager[None]:
    """Make a body invisible to every kind of ray: the same picture as without it, to the last bit.

    `hide_render` would have Cycles drop and rebuild the body's geometry, which costs more than many a render.
    """
    return _changed(synced.objects[name], **{f"visible_{ray}": False for ray in RAYS})


@contextlib.contextmanager
def _alone(synced: SyncedScene, name: str) -> Iterator[None]:
    """Let the camera see one body only: the others hide it and light it, but leave the picture empty."""
    others = [placed for body, objects in synced.objects.items() if body != name for placed in objects]
    with _changed([bpy.context.scene.render], film_transparent=True), _changed(others, is_holdout=True):
        yield


def _bordered(camera: Camera, border: tuple[int, int, int, int]) -> contextlib.AbstractContextManager[None]:
    """Render only these pixels (left, top, right, bottom) of the full picture; the rest is zero."""
    left, top, right, bottom = border
    render = bpy.context.scene.render
    render.use_crop_to_border = False
    render.border_min_x, render.border_max_x = left / camera.width, right / camera.width
    render.border_min_y, render.border_max_y = 1 - bottom / camera.height, 1 - top / camera.height
    return _changed([render], use_border=True)


@contextlib.contextmanager
def _changed(things: Sequence[Any], **values: Any) -> Iterator[None]:
    """Give some of Blender's things other values for a while."""
    before = [(thing, name, getattr(thing, name)) for thing in things for name in values]
    for thing, name, _ in before:
        setattr(thing, name, values[name])
    try:
        yield
    finally:
        for thing, name, value in before:
            setattr(thing, name, value)
