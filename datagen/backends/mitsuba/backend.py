"""`MitsubaBackend`: one job in, one `LayerStack` out; a view's variants come from one set of paths."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.adaptive import FIRST, Blocks, Pilot, first_blocks, further_blocks
from multilight.datagen.backends.mitsuba.arrays import Textures, scene_arrays
from multilight.datagen.backends.mitsuba.bsdf import Tables
from multilight.datagen.backends.mitsuba.cameras import Lens
from multilight.datagen.backends.mitsuba.device import on_device
from multilight.datagen.backends.mitsuba.film import Film, Key, Parts
from multilight.datagen.backends.mitsuba.geometry import geometry_buffers
from multilight.datagen.backends.mitsuba.integrator import PathResult, Planes, World, trace
from multilight.datagen.backends.mitsuba.lights import Lights
from multilight.datagen.backends.mitsuba.sampling import Sampler, stream_of
from multilight.datagen.backends.mitsuba.surfaces import Surfaces, accelerate
from multilight.datagen.backends.protocol import (
    LARGE,
    BackendError,
    RenderJob,
    RenderSettings,
    split_variant,
    view_camera,
)
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import SceneSpec

LANES = 1 << (22 if mi.variant().startswith("cuda") else 19)
"""Samples traced at once: enough to keep a GPU busy, few enough for memory. No bit depends on it."""
FILM, LENS, BEFORE_PATHS = 8, 9, 1000
"""Dimensions of the camera's random numbers."""


