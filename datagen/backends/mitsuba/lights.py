"""The lights of `lights.spec`, sampled from a point and met by rays. Values are radiance per colour channel.

A rig is a table, a row a light, so that one compiled kernel serves all rigs that have as many environments.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from PIL import Image

from multilight.datagen.backends.mitsuba.arrays import NONE, SceneArrays
from multilight.datagen.backends.mitsuba.device import Row, Table, on_device
from multilight.datagen.backends.mitsuba.surfaces import Surfaces
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, LightRig, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float32, UInt32
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.library import AssetLibrary

FAR = 1e8
T = TypeVar("T")
ENVIRONMENT, SUN, BULB, PANEL, GLOW = range(5)
"""Kinds of light: a bulb is a point light or a spot, a sphere or a single point; a panel shines on one side."""
VALUES = np.dtype([
    ("colour", np.float32, 3), ("radius", np.float32),
    ("position", np.float32, 3), ("area", np.float32),
    ("axis", np.float32, 3), ("cap", np.float32),
    ("right", np.float32, 3), ("width", np.float32),
    ("up", np.float32, 3), ("height", np.float32),
    ("edge", np.float32), ("soft", np.float32), ("slope", np.float32), ("unused", np.float32),
])  # fmt: skip
"""A light's numbers, of which each kind has some. `colour`: radiance, of bulbs intensity [W/sr], of a sun without a
width irradiance; `axis`: where it shines, of a sun where it is; `cap`: 1 - cos of half a sun's angle."""
LINKS = np.dtype([
    ("kind", np.uint32), ("form", np.uint32), ("delta", np.uint32), ("own", np.uint32),
    ("picture", np.uint32, 3), ("unused", np.uint32),
    ("first", np.uint32), ("count", np.uint32), ("unused_too", np.uint32, 2),
])  # fmt: skip
"""What it is. `form`: whether a bulb is a spot, a panel an ellipse; `delta` ones are found by sampling only; `own`: the
bit of the body that glows. `picture`: offset, width and height of what shapes a bulb's light; `first`, `count`: a
glowing part's faces."""


@dataclass
class Sample:
    """A direction towards a light: unit d, distance [m], radiance over density, density [1/sr] (0 where missed)."""

    d: mi.Vector3f
    distance: mi.Float
    weight: mi.Color3f
    pdf: mi.Float


@dataclass
class Meeting:
    """What a ray meets of a light: the distance [m], infinite where it passes by, the radiance there, and the density
    [1/sr] of sampling its direction."""

    distance: mi.Float
    radiance: mi.Color3f
    pdf: mi.Float


class Environment:
    """An equirectangular map, importance-sampled by Mitsuba's `envmap`."""

    def __init__(self, number: int, light: EnvironmentLight, library: AssetLibrary) -> None:
        self.number = dr.opaque(mi.UInt32, number)
        self._scale = mi.Color3f(*(dr.opaque(mi.Float, float(value)) for value in light.radiance))
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

    def met(self, d: mi.Vector3f) -> Meeting:
        """Look the map up."""
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi = -d
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = d
        return Meeting(mi.Float(FAR), self._map.eval(si) * self._scale, self._map.pdf_direction(si, ds))


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


