"""The lights of `lights.spec`, sampled from a point and met by rays. Values are radiance per colour channel.

Each has `sample(p, u)`, a direction from p, and `met(o, d)`: the distance at which a ray meets it, its radiance there
and the density [1/sr] of sampling d from o. `delta` ones are found by sampling only; `distant` ones lie beyond
everything, and only rays that leave the scene meet them.

Numbers that differ from scene to scene are opaque to the compiler, so that rigs of the same make-up share a kernel.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

from multilight.datagen.backends.mitsuba.arrays import SceneArrays
from multilight.datagen.backends.mitsuba.device import CLAMPED, on_device, opaque
from multilight.datagen.backends.mitsuba.surfaces import Surfaces
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import Rgb, Vector3

FAR = 1e8


@dataclass
class Sample:
    """A direction towards a light: unit d, distance [m], radiance over density, density [1/sr] (0 where missed)."""

    d: mi.Vector3f
    distance: mi.Float
    weight: mi.Color3f
    pdf: mi.Float


def _vector(value: Vector3 | Float64) -> mi.Vector3f:
    return mi.Vector3f(*(opaque(v) for v in value))


def _color(value: Rgb) -> mi.Color3f:
    return mi.Color3f(*(opaque(v) for v in value))


def _grey(path: Path) -> Float32:
    """Read an image as (H, W, 1) float32 in [0, 1], without decoding."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("L"), np.float32)[..., None] / 255


