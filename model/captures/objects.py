"""An object seen from a camera: ray cast, evenly lit by a light that is not the scene's, hidden by what is nearer."""

from dataclasses import dataclass

import numpy as np
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.model.captures.assets import Asset
from multilight.scenes.arrays import Float32, Float64, Int64
from multilight.scenes.cameras.pinhole import pixel_rays, project
from multilight.scenes.colour import srgb_decode, srgb_encode
from multilight.scenes.meshes import MeshPart
from multilight.scenes.spec import Camera

GRID = 3
"""Rays a side in each pixel; odd, so that one goes through its centre."""
SUBPIXELS = sorted(np.ndindex(GRID, GRID), key=lambda at: at == (GRID // 2, GRID // 2))
"""Row and column of each ray; the centre's comes last, so that its depth stays."""
SLACK = 0.01
"""Relative depth by which an object may lie behind the scene and still be seen: it stands on what it touches."""
AMBIENT, FROM_CAMERA = 0.55, 0.35
"""Radiance of a white surface: what the even light gives it, and what the lamp beside the camera adds, head on."""


@dataclass(frozen=True)
class ObjectView:
    """What a view sees of the object.

    radiance (H, W, 3) float32 linear, mean over the visible part of each pixel; coverage (H, W) float32 in [0, 1];
    z_depth (H, W) float32, 0 where it is not seen; `outlined` pixels that it would cover, were nothing before it.
    """

    radiance: Float32
    coverage: Float32
    z_depth: Float32
    outlined: int

    def over(self, background: Float32) -> Float32:
        """Lay it over a display-encoded background (H, W, 3), in linear light."""
        alpha = self.coverage[..., None]
        return srgb_encode(alpha * self.radiance + (1.0 - alpha) * srgb_decode(background)).astype(np.float32)


class PlacedObject:
    """An asset at a pose: `world_from_asset` 4x4, rotation times uniform scale, and translation."""

    def __init__(self, asset: Asset, world_from_asset: Float64) -> None:
        self.asset, self.pose = asset, world_from_asset
        parts = asset.mesh.parts
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        local = asset.mesh.vertices().astype(np.float64)
        self.vertices = local @ world_from_asset[:3, :3].T + world_from_asset[:3, 3]
        normals = np.concatenate([part.normals for part in parts]) @ world_from_asset[:3, :3].T
        self._normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self._uv = np.concatenate([part.uv for part in parts])
        self._faces = np.concatenate([part.faces + start for part, start in zip(parts, starts, strict=True)])
        self._part = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
        self._tracer = RayMeshIntersector(Trimesh(self.vertices, self._faces, process=False))

    def seen(self, camera: Camera, scene_depth: Float32) -> ObjectView:
        """Look at it; `scene_depth` (H, W) is the scene's z_depth, 0 where it is unknown and hides nothing."""
        shape = (camera.height, camera.width)
        radiance, count, z_depth = np.zeros((*shape, 3)), np.zeros(shape), np.zeros(shape)
        outlined = np.zeros(shape, bool)
        window = self._window(camera)
        limit = np.where(scene_depth > 0, scene_depth * (1.0 + SLACK), np.inf)[window]
        forward = -camera.pose()[:3, 2]
        for row, column in SUBPIXELS if limit.size else ():
            origins, directions = pixel_rays(camera, ((column + 0.5) / GRID, (row + 0.5) / GRID))
            rays = directions[window].reshape(-1, 3)
            face, distance, colour = self._cast(origins[window].reshape(-1, 3), rays)
            z = np.where(face >= 0, distance * (rays @ forward), np.inf).reshape(limit.shape)
            outlined[window] |= np.isfinite(z)
            there = z < limit
            radiance[window][there] += colour.reshape(*limit.shape, 3)[there]
            count[window] += there
            z_depth[window] = np.where(there, z, z_depth[window])
        mean = radiance / np.maximum(count, 1.0)[..., None]
        coverage = (count / GRID**2).astype(np.float32)
        return ObjectView(mean.astype(np.float32), coverage, z_depth.astype(np.float32), int(outlined.sum()))

    def _window(self, camera: Camera) -> tuple[slice, slice]:
        """Return the rows and columns in which it can be: all where part of it lies behind the camera."""
        pixels, z = project(camera, self.vertices)
        if (z <= 0).all():
            return slice(0), slice(0)
        if (z <= 0).any():
            return slice(None), slice(None)
        size = [camera.width, camera.height]
        low = np.clip(np.floor(pixels.min(axis=0)), 0, size).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)), 0, size).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])

    def _cast(self, origins: Float64, directions: Float64) -> tuple[Int64, Float64, Float64]:
        """Return for each ray the face hit first (-1: none), its distance, and the radiance (N, 3) towards it."""
        face = np.asarray(self._tracer.intersects_first(origins, directions), np.int64)
        distance, colour = np.full(len(face), np.inf), np.zeros((len(face), 3))
        hit = np.flatnonzero(face >= 0)
        corners = self._faces[face[hit]]
        a, b, c = (self.vertices[corners[:, i]] for i in range(3))
        flat = np.cross(b - a, c - a)
        facing = np.sum(flat * directions[hit], axis=1)
        distance[hit] = np.sum((a - origins[hit]) * flat, axis=1) / np.where(np.abs(facing) > 1e-30, facing, 1e-30)
        at = origins[hit] + distance[hit][:, None] * directions[hit]
        area = np.sum(flat * flat, axis=1)
        u = np.sum(np.cross(c - b, at - b) * flat, axis=1) / area
        v = np.sum(np.cross(a - c, at - c) * flat, axis=1) / area
        weights = np.clip(np.stack([u, v, 1.0 - u - v], axis=1), 0.0, 1.0)[..., None]
        normals = (self._normals[corners] * weights).sum(axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        head_on = np.abs(np.sum(normals * directions[hit], axis=1))
        albedo = self._albedo(self._part[face[hit]], (self._uv[corners] * weights).sum(axis=1))
        colour[hit] = albedo * (AMBIENT + FROM_CAMERA * head_on)[:, None]
        return face, distance, colour

    def _albedo(self, parts: Int64, uv: Float64) -> Float64:
        found = np.zeros((len(parts), 3))
        for number, part in enumerate(self.asset.mesh.parts):
            mine = parts == number
            found[mine] = self._colour_of(part, uv[mine])
        return found

    def _colour_of(self, part: MeshPart, uv: Float64) -> Float64:
        """Look up the base colour at uv (N, 2), whose origin is the picture's lower left: nearest texel, repeated."""
        colour = np.broadcast_to(np.array(part.material.base_color), (len(uv), 3))
        texture = part.material.base_color_texture
        if texture is None:
            return colour
        image = self.asset.textures[texture.image]
        place = np.mod(uv * texture.repeat, 1.0)
        row = np.minimum(((1.0 - place[:, 1]) * image.shape[0]).astype(int), image.shape[0] - 1)
        column = np.minimum((place[:, 0] * image.shape[1]).astype(int), image.shape[1] - 1)
        return np.asarray(colour * image[row, column])