class Lights:
    """A rig on the device. Lights go by their number in it, which may differ from lane to lane.

    `bits`: by body number, the bit of a removable body, else 0.
    """

    def __init__(
        self, rig: LightRig, arrays: SceneArrays, bits: UInt32, surfaces: Surfaces, library: AssetLibrary
    ) -> None:
        rows = _Rows(rig, arrays, bits, library)
        self.count = len(rig.lights)
        self.end = dr.opaque(mi.UInt32, self.count)
        met = (rows.links["delta"] == 0) & np.isin(rows.links["kind"], (SUN, BULB, PANEL))
        self.lamps = dr.opaque(mi.UInt32, np.count_nonzero(met))
        self._lamps = on_device(mi.UInt32, np.concatenate([np.flatnonzero(met), [0, 0]]).astype(np.uint32))
        self.environments = [
            Environment(number, light, library)
            for number, light in enumerate(rig.lights)
            if isinstance(light, EnvironmentLight)
        ]
        self._tables = Table(mi.Float, rows.values), Table(mi.UInt32, rows.links)
        self._picture = on_device(mi.Float, rows.pictures)
        self._faces, self._share = on_device(mi.UInt32, rows.faces), on_device(mi.Float, rows.share)
        self._below = on_device(mi.Float, rows.below)
        self._surfaces = surfaces

    def row(self, number: mi.UInt32, active: mi.Bool) -> Row:
        """Return the numbers of a light."""
        return Row(self._tables, number, active)

    def lamp(self, place: mi.UInt32, active: mi.Bool) -> mi.UInt32:
        """Return the number of one of the `lamps` that rays can meet beside surfaces: suns, bulbs and panels."""
        return dr.gather(mi.UInt32, self._lamps, place, active)

    def sample(self, number: mi.UInt32, p: mi.Point3f, u: mi.Point2f, active: mi.Bool) -> Sample:
        """Sample a direction from p towards a light."""
        kind = self.row(number, active)["kind"]
        found = Sample(mi.Vector3f(0, 0, 1), mi.Float(FAR), mi.Color3f(0), mi.Float(0))
        ways: list[tuple[mi.Bool, Callable[[Row], Sample]]] = [
            (kind == SUN, lambda row: _sample_sun(row, u)),
            (kind == BULB, lambda row: self._sample_bulb(number, row, p, u, active)),
            (kind == PANEL, lambda row: _sample_panel(row, p, u)),
            (kind == GLOW, lambda row: self._sample_glow(row, p, u, active)),
            *((number == sky.number, lambda _, sky=sky: sky.sample(p, u)) for sky in self.environments),
        ]
        return self._by_kind(found, ways, number, active)

    def met(self, number: mi.UInt32, o: mi.Point3f, d: mi.Vector3f, active: mi.Bool) -> Meeting:
        """Meet one of the `lamps`."""
        kind = self.row(number, active)["kind"]
        found = Meeting(mi.Float(dr.inf), mi.Color3f(0), mi.Float(0))
        ways: list[tuple[mi.Bool, Callable[[Row], Meeting]]] = [
            (kind == SUN, lambda row: _meet_sun(row, d)),
            (kind == BULB, lambda row: self._meet_bulb(number, row, o, d, active)),
            (kind == PANEL, lambda row: _meet_panel(row, o, d)),
        ]
        return self._by_kind(found, ways, number, active)

    def _by_kind(
        self, found: T, ways: list[tuple[mi.Bool, Callable[[Row], T]]], number: mi.UInt32, active: mi.Bool
    ) -> T:
        """Compute what a light's kind asks for; the others are passed over, not computed and thrown away."""
        for here, way in ways:
            # What a branch reads is known in it alone, so each has a row of its own.
            found = dr.if_stmt(
                (found,), active & here, lambda _, way=way: way(self.row(number, active)), lambda found: found
            )
        return found

    def _shape(self, number: mi.UInt32, cosine: mi.Float, d: mi.Vector3f, active: mi.Bool) -> mi.Float:
        """Return the factor of a bulb's intensity for light that travels along d, at an angle to the axis."""
        links = self.row(number, active)
        spot = links["form"] != 0

        def cone(_: mi.Float) -> mi.Float:
            row = self.row(number, spot)
            x = dr.clip((cosine - row["edge"]) * row["soft"], 0, 1)
            return x * x * (3 - 2 * x)

        def picture(factor: mi.Float) -> mi.Float:
            row = self.row(number, shaped)
            scale = 0.5 / (dr.maximum(cosine, 1e-4) * row["slope"])
            across, down = dr.dot(d, mi.Vector3f(row["right"])) * scale, dr.dot(d, mi.Vector3f(row["up"])) * scale
            place = dr.safe_acos(cosine) * dr.inv_pi * (mi.Float(width) - 1)
            x = dr.select(spot, (0.5 + across) * mi.Float(width) - 0.5, place)
            y = dr.select(spot, (0.5 - down) * mi.Float(height) - 0.5, 0)
            return factor * self._looked_up(offset, width, height, x, y, shaped)

        factor = dr.if_stmt((mi.Float(1),), active & spot, cone, lambda factor: factor)
        offset, width, height = links["picture"]
        shaped = active & (offset != NONE)
        return dr.if_stmt((factor,), shaped, picture, lambda factor: factor)

    def _looked_up(
        self, offset: mi.UInt32, width: mi.UInt32, height: mi.UInt32, x: mi.Float, y: mi.Float, there: mi.Bool
    ) -> mi.Float:
        """Interpolate a picture at pixels x, y; beyond its edges it goes on with them."""
        x, y = dr.clip(x, 0, mi.Float(width) - 1), dr.clip(y, 0, mi.Float(height) - 1)
        left, top = mi.UInt32(x), mi.UInt32(y)
        right, bottom = dr.minimum(left + 1, width - 1), dr.minimum(top + 1, height - 1)
        fx, fy = x - mi.Float(left), y - mi.Float(top)

        def line(number: mi.UInt32) -> mi.Float:
            start = offset + number * width
            a, b = (dr.gather(mi.Float, self._picture, start + column, there) for column in (left, right))
            return dr.lerp(a, b, fx)

        return dr.lerp(line(top), line(bottom), fy)

    def _sample_bulb(self, number: mi.UInt32, row: Row, p: mi.Point3f, u: mi.Point2f, active: mi.Bool) -> Sample:
        """Sample the cone that the sphere fills."""
        delta, radius = row["delta"] != 0, row["radius"]
        offset = mi.Point3f(row["position"]) - p
        distance2 = dr.squared_norm(offset)
        distance = dr.sqrt(distance2)
        axis = offset / distance
        intensity = mi.Color3f(row["colour"]) * self._shape(
            number, -dr.dot(axis, mi.Vector3f(row["axis"])), -axis, active
        )
        cap = _cap_of(radius, distance2)
        d = mi.Vector3f(mi.Frame3f(mi.Normal3f(axis)).to_world(_in_cap(cap, u)))
        hit, _ = _met_sphere(row, p, d)
        pdf = dr.rcp(2 * dr.pi * cap)
        radiance = intensity / (dr.pi * dr.square(radius))
        return Sample(
            dr.select(delta, mi.Vector3f(axis), d),
            dr.select(~delta & (hit > 0), hit, distance),
            dr.select(delta, intensity / distance2, radiance / pdf),
            dr.select(delta, 1, dr.select(distance2 > dr.square(radius), pdf, 0)),
        )

    def _meet_bulb(self, number: mi.UInt32, row: Row, o: mi.Point3f, d: mi.Vector3f, active: mi.Bool) -> Meeting:
        distance, offset = _met_sphere(row, o, d)
        area, along = dr.pi * dr.square(row["radius"]), -dr.normalize(offset)
        radiance = (
            mi.Color3f(row["colour"])
            * self._shape(number, dr.dot(along, mi.Vector3f(row["axis"])), along, active)
            / area
        )
        pdf = dr.rcp(2 * dr.pi * _cap_of(row["radius"], dr.squared_norm(offset)))
        hit = distance > 0
        return Meeting(dr.select(hit, distance, dr.inf), dr.select(hit, radiance, 0), dr.select(hit, pdf, 0))

    def _sample_glow(self, row: Row, p: mi.Point3f, u: mi.Point2f, active: mi.Bool) -> Sample:
        """Sample the triangles' area uniformly."""
        chosen, rest = self._face_of(row, u.y, active)
        face = dr.gather(mi.UInt32, self._faces, chosen, active)
        barycentric = mi.warp.square_to_uniform_triangle(mi.Point2f(u.x, rest))
        point, normal, texture = self._surfaces.point_of(face, barycentric)
        offset = point - p
        distance = dr.norm(offset)
        d = mi.Vector3f(offset / distance)
        pdf = glow_density(row, dr.dot(d, normal), distance)
        return Sample(d, distance, dr.select(pdf > 0, mi.Color3f(row["colour"]) * texture / pdf, 0), pdf)

    def _face_of(self, row: Row, u: mi.Float, active: mi.Bool) -> tuple[mi.UInt32, mi.Float]:
        """Choose a glowing face by area; returns its place among all of them, and a number in [0, 1) that is left."""
        first, last = row["first"], row["first"] + row["count"] - 1

        def step(low, high):  # type: ignore[no-untyped-def]
            middle = (low + high) >> 1
            beyond = (
                dr.gather(mi.Float, self._below, middle, active) + dr.gather(mi.Float, self._share, middle, active) <= u
            )
            return dr.select(beyond, middle + 1, low), dr.select(beyond, high, middle)

        low, _ = dr.while_loop(
            (mi.UInt32(first), mi.UInt32(last)), lambda low, high: active & (low < high), step, label="faces"
        )
        share = dr.gather(mi.Float, self._share, low, active)
        return low, dr.clip((u - dr.gather(mi.Float, self._below, low, active)) / share, 0, 1)


