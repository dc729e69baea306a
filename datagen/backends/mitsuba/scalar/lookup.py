"""What rays see first, in numpy: for the geometry buffers, the denoiser's guides and objects' outlines."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.datagen.backends.mitsuba.arrays import Textures, parts_of, place_part
from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import srgb_decode
from multilight.scenes.spec import Material, SceneSpec, Texture

SEE_THROUGH_SURFACES = 32
HALF = 0.5
"""A surface counts as hit above this opacity, as in Cycles."""


@dataclass(frozen=True)
class Seen:
    """What N rays see first: body counts from 1, 0 for nothing (then all else is 0).

    `covered`: some surface was there, see-through or not. distance [m]; normal unit, turned towards the viewer.
    """

    body: NDArray[np.uint16]
    covered: Mask
    distance: Float64
    normal: Float64
    albedo: Float64
    roughness: Float64
    metallic: Float64


class Lookup:
    """A scene's triangles and their surfaces' numbers."""

    def __init__(self, scene: SceneSpec, library: AssetLibrary, textures: Textures) -> None:
        pieces = [
            (place_part(mesh, np.array(body.world_from_body)), mesh.faces, material, number)
            for number, body in enumerate(scene.bodies, start=1)
            for mesh, material in zip(parts_of(body, library), body.materials, strict=True)
        ]
        starts = np.cumsum([0] + [len(vertices) for vertices, _, _, _ in pieces])
        self._textures = textures
        self._materials = [material for _, _, material, _ in pieces]
        self._body = np.array([number for _, _, _, number in pieces])
        self._vertices = np.concatenate([vertices for vertices, _, _, _ in pieces]).astype(np.float64)
        faces = [faces.astype(np.int64) + start for (_, faces, _, _), start in zip(pieces, starts, strict=False)]
        self._row = np.repeat(np.arange(len(pieces)), [len(f) for f in faces])
        self._faces = np.concatenate(faces)
        self._tracer = RayMeshIntersector(Trimesh(self._vertices[:, :3], self._faces, process=False))
        self._see_through = any(m.opacity < 1 or m.opacity_from_alpha for m in self._materials)

    def see(self, origins: Float64, directions: Float64, rng: np.random.Generator | None = None) -> Seen:
        """Look along rays, (N, 3) origins and unit directions.

        See-through surfaces stop a ray by chance, as their opacity says, or, without `rng`, above half opacity.
        """
        count = len(origins)
        face, share, travelled = np.full(count, -1), np.zeros((count, 3)), np.zeros(count)
        covered, going = np.zeros(count, bool), np.arange(count)
        for _ in range(SEE_THROUGH_SURFACES):
            o = origins[going] + directions[going] * travelled[going, None]
            near = self._tracer.intersects_first(o, directions[going])
            hit = near >= 0
            going, near, o = going[hit], near[hit], o[hit]
            if not len(going):
                break
            covered[going] = True
            distance, where = self._meet(near, o, directions[going])
            least = HALF if rng is None else rng.random(len(going))
            stops = self._opacity(near, where) > least
            face[going[stops]], share[going[stops]] = near[stops], where[stops]
            travelled[going] += np.where(stops, distance, distance * (1 + 1e-5) + 1e-5)
            going = going[~stops]
        return self._described(face, share, np.where(face >= 0, travelled, 0), covered, directions)

    def _meet(self, face: Int64, o: Float64, d: Float64) -> tuple[Float64, Float64]:
        """Return where rays meet their triangles' planes: distance (N,), barycentric coordinates (N, 3)."""
        a, b, c = np.moveaxis(self._vertices[self._faces[face], :3], 1, 0)
        normal = np.cross(b - a, c - a)
        facing = (normal * d).sum(axis=1)
        distance = ((a - o) * normal).sum(axis=1) / np.where(np.abs(facing) > 1e-30, facing, 1e-30)
        p = o + d * distance[:, None]
        area = (normal * normal).sum(axis=1)
        v = (np.cross(p - a, c - a) * normal).sum(axis=1) / area
        w = (np.cross(b - a, p - a) * normal).sum(axis=1) / area
        return np.maximum(distance, 0), np.stack([1 - v - w, v, w], axis=1)

    def _opacity(self, face: Int64, share: Float64) -> Float64:
        opacity = np.ones(len(face))
        if not self._see_through:
            return opacity
        uv = self._blend(face, share)[:, 6:]
        for material, mine in self._by_material(face):
            opacity[mine] = material.opacity
            if material.opacity_from_alpha and material.base_color_texture is not None:
                opacity[mine] *= self._texture(material.base_color_texture, uv[mine])[:, 3]
        return opacity

    def _described(self, face: Int64, share: Float64, distance: Float64, covered: Mask, d: Float64) -> Seen:
        there = face >= 0
        at = self._blend(face, share)
        normal = at[:, 3:6] / np.maximum(np.linalg.norm(at[:, 3:6], axis=1, keepdims=True), 1e-20)
        albedo, roughness, metallic = np.zeros((len(face), 3)), np.zeros(len(face)), np.zeros(len(face))
        for material, mine in self._by_material(np.where(there, face, 0)):
            mine = mine[there[mine]]
            albedo[mine], uv = material.base_color, at[mine, 6:]
            roughness[mine], metallic[mine] = material.roughness, material.metallic
            if material.base_color_texture is not None:
                albedo[mine] *= srgb_decode(self._texture(material.base_color_texture, uv)[:, :3])
            if material.roughness_texture is not None:
                roughness[mine] *= self._texture(material.roughness_texture, uv)[:, 0]
            if material.normal_texture is not None:
                local = self._texture(material.normal_texture, uv)[:, :3] * 2 - 1
                normal[mine] = self._bumped(face[mine], normal[mine], local)
        away = (normal * d).sum(axis=1) > 0
        normal = np.where(away[:, None], -normal, normal) * there[:, None]
        body = np.where(there, self._body[self._row[face]], 0).astype(np.uint16)
        return Seen(body, covered, distance, normal, albedo, roughness, metallic)

    def _blend(self, face: Int64, share: Float64) -> Float64:
        """Interpolate what vertices carry: position, normal, uv (N, 8)."""
        return np.einsum("nk,nkc->nc", share, self._vertices[self._faces[face]])

    def _by_material(self, face: Int64) -> Iterator[tuple[Material, Int64]]:
        row = self._row[face]
        for number in np.unique(row):
            yield self._materials[number], np.flatnonzero(row == number)

    def _texture(self, texture: Texture, uv: Float64) -> Float64:
        """Interpolate a repeating texture's encoded values: (N, 4) in [0, 1]."""
        words = self._textures.load(texture.image)
        height, width = words.shape
        u, v = np.moveaxis(uv * texture.repeat, -1, 0)
        x, y = (u % 1.0) * width - 0.5, (1 - v % 1.0) * height - 0.5
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = (x - left)[:, None], (y - top)[:, None]
        texels = words.view(np.uint8).reshape(height, width, 4)

        def at(column: Int64, line: Int64) -> Float64:
            return texels[line % height, column % width] / 255.0

        above = at(left, top) * (1 - fx) + at(left + 1, top) * fx
        below = at(left, top + 1) * (1 - fx) + at(left + 1, top + 1) * fx
        return above * (1 - fy) + below * fy

    def _bumped(self, face: Int64, normal: Float64, local: Float64) -> Float64:
        """Turn shading normals by a tangent-space normal map (red along u, green along v)."""
        corner = self._vertices[self._faces[face]]
        edges, uv = corner[:, 1:, :3] - corner[:, :1, :3], corner[:, 1:, 6:] - corner[:, :1, 6:]
        determinant = (uv[:, 0, 0] * uv[:, 1, 1] - uv[:, 1, 0] * uv[:, 0, 1])[:, None]
        along = (edges[:, 0] * uv[:, 1, 1:] - edges[:, 1] * uv[:, 0, 1:]) * np.sign(determinant)
        tangent = along - normal * (normal * along).sum(axis=1, keepdims=True)
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        tangent /= np.maximum(length, 1e-20)
        across = np.cross(normal, tangent) * np.sign(determinant)
        bumped = tangent * local[:, :1] + across * local[:, 1:2] + normal * local[:, 2:]
        bumped /= np.maximum(np.linalg.norm(bumped, axis=1, keepdims=True), 1e-20)
        return np.where((length > 0) & (determinant != 0), bumped, normal)