class Environment:
    """An equirectangular map, importance-sampled by Mitsuba's `envmap`."""

    delta, distant = False, True

    def __init__(self, light: EnvironmentLight, library: AssetLibrary) -> None:
        self._scale = _color(light.radiance)
        pixels = np.ones((4, 8, 3), np.float32)
        if light.map is not None:
            pixels = read_environment(library.environment_path(light.map))
        about_z = mi.ScalarTransform4f().rotate([0, 0, 1], math.degrees(light.rotation))
        # Mitsuba's maps have +Y up and their centre column along +Z.
        axes = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
        parts = {"type": "envmap", "bitmap": mi.Bitmap(_rows_at_poles(pixels)), "to_world": about_z @ axes}
        # An emitter works only as part of a scene; this one has nothing else.
        self._scene = mi.load_dict({"type": "scene", "ball": {"type": "sphere"}, "map": parts})
        self._map = self._scene.environment()

    def sample(self, p: mi.Point3f, u: mi.Point2f) -> Sample:
        """Sample by the map's brightness."""
        it = dr.zeros(mi.Interaction3f)
        it.p = p
        found, weight = self._map.sample_direction(it, u)
        return Sample(found.d, mi.Float(FAR), weight * self._scale, found.pdf)

    def met(self, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Color3f, mi.Float]:
        """Look the map up."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -d
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = d
        return mi.Float(FAR), self._map.eval(si) * self._scale, self._map.pdf_direction(si, ds)


def _rows_at_poles(pixels: Float32) -> Float32:
    """Put rows between the rows: Mitsuba's first and last row lie on the poles, ours half a row off.

    Interpolated as Mitsuba does, the result is the map interpolated as we do.
    """
    between = (pixels[1:] + pixels[:-1]) / 2
    result = np.empty((2 * len(pixels) + 1, *pixels.shape[1:]), np.float32)
    result[1::2] = pixels
    result[2:-1:2] = between
    result[0], result[-1] = pixels[0].mean(axis=0), pixels[-1].mean(axis=0)
    return result


class Sun:
    """A disc infinitely far away, or a single direction."""

    distant = True

    def __init__(self, light: SunLight) -> None:
        towards = -np.array(light.direction) / np.linalg.norm(light.direction)
        self._frame = mi.Frame3f(mi.Normal3f(_vector(towards)))
        self.delta = light.angle < 1e-5
        half = max(light.angle / 2, 1e-5)
        self._cosine = opaque(math.cos(half))
        # 1 - cos, without the digits that float32 would lose.
        self._cap = opaque(2 * math.sin(half / 2) ** 2)
        self._irradiance = _color(light.irradiance)
        self._radiance = self._irradiance / (dr.pi * opaque(math.sin(half) ** 2))

    def sample(self, p: mi.Point3f, u: mi.Point2f) -> Sample:
        """Sample the disc uniformly."""
        if self.delta:
            return Sample(mi.Vector3f(self._frame.n), mi.Float(FAR), self._irradiance, mi.Float(1))
        d = self._frame.to_world(_in_cap(self._cap, u))
        pdf = dr.rcp(2 * dr.pi * self._cap)
        return Sample(mi.Vector3f(d), mi.Float(FAR), self._radiance / pdf, mi.Float(pdf))

    def met(self, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Color3f, mi.Float]:
        """Meet the disc, beyond everything."""
        # |d - n|^2 = 2 (1 - cos), again for the digits.
        inside = dr.squared_norm(d - mi.Vector3f(self._frame.n)) <= 2 * self._cap
        return mi.Float(FAR), dr.select(inside, self._radiance, 0), dr.select(inside, dr.rcp(2 * dr.pi * self._cap), 0)


def _in_cap(cap: mi.Float, u: mi.Point2f) -> mi.Vector3f:
    """Sample a direction uniformly within `cap` = 1 - cos of +Z."""
    down = u.x * cap
    sine = dr.sqrt(dr.maximum(down * (2 - down), 0))
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * u.y)
    return mi.Vector3f(sine * cos_phi, sine * sin_phi, 1 - down)


class Bulb:
    """A point light or a spot: a sphere or a single point, whose intensity depends on the direction."""

    distant = False

    def __init__(self, light: PointLight | SpotLight, library: AssetLibrary) -> None:
        self.delta = light.radius == 0
        self._p = mi.Point3f(_vector(light.position))
        self._radius = opaque(max(light.radius, 1e-6))
        self._intensity = _color(light.intensity)
        self._axis = _vector(np.array(light.direction) / np.linalg.norm(light.direction))
        self._cone = isinstance(light, SpotLight)
        self._picture: mi.Texture1f | mi.Texture2f | None = None
        if isinstance(light, SpotLight):
            edge = math.cos(light.half_angle)
            self._edge = opaque(edge)
            self._soft = opaque(1 / max((1 - edge) * light.blend, 1e-6))
            if light.gobo is not None:
                frame = spot_frame(light.direction, light.roll)
                self._right, self._up = _vector(frame[:, 0]), _vector(frame[:, 1])
                self._slope = opaque(math.tan(light.half_angle))
                self._picture = mi.Texture2f(mi.TensorXf(_grey(library.texture_path(light.gobo))), **CLAMPED)
        elif light.profile is not None:
            self._count = opaque(len(light.profile))
            self._picture = mi.Texture1f(mi.TensorXf(np.array(light.profile, np.float32)[:, None]), **CLAMPED)

    def _shape(self, d: mi.Vector3f) -> mi.Float:
        """Return the intensity's factor for light that travels along d."""
        cosine = dr.dot(d, self._axis)
        if not self._cone:
            if self._picture is None:
                return mi.Float(1)
            place = dr.safe_acos(cosine) * dr.inv_pi
            return self._picture.eval(mi.Point1f((place * (self._count - 1) + 0.5) / self._count))[0]
        x = dr.clip((cosine - self._edge) * self._soft, 0, 1)
        factor = x * x * (3 - 2 * x)
        if self._picture is not None:
            scale = 0.5 / (dr.maximum(cosine, 1e-4) * self._slope)
            across, down = dr.dot(d, self._right) * scale, dr.dot(d, self._up) * scale
            factor *= self._picture.eval(mi.Point2f(0.5 + across, 0.5 - down))[0]
        return factor

    def sample(self, p: mi.Point3f, u: mi.Point2f) -> Sample:
        """Sample the cone that the sphere fills."""
        offset = self._p - p
        distance2 = dr.squared_norm(offset)
        distance = dr.sqrt(distance2)
        axis = offset / distance
        intensity = self._intensity * self._shape(-axis)
        if self.delta:
            return Sample(mi.Vector3f(axis), distance, intensity / distance2, mi.Float(1))
        cap = _cap_of(self._radius, distance2)
        d = mi.Vector3f(mi.Frame3f(mi.Normal3f(axis)).to_world(_in_cap(cap, u)))
        hit, _ = self._met_sphere(p, d)
        pdf = dr.rcp(2 * dr.pi * cap)
        there = distance2 > dr.square(self._radius)
        radiance = intensity / (dr.pi * dr.square(self._radius))
        return Sample(d, dr.select(hit > 0, hit, distance), radiance / pdf, dr.select(there, pdf, 0))

    def met(self, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Color3f, mi.Float]:
        """Meet the sphere."""
        distance, offset = self._met_sphere(o, d)
        radiance = self._intensity * self._shape(-dr.normalize(offset)) / (dr.pi * dr.square(self._radius))
        pdf = dr.rcp(2 * dr.pi * _cap_of(self._radius, dr.squared_norm(offset)))
        hit = distance > 0
        return dr.select(hit, distance, dr.inf), dr.select(hit, radiance, 0), dr.select(hit, pdf, 0)

    def _met_sphere(self, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Vector3f]:
        """Return the distance to the sphere's front along a ray, 0 where it misses or starts inside."""
        offset = self._p - o
        along = dr.dot(offset, d)
        beside2 = dr.squared_norm(offset - d * along)
        root = dr.square(self._radius) - beside2
        distance = along - dr.sqrt(dr.maximum(root, 0))
        return dr.select((root > 0) & (distance > 0), distance, 0), mi.Vector3f(offset)


def _cap_of(radius: mi.Float, distance2: mi.Float) -> mi.Float:
    """Return 1 - cos of the cone that a sphere fills."""
    sine2 = dr.minimum(dr.square(radius) / distance2, 1)
    return sine2 / (1 + dr.sqrt(1 - sine2))


