"""The closed-form renderer: diffuse spheres and rectangles under direct light, in plain numpy.

It is the truth that tests compare with, and what runs where no renderer is installed. No noise: anti-aliasing is
a fixed grid of rays in each pixel. Shadows are hard, light does not bounce.
"""

import math
from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.analytic.lighting import SurfacePoints, check_lights, exitance_share
from multilight.datagen.backends.analytic.shapes import Ball, Shape, column, dot, shapes_of
from multilight.datagen.backends.protocol import BackendError, RenderJob, split_variant, view_camera
from multilight.datagen.storage.layers import GeometryBuffers, LayerStack
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.cameras.pinhole import pixel_rays
from multilight.scenes.spec import Camera

Traced = tuple[NDArray[np.uint16], Float64, Float64]


class AnalyticBackend:
    """Renders spheres and rectangles in closed form; nothing is kept between jobs."""

    name = "analytic"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def render(self, job: RenderJob) -> LayerStack:
        """Render one job; raises `BackendError` naming a body, light, view or variant it cannot draw.

        `settings.spp` becomes a grid of k x k rays a pixel, k = ceil(sqrt(spp)), the same in every variant.
        """
        action, name = split_variant(job.scene, job.variant)
        camera = view_camera(job)
        check_lights(job.rig, job.scene)
        shapes = shapes_of(job.scene, without=name if action == "without" else None)
        _check_outside(camera, shapes)
        only = job.scene.instance_id(name) if action == "foreground" and name else None
        radiance, share = _sample_grid(camera, shapes, job.rig.lights, job.settings.spp, only)
        return LayerStack(
            lights=job.rig.names,
            radiance=radiance,
            combined=radiance.sum(axis=0),
            geometry=_geometry(camera, shapes, 1.0 - share) if action == "all" else None,
            coverage=share if action == "foreground" else None,
        )


def _check_outside(camera: Camera, shapes: Sequence[Shape]) -> None:
    """Raise `BackendError` where the camera stands inside a sphere, whose far side would need other rules."""
    eye = camera.pose()[:3, 3]
    for shape in shapes:
        if isinstance(shape, Ball) and np.linalg.norm(shape.centre[:, 0] - eye) <= shape.radius:
            raise BackendError(f"the camera at {eye.round(3).tolist()} is inside body {shape.name!r}: move it out")


def _trace(camera: Camera, shapes: Sequence[Shape], offset: tuple[float, float]) -> Traced:
    """Follow one ray a pixel: ids (N,) with 0 for nothing, distances (N,), unit directions (3, N); N = H W."""
    _, rays = pixel_rays(camera, offset)
    directions = np.ascontiguousarray(rays.reshape(-1, 3).T)
    eye = column(camera.pose()[:3, 3])
    nearest = np.full(directions.shape[1], np.inf)
    ids = np.zeros(directions.shape[1], np.uint16)
    for shape in shapes:
        distance = shape.hit(eye, directions)
        closer = distance < nearest
        nearest[closer], ids[closer] = distance[closer], shape.number
    return ids, nearest, directions


def _surface(
    camera: Camera, shapes: Sequence[Shape], traced: Traced, chosen: NDArray[np.intp]
) -> tuple[SurfacePoints, Float64]:
    """Return what the chosen rays hit, and its albedo (3, M)."""
    ids, nearest, directions = traced
    owners, towards = ids[chosen], directions[:, chosen]
    places = column(camera.pose()[:3, 3]) + nearest[chosen] * towards
    normals, albedo = np.zeros((2, *places.shape))
    for shape in shapes:
        mine = owners == shape.number
        normals[:, mine], albedo[:, mine] = shape.normal(places[:, mine]), column(shape.material.base_color)
    normals *= np.where(dot(normals, towards) > 0.0, -1.0, 1.0)
    return SurfacePoints(places, normals, owners), albedo


def _sample_grid(
    camera: Camera, shapes: Sequence[Shape], lights: Sequence[Light], spp: int, only: int | None
) -> tuple[Float32, Float32]:
    """Average the grid of rays in each pixel.

    Returns the layers (L, H, W, 3) and the fraction of each pixel (H, W) that shows geometry, or, where `only` is an
    instance id, both of that body alone.
    """
    side = math.ceil(math.sqrt(spp))
    height, width = camera.height, camera.width
    total = np.zeros((len(lights), 3, height * width))
    seen = np.zeros(height * width)
    for i in range(side * side):
        traced = _trace(camera, shapes, ((i % side + 0.5) / side, (i // side + 0.5) / side))
        hit = traced[0] > 0 if only is None else traced[0] == only
        chosen = np.flatnonzero(hit)
        seen += hit
        points, albedo = _surface(camera, shapes, traced, chosen)
        for layer, light in zip(total, lights, strict=True):
            layer[:, chosen] += column(light.amount) * albedo * exitance_share(light, shapes, points)
            if isinstance(light, EmissiveLight):
                glowing = [shape.number for shape in shapes if shape.name == light.body]
                layer[:, chosen] += column(light.radiance) * np.isin(points.owners, glowing)
            elif isinstance(light, EnvironmentLight) and only is None:
                layer += column(light.radiance) * ~hit
    scale = 1.0 / side**2
    radiance = np.moveaxis((total * scale).astype(np.float32), 1, -1).reshape(len(lights), height, width, 3)
    return np.ascontiguousarray(radiance), (seen * scale).astype(np.float32).reshape(height, width)


def _geometry(camera: Camera, shapes: Sequence[Shape], environment: Float32) -> GeometryBuffers:
    """Return what the rays through the pixels' centres hit."""
    traced = _trace(camera, shapes, (0.5, 0.5))
    ids, nearest, directions = traced
    chosen = np.flatnonzero(ids)
    points, albedo = _surface(camera, shapes, traced, chosen)
    image = (camera.height, camera.width)
    roughness = np.zeros(1 + max((shape.number for shape in shapes), default=0), np.float32)
    for shape in shapes:
        roughness[shape.number] = shape.material.roughness
    depth, vectors = np.zeros(ids.size, np.float32), np.zeros((2, ids.size, 3), np.float32)
    depth[chosen] = nearest[chosen] * dot(-camera.pose()[:3, 2], directions[:, chosen])
    vectors[0, chosen], vectors[1, chosen] = points.normals.T, albedo.T
    return GeometryBuffers(
        z_depth=depth.reshape(image),
        normal_world=vectors[0].reshape(*image, 3),
        albedo=vectors[1].reshape(*image, 3),
        roughness=roughness[ids].reshape(image),
        metallic=np.zeros(image, np.float32),
        instance_id=ids.reshape(image),
        environment=environment,
    )
