"""What a ray hits: triangles, their surfaces' numbers and textures, looked up in arrays on the device."""

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.arrays import NONE, WRAP_BIT, SceneArrays
from multilight.datagen.backends.mitsuba.device import Row, Table, on_device
from multilight.scenes.arrays import Mask

Corners = tuple[Any, Any, Any]
"""What a triangle's three vertices carry: vectors of one kind."""


@dataclass
class Hit:
    """A point on a surface, a lane each.

    p world [m]; ng geometric and ns shading normal, unit, both on the viewer's side; inside: the ray came from
    behind the surface; body counts from 1; glow is the number of the light that the part is, or NONE.
    """

    p: mi.Point3f
    ng: mi.Normal3f
    ns: mi.Normal3f
    inside: mi.Bool
    uv: mi.Point2f
    row: mi.UInt32
    body: mi.UInt32
    glow: mi.UInt32
    base: mi.Color3f
    opacity: mi.Float
    roughness: mi.Float
    metallic: mi.Float
    ior: mi.Float
    coat: mi.Float
    coat_roughness: mi.Float
    transmission: mi.Float


class Surfaces:
    """A scene's arrays on the device; triangles are numbered as in the whole scene."""

    def __init__(self, arrays: SceneArrays) -> None:
        self._vertices = on_device(mi.Float, arrays.vertices)
        self._colors = None if arrays.colors is None else on_device(mi.Float, arrays.colors)
        self._faces = on_device(mi.UInt32, arrays.faces)
        self._values, self._links = Table(mi.Float, arrays.values), Table(mi.UInt32, arrays.links)
        self._texels = mi.UInt32(arrays.texels)  # where they are
        self.see_through = arrays.see_through
        self.glass = arrays.glass

    def hit(self, face: mi.UInt32, barycentric: mi.Point2f, ray: mi.Ray3f, active: mi.Bool) -> Hit:
        """Look up everything about a point of a triangle (barycentric coordinates of its second and third vertex)."""
        number, (points, normals, uvs) = self._triangle(face, active)
        uv = mi.Point2f(_blend(barycentric, uvs))
        ng = _normal(points)
        ns = mi.Normal3f(dr.normalize(_blend(barycentric, normals)))
        inside = dr.dot(ng, ray.d) > 0
        row = self._row(number, active)
        colour, alpha = self._texture(row, "base_color", uv, active, srgb=True)
        grey, _ = self._texture(row, "roughness", uv, active)
        metal, _ = self._texture(row, "metallic", uv, active)
        if self._colors is not None:
            colour *= mi.Color3f(_blend(barycentric, self._vertex_colors(face, active)))
        ns = self._bumped(row, uv, ns, points, uvs, active)
        flip = dr.select(inside, mi.Float(-1), mi.Float(1))
        return Hit(
            p=mi.Point3f(_blend(barycentric, points)),
            ng=mi.Normal3f(ng * flip),
            ns=mi.Normal3f(ns * flip),
            inside=inside,
            uv=uv,
            row=number,
            body=row["body"],
            glow=row["glow"],
            base=mi.Color3f(row["base_color"]) * colour,
            opacity=_opacity(row, alpha),
            roughness=row["roughness"] * grey.x,
            metallic=row["metallic"] * metal.x,
            ior=row["ior"],
            coat=row["coat"],
            coat_roughness=row["coat_roughness"],
            transmission=row["transmission"],
        )

    def glow_texture(self, hit: Hit, active: mi.Bool) -> mi.Color3f:
        """Look up what multiplies a glowing part's radiance."""
        return self._texture(self._row(hit.row, active), "glow", hit.uv, active, srgb=True)[0]

    def point_of(self, face: mi.UInt32, barycentric: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Color3f]:
        """Return a triangle's point, its geometric normal and its glow texture, to sample emission."""
        active = mi.Bool(True)
        number, (points, _, uvs) = self._triangle(face, active)
        row, uv = self._row(number, active), mi.Point2f(_blend(barycentric, uvs))
        glow, _ = self._texture(row, "glow", uv, active, srgb=True)
        return mi.Point3f(_blend(barycentric, points)), _normal(points), glow

    def opacity(self, face: mi.UInt32, barycentric: mi.Point2f, active: mi.Bool) -> mi.Float:
        """Return only how opaque a point is, in [0, 1]."""
        number, (_, _, uvs) = self._triangle(face, active)
        row = self._row(number, active)
        _, alpha = self._texture(row, "base_color", mi.Point2f(_blend(barycentric, uvs)), active, srgb=True)
        return _opacity(row, alpha)

    def body(self, face: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the number of the body that a triangle belongs to."""
        number = dr.gather(mi.UInt32, self._faces, face * 4 + 3, active)
        return self._links.number("body", number, active)

    def _triangle(self, face: mi.UInt32, active: mi.Bool) -> tuple[mi.UInt32, Any]:
        """Return the number of a triangle's surface, and its corners' positions, normals and uv."""
        corner = dr.gather(mi.Vector4u, self._faces, face, active)
        return corner[3], zip(*(self._vertex(corner[i], active) for i in range(3)), strict=True)

    def _vertex_colors(self, face: mi.UInt32, active: mi.Bool) -> Corners:
        corner = dr.gather(mi.Vector4u, self._faces, face, active)
        a, b, c = (dr.gather(mi.Vector3f, self._colors, corner[i], active) for i in range(3))
        return a, b, c

    def _vertex(self, index: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector2f]:
        a = dr.gather(mi.Vector4f, self._vertices, index * 2, active)
        b = dr.gather(mi.Vector4f, self._vertices, index * 2 + 1, active)
        return mi.Vector3f(a.x, a.y, a.z), mi.Vector3f(a.w, b.x, b.y), mi.Vector2f(b.z, b.w)

    def _row(self, number: mi.UInt32, active: mi.Bool) -> Row:
        return Row((self._values, self._links), number, active)

    def _texture(
        self, row: Row, name: str, uv: mi.Point2f, active: mi.Bool, *, srgb: bool = False
    ) -> tuple[mi.Color3f, mi.Float]:
        """Interpolate a texture; white and opaque where there is none.

        Encoded values are interpolated and then decoded, as Cycles does with 8-bit files.
        """
        offset, columns, lines = row[f"{name}_texture"]
        wrap, columns = columns >> WRAP_BIT, columns & ((1 << WRAP_BIT) - 1)
        uv = uv * mi.Vector2f(row[f"{name}_repeat"])
        there = active & (offset != NONE)
        width, height = mi.Float(columns), mi.Float(lines)
        x = _within(uv.x, wrap) * width - 0.5
        y = (1 - _within(uv.y, wrap)) * height - 0.5
        x0, y0 = dr.floor(x), dr.floor(y)
        fx, fy = x - x0, y - y0
        again = wrap == 0  # beyond its edge a picture that repeats goes on with its other edge, others with this one
        left = mi.UInt32(dr.select(x0 < 0, dr.select(again, width - 1, 0), x0))
        top = mi.UInt32(dr.select(y0 < 0, dr.select(again, height - 1, 0), y0))
        right = dr.select(x0 < 0, 0, dr.select(left + 1 >= columns, dr.select(again, 0, left), left + 1))
        bottom = dr.select(y0 < 0, 0, dr.select(top + 1 >= lines, dr.select(again, 0, top), top + 1))
        total = mi.Vector4f(0)
        corners = ((left, top, (1 - fx) * (1 - fy)), (right, top, fx * (1 - fy)),
                   (left, bottom, (1 - fx) * fy), (right, bottom, fx * fy))  # fmt: skip
        for column, line, weight in corners:
            word = dr.gather(mi.UInt32, self._texels, offset + line * columns + column, there)
            total += mi.Vector4f(*(mi.Float((word >> shift) & 0xFF) for shift in (0, 8, 16, 24))) * (weight / 255)
        colour = mi.Color3f(total.x, total.y, total.z)
        if srgb:
            colour = _linear_from_srgb(colour)
        return dr.select(there, colour, 1), dr.select(there, total.w, 1)

    def _bumped(
        self, row: Row, uv: mi.Point2f, ns: mi.Normal3f, points: Corners, uvs: Corners, active: mi.Bool
    ) -> mi.Normal3f:
        """Bend a shading normal by a tangent-space normal map (red along u, green along v)."""
        (p0, p1, p2), (t0, t1, t2) = points, uvs
        there = active & (row["normal_texture"][0] != NONE)
        colour, _ = self._texture(row, "normal", uv, there)
        local = mi.Vector3f(colour.x, colour.y, colour.z) * 2 - 1
        du1, dv1, du2, dv2 = t1.x - t0.x, t1.y - t0.y, t2.x - t0.x, t2.y - t0.y
        determinant = du1 * dv2 - du2 * dv1
        along_u = ((p1 - p0) * dv2 - (p2 - p0) * dv1) * dr.sign(determinant)
        tangent = along_u - ns * dr.dot(ns, along_u)
        length = dr.norm(tangent)
        tangent = tangent / length
        bitangent = dr.cross(ns, tangent) * dr.sign(determinant)
        bumped = dr.normalize(tangent * local.x + bitangent * local.y + ns * local.z)
        usable = there & (length > 0) & (determinant != 0)
        return mi.Normal3f(dr.select(usable, bumped, ns))


def _within(t: mi.Float, wrap: mi.UInt32) -> mi.Float:
    """Bring a coordinate into [0, 1]: repeated, clamped or mirrored."""
    mirrored = 1 - dr.abs(t - 2 * dr.floor(t / 2) - 1)
    return dr.select(wrap == 0, t - dr.floor(t), dr.select(wrap == 1, dr.clip(t, 0, 1), mirrored))


def _blend(barycentric: mi.Point2f, corners: Corners) -> Any:
    """Interpolate what a triangle's corners carry."""
    a, b, c = corners
    return a * (1 - barycentric.x - barycentric.y) + b * barycentric.x + c * barycentric.y


def _normal(points: Corners) -> mi.Normal3f:
    """Return a triangle's geometric normal."""
    a, b, c = points
    return mi.Normal3f(dr.normalize(dr.cross(b - a, c - a)))


def _opacity(row: Row, alpha: mi.Float) -> mi.Float:
    opacity = row["opacity"] * dr.select(row["opacity_from_alpha"] != 0, alpha, 1)
    cutoff = row["alpha_cutoff"]
    return dr.select(cutoff > 0, dr.select(opacity >= cutoff, mi.Float(1), mi.Float(0)), opacity)


def _linear_from_srgb(c: mi.Color3f) -> mi.Color3f:
    """Decode sRGB (IEC 61966-2-1)."""
    return dr.select(c <= 0.04045, c / 12.92, dr.power((c + 0.055) / 1.055, 2.4))


@dataclass
class TriangleSet:
    """Some of a scene's triangles, accelerated. `original` holds, for each of them, its number in the whole scene."""

    scene: mi.Scene
    original: mi.UInt32

    def face(self, found: mi.PreliminaryIntersection3f, active: mi.Bool) -> mi.UInt32:
        """Return the number, in the whole scene, of the triangle that a ray met."""
        return dr.gather(mi.UInt32, self.original, found.prim_index, active)


def accelerate(arrays: SceneArrays, chosen: Mask) -> TriangleSet | None:
    """Build an acceleration structure over the chosen triangles; None where there are none."""
    original = np.flatnonzero(chosen).astype(np.uint32)
    if not original.size:
        return None
    corners = arrays.faces[original, :3]
    used = np.zeros(len(arrays.vertices), bool)
    used[corners] = True
    number = np.cumsum(used, dtype=np.uint32) - 1
    mesh = mi.Mesh("scene", vertex_count=np.count_nonzero(used), face_count=len(original))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = on_device(mi.Float, arrays.vertices[used, :3])
    parameters["faces"] = on_device(mi.UInt32, number[corners])
    parameters.update()
    return TriangleSet(mi.load_dict({"type": "scene", "mesh": mesh}), on_device(mi.UInt32, original))
