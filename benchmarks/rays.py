"""Rays a core-second of the Mitsuba backend's paths, against a bare loop of intersections: how far the floor is.

The same sampled scene for both. The bare loop traces incoherent rays from random points of the surfaces in random
directions, closest hits and nothing else. A path's rays are its own segments and its shadow rays.

    python benchmarks/rays.py --seed 3
"""

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import tyro

from multilight.datagen.backends.mitsuba import MitsubaBackend
from multilight.datagen.backends.mitsuba.integrator import World
from multilight.datagen.backends.mitsuba.surfaces import TriangleSet
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.scene import sample_scene
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.rays import body_triangles
from multilight.scenes.random_streams import Streams

import drjit as dr  # isort: skip
import mitsuba as mi  # isort: skip


@dataclass
class Options:
    """What to measure."""

    size: int = 256
    spp: int = 16
    seed: int = 3
    views: int = 4


class Counting:
    """A scene that counts the rays asked of it."""

    def __init__(self, scene: mi.Scene, counter: mi.UInt32) -> None:
        self._scene, self._counter = scene, counter

    def ray_intersect_preliminary(self, ray: mi.Ray3f, active: mi.Bool, **more: Any) -> mi.PreliminaryIntersection3f:
        dr.scatter_add(self._counter, mi.UInt32(1), mi.UInt32(0), active)
        return self._scene.ray_intersect_preliminary(ray, active=active, **more)

    def ray_test(self, ray: mi.Ray3f, active: mi.Bool) -> mi.Bool:
        dr.scatter_add(self._counter, mi.UInt32(1), mi.UInt32(0), active)
        return self._scene.ray_test(ray, active=active)


def counted(world: World, counter: mi.UInt32) -> World:
    """Return a world that counts its rays."""

    def count(triangles: TriangleSet) -> TriangleSet:
        return replace(triangles, scene=Counting(triangles.scene, counter))

    fixed, changing = (soup and count(soup) for soup in (world.fixed, world.changing))
    return replace(world, fixed=fixed, changing=changing)


def bare(world: World, points: np.ndarray, count: int) -> float:
    """Return closest hits a core-second of incoherent rays."""
    rng = np.random.default_rng(0)
    origins = mi.Point3f(*points[rng.integers(len(points), size=count)].T.astype(np.float32))
    u = rng.random((2, count)).astype(np.float32)
    ray = mi.Ray3f(origins, mi.warp.square_to_uniform_sphere(mi.Point2f(mi.Float(u[0]), mi.Float(u[1]))))
    dr.eval(ray)
    seconds = []
    for _ in range(4):
        dr.sync_thread()
        start = time.process_time()
        dr.eval(world.nearest(ray, mi.Bool(True)).t)
        dr.sync_thread()
        seconds.append(time.process_time() - start)
    return count / min(seconds)


def main(options: Options) -> None:
    """Print rays a core-second, of paths and of bare rays."""
    config = DatasetConfig(seed=options.seed, width=options.size, height=options.size)
    library = AssetLibrary()
    scene, rig = sample_scene(config, library, Streams(options.seed, 0))
    # Without insertable objects a view is one set of paths.
    bodies = tuple(body.model_copy(update={"insertable": False}) for body in scene.bodies)
    scene = scene.model_copy(update={"bodies": bodies})
    backend = MitsubaBackend(library)

    def render(view: int) -> float:
        start = time.process_time()
        backend.render(RenderJob(scene, rig, RenderSettings(spp=options.spp), view))
        return time.process_time() - start

    render(0)
    views = np.linspace(1, len(scene.cameras) - 1, options.views).astype(int).tolist()
    seconds = sum(render(view) for view in views)
    assert backend.synced is not None
    whole = backend.synced.world
    counter = dr.zeros(mi.UInt32, 1)
    backend.synced.worlds[None] = counted(whole, counter)
    for view in views:
        render(view)
    rays = int(counter[0])
    positions = np.concatenate([body_triangles(body, library)[0] for body in bodies])
    floor = bare(whole, positions, 1 << 21)
    triangles = sum(dr.width(soup.original) for soup in (whole.fixed, whole.changing) if soup)
    print(f"{len(rig.lights)} lights, {triangles} triangles, {options.spp} spp, {len(views)} views")
    million = rays / 1e6
    print(f"paths: {million / seconds:.1f} million rays a core-second ({million / len(views):.1f} million a view)")
    print(f"bare:  {floor / 1e6:.1f} million closest hits a core-second")
    print(f"ratio: {rays / seconds / floor:.2f}")


if __name__ == "__main__":
    main(tyro.cli(Options))
