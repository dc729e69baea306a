"""`ScalarBackend`: one job in, one `LayerStack` out; a render for each light, one sample a pixel at a time."""

from dataclasses import replace
from types import TracebackType
from typing import Any, Self

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.mitsuba.arrays import Textures
from multilight.datagen.backends.mitsuba.scalar.film import BLOCK, Film
from multilight.datagen.backends.mitsuba.scalar.lookup import Lookup, Seen
from multilight.datagen.backends.mitsuba.scalar.worlds import Worlds
from multilight.datagen.backends.protocol import BackendError, RenderJob, RenderSettings, split_variant
from multilight.datagen.storage.layers import GeometryBuffers, LayerStack
from multilight.lights.spec import EmissiveLight, EnvironmentLight
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import pixel_rays, z_depth_from_ray_distance
from multilight.scenes.spec import Camera

VIEWS_APART = 0x9E3779B1
"""Between the seeds of views."""


class ScalarBackend:
    """Renders with Mitsuba's scalar variant: what is left where there is neither a GPU nor a usable LLVM.

    The last scene stays between jobs, and so do the last view's pictures.
    """

    name = "mitsuba"
    variant = mi.variant()

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._textures = Textures(library)
        self._synced: _Synced | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._synced = None

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` with the value and the remedy."""
        action, name = split_variant(job.scene, job.variant)
        if not 0 <= job.view < len(job.scene.cameras):
            raise BackendError(f"view {job.view} is not in 0..{len(job.scene.cameras) - 1}")
        dr.set_thread_count(job.settings.threads or dr.thread_count())
        if self._synced is None or (self._synced.scene, self._synced.rig) != (job.scene, job.rig):
            self._synced = None  # frees memory first
            self._synced = _Synced(job, self._library, self._textures)
        view = self._synced.view(job.view, job.settings)
        match action:
            case "without":
                return self._synced.without(name, view, job.settings)
            case "foreground":
                return view.stack(view.means["foreground", name], coverage=view.mask("coverage", name))
            case _:
                return view.stack(view.means["all", None], geometry=view.geometry)


class _View:
    """A view's pictures: sums over its samples, then their means."""

    def __init__(self, film: Film, lights: tuple[str, ...], geometry: GeometryBuffers) -> None:
        self.film, self._lights, self.geometry = film, lights, geometry
        self.means: dict[tuple[str, str | None], NDArray[Any]] = {}

    def add(self, kind: str, name: str | None, sums: Float64) -> None:
        """Add a pass's sums to a picture."""
        key = (kind, name)
        self.means[key] = self.means[key] + sums if key in self.means else sums

    def divide(self) -> None:
        """Turn the sums into float32 means."""
        count = self.means.pop(("count", None))
        self.means = {key: np.divide(sums, count).astype(np.float32) for key, sums in self.means.items()}

    def mask(self, kind: str, name: str | None = None) -> Float32:
        """Return a picture of one channel, (H, W)."""
        return np.ascontiguousarray(self.means[kind, name][..., 0])

    def stack(self, layers: Float32, **more: Any) -> LayerStack:
        """Wrap a variant's layers."""
        return LayerStack(
            lights=self._lights,
            radiance=layers,
            combined=layers.sum(axis=0),
            guide_albedo=self.means["albedo", None],
            guide_normal=self.means["normal", None],
            **more,
        )


class _Synced:
    """A scene made for Mitsuba, and the pictures of the view asked for last."""

    def __init__(self, job: RenderJob, library: AssetLibrary, textures: Textures) -> None:
        self.scene, self.rig = job.scene, job.rig
        self._worlds = Worlds(job.scene, job.rig, library, textures)
        self._library, self._textures = library, textures
        self._lookups: dict[str | None, Lookup] = {}
        self._seed = int(job.scene.sha256()[:8], 16)
        self._key: tuple[int, RenderSettings] | None = None
        self._view: _View | None = None

    def view(self, number: int, settings: RenderSettings) -> _View:
        """Render a view's `all` and `foreground` variants, or return them where it was the last."""
        if self._view is None or self._key != (number, settings):
            self._view = self._render(number, settings)
            self._key = (number, settings)
        return self._view

    def without(self, name: str | None, view: _View, settings: RenderSettings) -> LayerStack:
        """Render the view's layers again, with the same random numbers, without an object."""
        assert self._key is not None
        pictures = _View(view.film, self.rig.names, view.geometry)
        for seed in self._seeds(view.film, self._key[0], settings):
            self._add_layers(pictures, "without", name, seed, settings)
        pictures.divide()
        return pictures.stack(pictures.means["without", name])

    def _render(self, number: int, settings: RenderSettings) -> _View:
        camera = self.scene.cameras[number]
        film = Film(camera)
        view = _View(film, self.rig.names, _geometry(camera, self._lookup(None)))
        for seed in self._seeds(film, number, settings):
            self._add_layers(view, "all", None, seed, settings)
        view.divide()
        view.geometry = replace(view.geometry, environment=1 - view.mask("covered"))
        return view

    def _lookup(self, removed: str | None) -> Lookup:
        """Return what rays see, without an object or with all."""
        if removed not in self._lookups:
            bodies = tuple(body for body in self.scene.bodies if body.name != removed)
            scene = self.scene.model_copy(update={"bodies": bodies})
            self._lookups[removed] = Lookup(scene, self._library, self._textures)
        return self._lookups[removed]

    def _seeds(self, film: Film, number: int, settings: RenderSettings) -> list[int]:
        first = self._seed + number * VIEWS_APART
        return [film.seed(first, place) for place in range(film.passes(settings.spp))]

    def _add_layers(self, view: _View, kind: str, removed: str | None, seed: int, settings: RenderSettings) -> None:
        """Add one sample a pixel under each light, and what the samples saw first."""
        film, rays = view.film, view.film.rays(seed)
        pictures = [self._picture(film, number, removed, seed, settings) for number in range(len(self.rig.lights))]

        def add(kind: str, name: str | None, values: NDArray[Any]) -> None:
            view.add(kind, name, film.summed(rays, values))

        def add_layers(kind: str, name: str | None, share: NDArray[Any]) -> None:
            view.add(kind, name, np.stack([film.summed(rays, picture * share) for picture in pictures]))

        ones = np.ones((*pictures[0].shape[:2], 1), np.float32)
        add("count", None, ones)
        add_layers(kind, removed, ones)
        seen = self._lookup(removed).see(rays.origins, rays.directions, np.random.default_rng(seed))
        add("albedo", None, seen.albedo)
        add("normal", None, seen.normal)
        if kind != "all":
            return
        add("covered", None, seen.covered[:, None])
        for name in self.scene.insertable:
            mine = (seen.body == self.scene.instance_id(name)).reshape(ones.shape)
            add("coverage", name, mine)
            add_layers("foreground", name, mine)

    def _picture(self, film: Film, number: int, removed: str | None, seed: int, settings: RenderSettings) -> Float32:
        """Render one sample a pixel under one light, (H, W, 3)."""
        world, light = self._worlds.lit(number, removed), self.rig.lights[number]
        if world is None:
            width, height = film.sensor.film().size()
            return np.zeros((height, width, 3), np.float32)
        integrator = {
            "type": "volpath",  # unlike `path`, it lets light pass see-through surfaces
            "max_depth": settings.max_bounces + 2,
            "hide_emitters": not isinstance(light, EnvironmentLight | EmissiveLight),
            "block_size": BLOCK,
        }
        return np.array(mi.load_dict(integrator).render(world, film.sensor, seed=seed, spp=1), np.float32)


def _geometry(camera: Camera, lookup: Lookup) -> GeometryBuffers:
    """Look along the rays through the pixels' centres; `environment` is left to be filled in."""
    origins, directions = pixel_rays(camera)
    shape = (camera.height, camera.width)
    seen: Seen = lookup.see(origins.reshape(-1, 3), directions.reshape(-1, 3))

    def picture(values: NDArray[Any]) -> Float32:
        return values.reshape(*shape, *values.shape[1:]).astype(np.float32)

    return GeometryBuffers(
        z_depth=z_depth_from_ray_distance(camera, seen.distance.reshape(shape)).astype(np.float32),
        normal_world=picture(seen.normal),
        albedo=picture(seen.albedo),
        roughness=picture(seen.roughness),
        metallic=picture(seen.metallic),
        instance_id=seen.body.reshape(shape),
        environment=np.zeros(shape, np.float32),
    )