def glow_density(row: Row, cosine: mi.Float, distance: mi.Float) -> mi.Float:
    """Return the density [1/sr] of sampling a point of a glowing part at this angle and distance."""
    return dr.square(distance) / (dr.maximum(dr.abs(cosine), 1e-6) * row["area"])


def _sample_sun(row: Row, u: mi.Point2f) -> Sample:
    """Sample the disc uniformly; a sun without a width is one direction."""
    delta, axis = row["delta"] != 0, mi.Vector3f(row["axis"])
    d = mi.Frame3f(mi.Normal3f(axis)).to_world(_in_cap(row["cap"], u))
    pdf = dr.rcp(2 * dr.pi * row["cap"])
    colour = mi.Color3f(row["colour"])
    return Sample(
        dr.select(delta, axis, mi.Vector3f(d)),
        mi.Float(FAR),
        dr.select(delta, colour, colour / pdf),
        dr.select(delta, 1, pdf),
    )


def _meet_sun(row: Row, d: mi.Vector3f) -> Meeting:
    """Meet the disc, beyond everything."""
    # |d - n|^2 = 2 (1 - cos), for the digits that float32 would lose.
    inside = dr.squared_norm(d - mi.Vector3f(row["axis"])) <= 2 * row["cap"]
    pdf = dr.rcp(2 * dr.pi * row["cap"])
    return Meeting(mi.Float(FAR), dr.select(inside, mi.Color3f(row["colour"]), 0), dr.select(inside, pdf, 0))


