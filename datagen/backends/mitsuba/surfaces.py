"""What a ray hits: triangles, their surfaces' numbers and textures, looked up in arrays on the device."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.arrays import NONE, SceneArrays
from multilight.datagen.backends.mitsuba.device import on_device
from multilight.scenes.arrays import Mask

VALUES, LINKS = 20, 16
BASE, ROUGH, COAT, REPEAT, REPEAT2 = 0, 4, 8, 12, 16
BASE_TEXTURE, ROUGH_TEXTURE, NORMAL_TEXTURE, GLOW_TEXTURE = 0, 4, 8, 12


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
        self._faces = on_device(mi.UInt32, arrays.faces)
        self._values = on_device(mi.Float, arrays.values)
        self._links = on_device(mi.UInt32, arrays.links)
        self._texels = on_device(mi.UInt32, arrays.texels)
        self.see_through = arrays.see_through
        self.glass = arrays.glass

    def hit(self, face: mi.UInt32, barycentric: mi.Point2f, ray: mi.Ray3f, active: mi.Bool) -> Hit:
        """Look up everything about a point of a triangle (barycentric coordinates of its second and third vertex)."""
        corner = dr.gather(mi.Vector4u, self._faces, face, active)
        (p0, n0, t0), (p1, n1, t1), (p2, n2, t2) = (self._vertex(corner[i], active) for i in range(3))
        b1, b2 = barycentric.x, barycentric.y
        b0 = 1 - b1 - b2
        row = corner[3]
        uv = mi.Point2f(t0 * b0 + t1 * b1 + t2 * b2)
        ng = mi.Normal3f(dr.normalize(dr.cross(p1 - p0, p2 - p0)))
        ns = mi.Normal3f(dr.normalize(n0 * b0 + n1 * b1 + n2 * b2))
        inside = dr.dot(ng, ray.d) > 0
        base = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + BASE // 4, active)
        rough = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + ROUGH // 4, active)
        coat = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + COAT // 4, active)
        repeat = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + REPEAT // 4, active)
        repeat2 = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + REPEAT2 // 4, active)
        links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + BASE_TEXTURE // 4, active)
        rough_links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + ROUGH_TEXTURE // 4, active)
        normal_links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + NORMAL_TEXTURE // 4, active)
        colour, alpha = self._texture(links, uv * mi.Vector2f(repeat.x, repeat.y), active, srgb=True)
        grey, _ = self._texture(rough_links, uv * mi.Vector2f(repeat.z, repeat.w), active)
        ns = self._bumped(normal_links, uv * mi.Vector2f(repeat2.x, repeat2.y), ns, (p0, p1, p2, t0, t1, t2), active)
        flip = dr.select(inside, mi.Float(-1), mi.Float(1))
        return Hit(
            p=mi.Point3f(p0 * b0 + p1 * b1 + p2 * b2),
            ng=mi.Normal3f(ng * flip),
            ns=mi.Normal3f(ns * flip),
            inside=inside,
            uv=uv,
            row=row,
            body=links[3],
            glow=normal_links[3],
            base=mi.Color3f(base.x, base.y, base.z) * colour,
            opacity=base.w * dr.select(rough_links[3] != 0, alpha, 1),
            roughness=rough.x * grey.x,
            metallic=rough.y,
            ior=rough.z,
            coat=rough.w,
            coat_roughness=coat.x,
            transmission=coat.y,
        )

    def glow_texture(self, hit: Hit, active: mi.Bool) -> mi.Color3f:
        """Look up what multiplies a glowing part's radiance."""
        return self._glow_texture(hit.row, hit.uv, active)

    def point_of(self, face: mi.UInt32, barycentric: mi.Point2f) -> tuple[mi.Point3f, mi.Normal3f, mi.Color3f]:
        """Return a triangle's point, its geometric normal and its glow texture, to sample emission."""
        corner = dr.gather(mi.Vector4u, self._faces, face)
        (p0, _, t0), (p1, _, t1), (p2, _, t2) = (self._vertex(corner[i], mi.Bool(True)) for i in range(3))
        b1, b2 = barycentric.x, barycentric.y
        b0 = 1 - b1 - b2
        normal = mi.Normal3f(dr.normalize(dr.cross(p1 - p0, p2 - p0)))
        uv = mi.Point2f(t0 * b0 + t1 * b1 + t2 * b2)
        return mi.Point3f(p0 * b0 + p1 * b1 + p2 * b2), normal, self._glow_texture(corner[3], uv, mi.Bool(True))

    def _glow_texture(self, row: mi.UInt32, uv: mi.Point2f, active: mi.Bool) -> mi.Color3f:
        repeat = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + REPEAT2 // 4, active)
        links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + GLOW_TEXTURE // 4, active)
        return self._texture(links, uv * mi.Vector2f(repeat.z, repeat.w), active, srgb=True)[0]

    def opacity(self, face: mi.UInt32, barycentric: mi.Point2f, active: mi.Bool) -> mi.Float:
        """Return only how opaque a point is, in [0, 1]."""
        corner = dr.gather(mi.Vector4u, self._faces, face, active)
        row = corner[3]
        t0, t1, t2 = (self._vertex(corner[i], active)[2] for i in range(3))
        b1, b2 = barycentric.x, barycentric.y
        uv = mi.Point2f(t0 * (1 - b1 - b2) + t1 * b1 + t2 * b2)
        base = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + BASE // 4, active)
        repeat = dr.gather(mi.Vector4f, self._values, row * (VALUES // 4) + REPEAT // 4, active)
        links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + BASE_TEXTURE // 4, active)
        rough_links = dr.gather(mi.Vector4u, self._links, row * (LINKS // 4) + ROUGH_TEXTURE // 4, active)
        _, alpha = self._texture(links, uv * mi.Vector2f(repeat.x, repeat.y), active, srgb=True)
        return base.w * dr.select(rough_links[3] != 0, alpha, 1)

    def body(self, face: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the number of the body that a triangle belongs to."""
        row = dr.gather(mi.UInt32, self._faces, face * 4 + 3, active)
        return dr.gather(mi.UInt32, self._links, row * LINKS + 3, active)

    def _vertex(self, index: mi.UInt32, active: mi.Bool) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector2f]:
        a = dr.gather(mi.Vector4f, self._vertices, index * 2, active)
        b = dr.gather(mi.Vector4f, self._vertices, index * 2 + 1, active)
        return mi.Vector3f(a.x, a.y, a.z), mi.Vector3f(a.w, b.x, b.y), mi.Vector2f(b.z, b.w)

    def _texture(
        self, links: mi.Vector4u, uv: mi.Vector2f, active: mi.Bool, *, srgb: bool = False
    ) -> tuple[mi.Color3f, mi.Float]:
        """Interpolate a repeating texture; white and opaque where there is none.

        Encoded values are interpolated and then decoded, as Cycles does with 8-bit files.
        """
        there = active & (links.x != NONE)
        width, height = mi.Float(links.y), mi.Float(links.z)
        x = (uv.x - dr.floor(uv.x)) * width - 0.5
        y = (1 - (uv.y - dr.floor(uv.y))) * height - 0.5
        x0, y0 = dr.floor(x), dr.floor(y)
        fx, fy = x - x0, y - y0
        left = mi.UInt32(dr.select(x0 < 0, width - 1, x0))
        top = mi.UInt32(dr.select(y0 < 0, height - 1, y0))
        right = dr.select(left + 1 >= links.y, 0, left + 1)
        bottom = dr.select(top + 1 >= links.z, 0, top + 1)
        total = mi.Vector4f(0)
        corners = ((left, top, (1 - fx) * (1 - fy)), (right, top, fx * (1 - fy)),
                   (left, bottom, (1 - fx) * fy), (right, bottom, fx * fy))  # fmt: skip
        for column, line, weight in corners:
            word = dr.gather(mi.UInt32, self._texels, links.x + line * links.y + column, there)
            total += mi.Vector4f(*(mi.Float((word >> shift) & 0xFF) for shift in (0, 8, 16, 24))) * (weight / 255)
        colour = mi.Color3f(total.x, total.y, total.z)
        if srgb:
            colour = _linear_from_srgb(colour)
        return dr.select(there, colour, 1), dr.select(there, total.w, 1)

    def _bumped(
        self, links: mi.Vector4u, uv: mi.Vector2f, ns: mi.Normal3f, corners: tuple, active: mi.Bool
    ) -> mi.Normal3f:
        """Turn a shading normal by a tangent-space normal map (red along u, green along v)."""
        p0, p1, p2, t0, t1, t2 = corners
        there = active & (links.x != NONE)
        colour, _ = self._texture(links, uv, there)
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


def _linear_from_srgb(c: mi.Color3f) -> mi.Color3f:
    """Decode sRGB (IEC 61966-2-1)."""
    return dr.select(c <= 0.04045, c / 12.92, dr.power((c + 0.055) / 1.055, 2.4))


@dataclass
class Soup:
    """Some of a scene's triangles, accelerated. `original` holds, for each of them, its number in the whole scene."""

    scene: mi.Scene
    original: mi.UInt32

    def face(self, found: mi.PreliminaryIntersection3f, active: mi.Bool) -> mi.UInt32:
        """Return the number, in the whole scene, of the triangle that a ray met."""
        return dr.gather(mi.UInt32, self.original, found.prim_index, active)


def build(arrays: SceneArrays, chosen: Mask) -> Soup | None:
    """Build an acceleration structure over the chosen triangles; None where there are none."""
    original = np.flatnonzero(chosen).astype(np.uint32)
    if not original.size:
        return None
    mesh = mi.Mesh("scene", vertex_count=len(arrays.vertices), face_count=len(original))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = on_device(mi.Float, arrays.vertices[:, :3])
    parameters["faces"] = on_device(mi.UInt32, arrays.faces[original, :3])
    parameters.update()
    return Soup(mi.load_dict({"type": "scene", "mesh": mesh}), on_device(mi.UInt32, original))