class Panel:
    """A one-sided rectangle or ellipse, sampled by area."""

    delta, distant = False, False

    def __init__(self, light: AreaLight) -> None:
        pose = np.array(light.world_from_light)
        self._p = mi.Point3f(_vector(pose[:3, 3]))
        self._x, self._y, self._n = (_vector(pose[:3, 0]), _vector(pose[:3, 1]), _vector(-pose[:3, 2]))
        self._width, self._height = opaque(light.width), opaque(light.height)
        self._round = light.shape == "disk"
        filled = math.pi / 4 if self._round else 1.0
        self._area = opaque(light.width * light.height * filled)
        self._radiance = _color(light.radiance)

    def sample(self, p: mi.Point3f, u: mi.Point2f) -> Sample:
        """Sample the area uniformly."""
        local = mi.warp.square_to_uniform_disk_concentric(u) * 0.5 if self._round else u - 0.5
        point = self._p + self._x * (local.x * self._width) + self._y * (local.y * self._height)
        offset = point - p
        distance2 = dr.squared_norm(offset)
        distance = dr.sqrt(distance2)
        d = mi.Vector3f(offset / distance)
        cosine = -dr.dot(d, self._n)
        pdf = dr.select(cosine > 1e-6, distance2 / (dr.maximum(cosine, 1e-6) * self._area), 0)
        return Sample(d, distance, dr.select(pdf > 0, self._radiance / pdf, 0), pdf)

    def met(self, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Color3f, mi.Float]:
        """Meet the side that shines."""
        cosine = -dr.dot(d, self._n)
        distance = dr.dot(o - self._p, self._n) / dr.maximum(cosine, 1e-6)
        local = o + d * distance - self._p
        x, y = dr.dot(local, self._x) / self._width, dr.dot(local, self._y) / self._height
        within = (x * x + y * y < 0.25) if self._round else (dr.abs(x) < 0.5) & (dr.abs(y) < 0.5)
        hit = within & (cosine > 1e-6) & (distance > 0)
        pdf = dr.square(distance) / (dr.maximum(cosine, 1e-6) * self._area)
        return dr.select(hit, distance, dr.inf), dr.select(hit, self._radiance, 0), dr.select(hit, pdf, 0)


class Glow:
    """A glowing part of a body, sampled by area, shining on both sides. Rays meet it as a surface of the scene."""

    delta, distant = False, False

    def __init__(self, light: EmissiveLight, number: int, arrays: SceneArrays, surfaces: Surfaces) -> None:
        row = int(np.flatnonzero(arrays.links["glow"] == number)[0])
        self.body = dr.opaque(mi.UInt32, int(arrays.links[row]["body"]))
        faces = np.flatnonzero(arrays.faces[:, 3] == row)
        corners = arrays.vertices[arrays.faces[faces, :3].astype(np.int64), :3].astype(np.float64)
        sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        areas = np.linalg.norm(np.cross(*sides), axis=1) / 2
        self._surfaces = surfaces
        self._faces = on_device(mi.UInt32, faces.astype(np.uint32))
        self._choice = mi.DiscreteDistribution(on_device(mi.Float, areas.astype(np.float32)))
        self._area = opaque(float(areas.sum()))
        self._radiance = _color(light.radiance)

    def sample(self, p: mi.Point3f, u: mi.Point2f) -> Sample:
        """Sample the triangles' area uniformly."""
        chosen, rest = self._choice.sample_reuse(u.y)
        face = dr.gather(mi.UInt32, self._faces, chosen)
        barycentric = mi.warp.square_to_uniform_triangle(mi.Point2f(u.x, rest))
        point, normal, texture = self._surfaces.point_of(face, barycentric)
        offset = point - p
        distance = dr.norm(offset)
        d = mi.Vector3f(offset / distance)
        pdf = self.density(dr.dot(d, normal), distance)
        return Sample(d, distance, dr.select(pdf > 0, self._radiance * texture / pdf, 0), pdf)

    def density(self, cosine: mi.Float, distance: mi.Float) -> mi.Float:
        """Return the density [1/sr] of sampling a point at this angle and distance."""
        return dr.square(distance) / (dr.maximum(dr.abs(cosine), 1e-6) * self._area)

    def radiance(self) -> mi.Color3f:
        """Return the radiance before the texture."""
        return self._radiance


AnyEmitter = Environment | Sun | Bulb | Panel | Glow


def emitters_of(rig: LightRig, arrays: SceneArrays, surfaces: Surfaces, library: AssetLibrary) -> list[AnyEmitter]:
    """Make the emitters of a rig, in its order."""

    def made(number: int, light: Light) -> AnyEmitter:
        match light:
            case EnvironmentLight():
                return Environment(light, library)
            case SunLight():
                return Sun(light)
            case PointLight() | SpotLight():
                return Bulb(light, library)
            case AreaLight():
                return Panel(light)
            case EmissiveLight():
                return Glow(light, number, arrays, surfaces)

    return [made(number, light) for number, light in enumerate(rig.lights)]