def _in_cap(cap: mi.Float, u: mi.Point2f) -> mi.Vector3f:
    """Sample a direction uniformly within `cap` = 1 - cos of +Z."""
    down = u.x * cap
    sine = dr.sqrt(dr.maximum(down * (2 - down), 0))
    sin_phi, cos_phi = dr.sincos(2 * dr.pi * u.y)
    return mi.Vector3f(sine * cos_phi, sine * sin_phi, 1 - down)


def _met_sphere(row: Row, o: mi.Point3f, d: mi.Vector3f) -> tuple[mi.Float, mi.Vector3f]:
    """Return the distance to a bulb's front along a ray, 0 where it misses or starts inside."""
    offset = mi.Point3f(row["position"]) - o
    along = dr.dot(offset, d)
    beside2 = dr.squared_norm(offset - d * along)
    root = dr.square(row["radius"]) - beside2
    distance = along - dr.sqrt(dr.maximum(root, 0))
    return dr.select((root > 0) & (distance > 0), distance, 0), mi.Vector3f(offset)


def _cap_of(radius: mi.Float, distance2: mi.Float) -> mi.Float:
    """Return 1 - cos of the cone that a sphere fills."""
    sine2 = dr.minimum(dr.square(radius) / distance2, 1)
    return sine2 / (1 + dr.sqrt(1 - sine2))


def _sample_panel(row: Row, p: mi.Point3f, u: mi.Point2f) -> Sample:
    """Sample the area uniformly."""
    disk = mi.warp.square_to_uniform_disk_concentric(u) * 0.5
    local = dr.select(row["form"] != 0, disk, u - 0.5)
    across, down = local.x * row["width"], local.y * row["height"]
    offset = mi.Point3f(row["position"]) + mi.Vector3f(row["right"]) * across + mi.Vector3f(row["up"]) * down - p
    distance2 = dr.squared_norm(offset)
    distance = dr.sqrt(distance2)
    d = mi.Vector3f(offset / distance)
    cosine = -dr.dot(d, mi.Vector3f(row["axis"]))
    pdf = dr.select(cosine > 1e-6, distance2 / (dr.maximum(cosine, 1e-6) * row["area"]), 0)
    return Sample(d, distance, dr.select(pdf > 0, mi.Color3f(row["colour"]) / pdf, 0), pdf)


def _meet_panel(row: Row, o: mi.Point3f, d: mi.Vector3f) -> Meeting:
    """Meet the side that shines."""
    axis, position = mi.Vector3f(row["axis"]), mi.Point3f(row["position"])
    cosine = -dr.dot(d, axis)
    distance = dr.dot(o - position, axis) / dr.maximum(cosine, 1e-6)
    local = o + d * distance - position
    x = dr.dot(local, mi.Vector3f(row["right"])) / row["width"]
    y = dr.dot(local, mi.Vector3f(row["up"])) / row["height"]
    within = dr.select(row["form"] != 0, x * x + y * y < 0.25, (dr.abs(x) < 0.5) & (dr.abs(y) < 0.5))
    hit = within & (cosine > 1e-6) & (distance > 0)
    pdf = dr.square(distance) / (dr.maximum(cosine, 1e-6) * row["area"])
    return Meeting(
        dr.select(hit, distance, dr.inf), dr.select(hit, mi.Color3f(row["colour"]), 0), dr.select(hit, pdf, 0)
    )


