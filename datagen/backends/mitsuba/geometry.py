"""Geometry buffers: what the ray through each pixel's centre hits first."""

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.cameras import Lens
from multilight.datagen.backends.mitsuba.integrator import SEE_THROUGH_SURFACES, World
from multilight.datagen.storage.layers import GeometryBuffers
from multilight.scenes.arrays import Float32
from multilight.scenes.spec import Camera

HALF = 0.5
"""A surface counts as hit above this opacity, as in Cycles."""


def geometry_buffers(world: World, camera: Camera, uncovered: Float32) -> GeometryBuffers:
    """Trace one ray a pixel, of the pinhole. `uncovered` (H, W) is the fraction of samples that met no surface."""
    width, height = camera.width, camera.height
    index = dr.arange(mi.UInt32, width * height)
    row = index // dr.opaque(mi.UInt32, width)
    column = index - row * dr.opaque(mi.UInt32, width)
    lens = Lens(camera)
    ray = lens.rays(mi.Point2f(mi.Float(column) + 0.5, mi.Float(row) + 0.5))
    face, uv, distance, found = _first_hit(world, ray)
    hit = world.surfaces.hit(face, uv, ray, found)
    normal = dr.select(dr.dot(hit.ns, ray.d) > 0, -hit.ns, hit.ns)

    def picture(value: mi.Float | mi.Color3f | mi.Normal3f | mi.UInt32) -> np.ndarray:
        array = np.array(dr.select(found, value, 0))
        if array.ndim == 1:
            return array.reshape(height, width)
        return np.ascontiguousarray(array.reshape(3, height, width).transpose(1, 2, 0))

    return GeometryBuffers(
        z_depth=picture(distance * dr.dot(ray.d, lens.forward)),
        normal_world=picture(normal),
        albedo=picture(hit.base),
        roughness=picture(hit.roughness),
        metallic=picture(hit.metallic),
        instance_id=picture(hit.body).astype(np.uint16),
        environment=uncovered,
    )


def _first_hit(world: World, ray: mi.Ray3f) -> tuple[mi.UInt32, mi.Point2f, mi.Float, mi.Bool]:
    """Find the first surface that is opaque enough: triangle, barycentric coordinates, distance, whether there is."""

    def step(active, o, face, uv, distance, found, count):  # type: ignore[no-untyped-def]
        nearest = world.nearest(mi.Ray3f(o, ray.d), active)
        hit = nearest.valid
        stops = mi.Bool(hit)
        if world.surfaces.see_through:
            stops &= world.surfaces.opacity(nearest.face, nearest.uv, hit) > HALF
        distance = dr.select(hit, distance + nearest.t, distance)
        face, uv = dr.select(stops, nearest.face, face), dr.select(stops, nearest.uv, uv)
        beyond = nearest.t * 1e-5 + 1e-5
        o = dr.select(hit, o + ray.d * (nearest.t + beyond), o)
        distance = dr.select(hit & ~stops, distance + beyond, distance)
        count += 1
        return hit & ~stops & (count < SEE_THROUGH_SURFACES), o, face, uv, distance, found | stops, count

    width = dr.width(ray.d)
    state = (
        dr.full(mi.Bool, True, width), mi.Point3f(ray.o), mi.UInt32(0), mi.Point2f(0), mi.Float(0), mi.Bool(False),
        mi.UInt32(0),
    )  # fmt: skip
    _, _, face, uv, distance, found, _ = dr.while_loop(state, lambda *s: s[0], step, label="first hit")
    return face, uv, distance, found
