"""Spheres and rectangles met in closed form: ray hits, and the fraction of a hemisphere that each fills.

Vectors are held as (3, N) float64 arrays, so that every operation runs over contiguous memory and rounds each
point alike whatever its neighbours: a body that shadows nothing can be taken away without changing one bit.
"""

from dataclasses import dataclass

import numpy as np

from multilight.datagen.backends.protocol import BackendError
from multilight.scenes.arrays import Float64
from multilight.scenes.spec import Body, Material, MeshAsset, Rectangle, SceneSpec, Sphere

PLAIN = "the analytic renderer draws plain diffuse spheres and rectangles: use the renderer cycles for it"
_TOUCH = 1e-9
"""Distance in metres below which a ray's start counts as lying on a surface."""


def dot(a: Float64, b: Float64) -> Float64:
    """Return the dot products of (3, N) or (3,) vectors."""
    total = a[0] * b[0]
    total += a[1] * b[1]
    total += a[2] * b[2]
    return total


def cross(a: Float64, b: Float64) -> Float64:
    """Return the cross products of (3, N) vectors."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def column(vector: Float64 | tuple[float, ...]) -> Float64:
    """Return one vector as (3, 1)."""
    return np.asarray(vector, np.float64).reshape(3, 1)


@dataclass(frozen=True)
class Ball:
    """A sphere: `number` is its instance id, centre and radius in metres."""

    name: str
    number: int
    material: Material
    centre: Float64
    radius: float

    def hit(self, origin: Float64, direction: Float64) -> Float64:
        """Return the distance to the first hit of unit rays from outside, inf where they miss: (N,) metres."""
        to_centre = self.centre - origin
        along = dot(direction, to_centre)
        reach = along * along - dot(to_centre, to_centre) + self.radius**2
        near = along - np.sqrt(np.maximum(reach, 0.0))
        return np.where((reach > 0.0) & (near > _TOUCH), near, np.inf)

    def normal(self, points: Float64) -> Float64:
        """Return the outward unit normals at surface points, (3, N)."""
        return (points - self.centre) / self.radius

    def form_factor(self, points: Float64, normals: Float64) -> Float64:
        """Return irradiance / (pi * radiance) that an evenly bright sphere gives to surface points, in [0, 1]: (N,).

        Exact, also where the receiver's horizon cuts the sphere: a tilted differential element and a sphere
        (J. R. Howell, A Catalog of Radiation Heat Transfer Configuration Factors, section B; in this form:
        I. Quilez, Sphere Ambient Occlusion). Wholly above the horizon it is cos(theta) (R / d)^2. Points lie
        outside the sphere.
        """
        to_centre = self.centre - points
        distance = np.sqrt(dot(to_centre, to_centre))
        cosine = np.clip(dot(normals, to_centre) / distance, -1.0, 1.0)
        ratio2 = np.maximum((distance / self.radius) ** 2, 1.0 + 1e-12)
        factor = np.maximum(cosine, 0.0) / ratio2
        cut = 1.0 - ratio2 * cosine**2 > 1e-9
        c, h2 = cosine[cut], ratio2[cut]
        k = np.sqrt(1.0 - h2 * c * c)
        root = np.sqrt(h2 - 1.0)
        angle = np.arccos(np.clip(-c * root / np.sqrt(1.0 - c * c), -1.0, 1.0))
        factor[cut] = ((c * angle - k * root) / h2 + np.arctan(k / root)) / np.pi
        return np.maximum(factor, 0.0)


@dataclass(frozen=True)
class Plate:
    """A two-sided rectangle: `axes` (3, 3) are its unit x, y and normal as rows, half sizes in metres."""

    name: str
    number: int
    material: Material
    centre: Float64
    axes: Float64
    half_width: float
    half_height: float

    def hit(self, origin: Float64, direction: Float64) -> Float64:
        """Return the distance to the hit of unit rays, inf where they miss: (N,) metres."""
        to_centre = self.centre - origin
        slope = dot(self.axes[2], direction)
        height = dot(self.axes[2], to_centre)
        flat = np.abs(slope) < 1e-12
        distance = np.where(flat, np.inf, height / np.where(flat, 1.0, slope))
        there = np.where(flat, 0.0, distance)
        x = there * dot(self.axes[0], direction) - dot(self.axes[0], to_centre)
        y = there * dot(self.axes[1], direction) - dot(self.axes[1], to_centre)
        inside = (np.abs(x) <= self.half_width) & (np.abs(y) <= self.half_height) & (distance > _TOUCH)
        return np.where(inside, distance, np.inf)

    def normal(self, points: Float64) -> Float64:
        """Return the plate's unit normal for each point, (3, N)."""
        return np.broadcast_to(column(self.axes[2]), points.shape)

    def form_factor(self, points: Float64, normals: Float64) -> Float64:
        """Return irradiance / (pi * radiance) that an evenly bright plate gives to surface points, in [0, 1]: (N,).

        Exact: Lambert's formula for a polygon, the polygon clipped at the receiver's horizon (J. Arvo, Analytic
        Methods for Simulated Light Transport, 1995, ch. 2). The plate counts from both sides.
        """
        x, y = self.half_width * self.axes[0], self.half_height * self.axes[1]
        corners = [self.centre + column(x * i + y * j) - points for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        heights = [dot(normals, corner) for corner in corners]
        total = np.zeros(points.shape[1])
        leave, enter = np.zeros_like(points), np.zeros_like(points)
        for i in range(4):
            a, b, ha, hb = corners[i], corners[(i + 1) % 4], heights[i], heights[(i + 1) % 4]
            sinks, rises = (ha >= 0) & (hb < 0), (ha < 0) & (hb >= 0)
            spread = ha - hb
            crossing = a + (b - a) * (ha / np.where(spread == 0, 1.0, spread))
            leave, enter = np.where(sinks, crossing, leave), np.where(rises, crossing, enter)
            start, end = np.where(rises, crossing, a), np.where(sinks, crossing, b)
            total += np.where((ha >= 0) | (hb >= 0), _edge_term(start, end, normals), 0.0)
        total += _edge_term(leave, enter, normals)
        return np.abs(total) / (2.0 * np.pi)


def _edge_term(a: Float64, b: Float64, normals: Float64) -> Float64:
    """Return angle(a, b) * unit(a x b) . normal, 0 where the edge has no extent; (N,)."""
    across = cross(a, b)
    sine = np.sqrt(dot(across, across))
    angle = np.arctan2(sine, dot(a, b))
    return angle * dot(across, normals) / np.where(sine == 0.0, 1.0, sine)


Shape = Ball | Plate


def shapes_of(scene: SceneSpec, without: str | None = None) -> tuple[Shape, ...]:
    """Return the scene's bodies as shapes, but for `without`; raises `BackendError` naming a body it cannot draw."""
    return tuple(_shape(scene, body) for body in scene.bodies if body.name != without)


def _shape(scene: SceneSpec, body: Body) -> Shape:
    """Turn one body into a shape."""
    material = body.materials[0]
    _check_plain(body.name, material)
    number = scene.instance_id(body.name)
    pose = np.array(body.world_from_body, np.float64)
    scale = float(np.cbrt(np.linalg.det(pose[:3, :3])))
    if not np.allclose(pose[:3, :3].T @ pose[:3, :3], scale**2 * np.eye(3), atol=1e-6 * scale**2):
        raise BackendError(f"body {body.name!r} is sheared or scaled unevenly: give it a rotation and one scale")
    centre = column(pose[:3, 3])
    match body.geometry:
        case Sphere(radius=radius):
            return Ball(body.name, number, material, centre, radius * scale)
        case Rectangle(width=width, height=height):
            axes = pose[:3, :3].T / scale
            return Plate(body.name, number, material, centre, axes, width * scale / 2, height * scale / 2)
        case MeshAsset():
            raise BackendError(f"body {body.name!r} is a mesh; {PLAIN}")


def _check_plain(name: str, material: Material) -> None:
    """Raise `BackendError` unless a material is plain; the principled model's dielectric gloss is left out."""
    fancy = [
        key
        for key in ("base_color_texture", "roughness_texture", "normal_texture", "opacity_from_alpha",
                    "metallic", "transmission", "coat")
        if getattr(material, key)
    ]  # fmt: skip
    if material.opacity < 1.0:
        fancy.append("opacity")
    if fancy:
        raise BackendError(f"body {name!r} has a material with {', '.join(fancy)}; {PLAIN}")