class MitsubaBackend:
    """Renders with Mitsuba's Dr.Jit variants: every light, and every removed object, from one set of paths.

    The last scene stays on the device between jobs, and so do the last view's pictures.
    """

    name = "mitsuba"
    variant = mi.variant()

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._textures = Textures(library)
        self._tables = Tables()
        self.synced: _Synced | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.synced = None

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` with the value and the remedy."""
        action, name = split_variant(job.scene, job.variant)
        camera = view_camera(job)
        dr.set_thread_count(job.settings.threads or dr.thread_count())
        synced = self.prepare(job)
        film = synced.view(job, (action, name or ""))
        layers = film.take((action, name or ""))
        albedo, normal = film.take(("guides", name)) if name and action == "without" else film.mean(("guides", ""))
        stack = LayerStack(
            lights=job.rig.names, radiance=layers, combined=layers.sum(axis=0), guide_albedo=albedo, guide_normal=normal
        )
        if name is None:
            uncovered = film.mean(("uncovered", ""))[0, ..., 0]
            return replace(stack, geometry=geometry_buffers(synced.world, camera, uncovered))
        coverage, shown = np.moveaxis(film.mean(("masks", name))[0, ..., :2], -1, 0)
        return replace(stack, shown=shown) if action == "without" else replace(stack, coverage=coverage)

    def prepare(self, job: RenderJob) -> "_Synced":
        """Put a job's scene on the device, if it is not there; rendering does so too."""
        if self.synced is None or (self.synced.scene, self.synced.rig) != (job.scene, job.rig):
            self.synced = None  # frees the device first
            self.synced = _Synced(job.scene, job.rig, self)
        return self.synced

    def worlds(self, scene: SceneSpec, rig: LightRig) -> dict[str | None, World]:
        """Put a scene on the device: whole (None), and without each insertable object."""
        arrays = scene_arrays(scene, rig, self._library, self._textures)
        surfaces = Surfaces(arrays)
        bits = np.zeros(len(scene.bodies) + 1, np.uint32)
        for place, name in enumerate(scene.insertable):
            bits[scene.instance_id(name)] = 1 << place
        seen, lights = on_device(mi.UInt32, bits), Lights(rig, arrays, bits, surfaces, self._library)
        changing = arrays.of_bodies(scene.insertable) | arrays.let_light_through()
        fixed = accelerate(arrays, ~changing)

        def world(removed: str | None) -> World:
            there = changing & ~arrays.of_bodies([] if removed is None else [removed])
            others = accelerate(arrays, there)
            if fixed is None and others is None:
                raise BackendError(f"the scene has no triangles without {removed!r}")
            return World(fixed, others, surfaces, lights, self._tables, seen)

        return {removed: world(removed) for removed in (None, *scene.insertable)}


class _Synced:
    """A scene on the device, and the film of the view asked for last."""

    def __init__(self, scene: SceneSpec, rig: LightRig, backend: MitsubaBackend) -> None:
        self.scene, self.rig = scene, rig
        self.worlds = backend.worlds(scene, rig)
        self.seed = int(scene.sha256()[:8], 16)
        self._key: tuple[int, RenderSettings] | None = None
        self._view: Film | None = None

    @property
    def world(self) -> World:
        """The whole scene."""
        return self.worlds[None]

    def view(self, job: RenderJob, wanted: Key) -> Film:
        """Render all variants of a view and the masks of objects, or return them where it was the last.

        A film of a large picture from which what is wanted was taken is made anew.

        Of guides, albedo and normal, those of the whole scene go by no name, else by that of the object removed.
        """
        key = job.view, job.settings
        if self._view is None or self._key != key or wanted not in self._view:
            self._view = None  # frees the device first
            self._view, self._key = self._render(*key, job.scratch), key
        return self._view

    def _render(self, number: int, settings: RenderSettings, scratch: Path | None) -> Film:
        camera = self.scene.cameras[number]
        film = Film(camera.height, camera.width, scratch)
        lens = Lens(camera)
        names = self.scene.insertable
        keys = (("all", ""), *(("without", name) for name in names))

        def sample(blocks: Blocks, squares: Sequence[Key] = ()) -> Float32:
            """Add samples to the film; returns what each of their blocks cost."""
            costs, at_once = [], max(1, LANES // blocks.size)
            for start in range(0, len(blocks), at_once):
                part = blocks[start : start + at_once]
                batch = _Batch(self, lens, settings, number, part)
                film.add(part, batch.values(), squares=squares)
                costs.append(batch.cost())
            return np.concatenate(costs)

        first = first_blocks(camera.width * camera.height, settings.spp)
        if settings.spp == first.size:
            sample(first)
        else:
            cost = sample(first, keys).reshape(camera.height, camera.width, FIRST).mean(axis=-1)
            pilots = (
                Pilot(*film.variance(key, FIRST), np.concatenate([*film.mean(("guides", key[1]))], axis=-1))
                for key in keys
            )
            sample(further_blocks(first, pilots, cost, settings.spp))
        if camera.width * camera.height > LARGE:
            dr.flush_malloc_cache()
        return film


class _Batch:
    """Some samples of a view's pixels, block after block."""

    def __init__(self, synced: _Synced, lens: Lens, settings: RenderSettings, number: int, blocks: Blocks) -> None:
        self._synced, self._lens, self._settings = synced, lens, settings
        self._size, self._width = blocks.size, synced.scene.cameras[number].width
        self._pixel, self._first = on_device(mi.UInt32, blocks.pixel), on_device(mi.UInt32, blocks.first)
        # One seed for all variants of a view.
        self._seed = dr.opaque(mi.UInt32, (synced.seed + number) % 2**32)
        self._planes, self._result = self._trace(None, dr.arange(mi.UInt32, len(blocks) * blocks.size))

    def values(self) -> Iterator[tuple[Parts, mi.Float]]:
        """Give what the samples bring to each variant and mask of an object, plane after plane."""
        scene, result, planes = self._synced.scene, self._result, self._planes
        layers = planes.count - Planes.GUIDES
        yield [(("all", ""), layers), (("guides", ""), Planes.GUIDES)], planes.values
        _, sample, _ = planes.places(3)
        yield [(("uncovered", ""), 3)], dr.select(dr.gather(mi.Bool, result.covered, sample), mi.Float(0), 1)
        for place, name in enumerate(scene.insertable):
            bit, body = dr.opaque(mi.UInt32, 1 << place), dr.opaque(mi.UInt32, scene.instance_id(name))
            plane, sample, _ = planes.places(3)
            mine = dr.gather(mi.UInt32, result.first, sample) == body
            seen = (dr.gather(mi.UInt32, result.seen, sample) & bit) != 0
            there = (mine & (plane == 0)) | (seen & (plane == 1))
            yield [(("masks", name), 3)], dr.select(there, mi.Float(1), 0)
            plane, sample, number = planes.places(layers)
            mine = dr.gather(mi.UInt32, result.first, sample) == body
            yield [(("foreground", name), layers)], dr.select(mine, dr.gather(mi.Float, planes.values, number), 0)
            yield [(("without", name), layers), (("guides", name), Planes.GUIDES)], self._without(name, bit)

    def cost(self) -> Float32:
        """Return how often rays were followed for the samples of each of N blocks, in all variants, (N,)."""
        result = self._result
        steps = mi.Float(result.steps * (1 + dr.popcnt(result.met)))
        return np.array(dr.block_sum(steps, self._size))

    def _without(self, name: str, bit: mi.UInt32) -> mi.Float:
        """Trace again, without an object, the samples that met it; the others are what they were. Returns planes."""
        planes = self._planes
        values = dr.copy(planes.values)
        index = dr.compress((self._result.met & bit) != 0)
        if dr.width(index):
            again, _ = self._trace(name, index)
            plane, sample, _ = again.places(again.count)
            dr.scatter(values, again.values, plane * planes.samples + dr.gather(mi.UInt32, index, sample))
        for number, light in enumerate(self._synced.rig.lights):
            if isinstance(light, EmissiveLight) and light.body == name:
                _, _, place = planes.places(3)
                dr.scatter(values, mi.Float(0), place + dr.opaque(mi.UInt32, 3 * number) * planes.samples)
        return values

    def _trace(self, removed: str | None, index: mi.UInt32) -> tuple[Planes, PathResult]:
        dr.eval(index)  # even where it only counts: one kernel for all variants
        size, width = dr.opaque(mi.UInt32, self._size), dr.opaque(mi.UInt32, self._width)
        block = index // size
        pixel = dr.gather(mi.UInt32, self._pixel, block)
        sample = dr.gather(mi.UInt32, self._first, block) + (index - block * size)
        sampler = Sampler(stream_of(pixel, self._seed), sample)
        inside = sampler.next_2d(FILM, BEFORE_PATHS)
        row = pixel // width
        film = mi.Point2f(mi.Float(pixel - row * width) + inside.x, mi.Float(row) + inside.y)
        ray = self._lens.rays(film, sampler.next_2d(LENS, BEFORE_PATHS))
        planes, result = trace(self._synced.worlds[removed], ray, sampler, max_bounces=self._settings.max_bounces)
        dr.eval(planes.values, result)
        return planes, result