class _Rows:
    """A rig's tables: `values` and `links`, the pictures of bulbs end to end, and the faces of glowing parts with each
    one's share of its part's area and that of those before it."""

    def __init__(self, rig: LightRig, arrays: SceneArrays, bits: UInt32, library: AssetLibrary) -> None:
        self._arrays, self._bits, self._library = arrays, bits, library
        self.values, self.links = np.zeros(len(rig.lights), VALUES), np.zeros(len(rig.lights), LINKS)
        self.links["picture"][:, 0] = NONE
        self._pictures: list[Float32] = []
        self._faces: list[UInt32] = []
        self._shares: list[Float32] = []
        self._before: list[Float32] = []
        for number, light in enumerate(rig.lights):
            row, links = self.values[number], self.links[number]
            match light:
                case EnvironmentLight():
                    links["kind"] = ENVIRONMENT
                case SunLight():
                    _write_sun(row, links, light)
                case PointLight() | SpotLight():
                    self._write_bulb(row, links, light)
                case AreaLight():
                    _write_panel(row, links, light)
                case EmissiveLight():
                    self._write_glow(row, links, light, number)
        # Two numbers at least: Dr.Jit reads an array of one as a constant, in a kernel of its own.
        self.pictures = np.concatenate([np.zeros(2, np.float32), *self._pictures])
        self.faces = np.concatenate([np.zeros(2, np.uint32), *self._faces])
        self.share = np.concatenate([np.zeros(2, np.float32), *self._shares])
        self.below = np.concatenate([np.zeros(2, np.float32), *self._before])

    def _write_bulb(self, row: np.void, links: np.void, light: PointLight | SpotLight) -> None:
        links["kind"], links["delta"] = BULB, light.radius == 0
        row["colour"], row["radius"], row["position"] = light.intensity, max(light.radius, 1e-6), light.position
        row["axis"] = np.array(light.direction) / np.linalg.norm(light.direction)
        picture = None
        if isinstance(light, SpotLight):
            links["form"] = 1
            row["edge"] = edge = math.cos(light.half_angle)
            row["soft"] = 1 / max((1 - edge) * light.blend, 1e-6)
            frame = spot_frame(light.direction, light.roll)
            row["right"], row["up"], row["slope"] = frame[:, 0], frame[:, 1], math.tan(light.half_angle)
            if light.gobo is not None:
                picture = _grey(self._library.texture_path(light.gobo))
        elif light.profile is not None:
            picture = np.array(light.profile, np.float32)[None]
        if picture is not None:
            start = 2 + sum(known.size for known in self._pictures)
            links["picture"] = start, picture.shape[1], picture.shape[0]
            self._pictures.append(picture.ravel())

    def _write_glow(self, row: np.void, links: np.void, light: EmissiveLight, number: int) -> None:
        arrays = self._arrays
        surface = int(np.flatnonzero(arrays.links["glow"] == number)[0])
        faces = np.flatnonzero(arrays.faces[:, 3] == surface)
        corners = arrays.vertices[arrays.faces[faces, :3].astype(np.int64), :3].astype(np.float64)
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        faces, areas = faces[areas > 0], areas[areas > 0]
        links["kind"], links["own"] = GLOW, self._bits[arrays.links[surface]["body"]]
        links["first"], links["count"] = 2 + sum(map(len, self._faces)), len(faces)
        row["colour"], row["area"] = light.radiance, areas.sum()
        share = areas / max(areas.sum(), 1e-300)
        self._faces.append(faces.astype(np.uint32))
        self._shares.append(share.astype(np.float32))
        self._before.append((np.cumsum(share) - share).astype(np.float32))


def _write_sun(row: np.void, links: np.void, light: SunLight) -> None:
    half = max(light.angle / 2, 1e-5)
    links["kind"], links["delta"] = SUN, light.angle < 1e-5
    row["axis"] = -np.array(light.direction) / np.linalg.norm(light.direction)
    row["cap"] = 2 * math.sin(half / 2) ** 2  # 1 - cos, without the digits that float32 would lose
    row["colour"] = np.array(light.irradiance) / (1 if links["delta"] else math.pi * math.sin(half) ** 2)


def _write_panel(row: np.void, links: np.void, light: AreaLight) -> None:
    pose = np.array(light.world_from_light)
    links["kind"], links["form"] = PANEL, light.shape == "disk"
    row["colour"], row["position"], row["axis"] = light.radiance, pose[:3, 3], -pose[:3, 2]
    row["right"], row["up"], row["width"], row["height"] = pose[:3, 0], pose[:3, 1], light.width, light.height
    row["area"] = light.width * light.height * (math.pi / 4 if light.shape == "disk" else 1)


def _grey(path: Path) -> Float32:
    """Read an image as (H, W) float32 in [0, 1], without decoding."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("L"), np.float32) / 255
