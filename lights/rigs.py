"""Rigs: two to six lights about a still life, in physical units and in balance with each other.

Lamps have the luminous flux of real ones, 200 to 3000 lm (household bulbs to small studio heads). Environment,
sun and glowing objects are set relative to the key lamp, and no light is left so weak or so strong that its layer
would be dead: irradiances on the table lie within a factor `BALANCE` of their median.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lights.colour import gel_rgb, random_gel, temperature_to_rgb
from lights.irradiance import StillLife, map_directions, small_map
from lights.radiometry import (
    area_radiance_from_flux,
    point_intensity_from_flux,
    rgb_from_scalar,
    spot_intensity_from_flux,
    watts_from_photometric,
)
from lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SpotLight, SunLight
from lights.tonemap import luminance
from scenes.assets.library import AssetLibrary
from scenes.cameras import look_at, matrix4
from scenes.frozen import Rgb, Vector3
from scenes.spec import SceneSpec
from scenes.streams import Streams
from scenes.tabletop import emissive_candidate

LightKind = Literal["environment", "sun", "point", "spot", "area", "emissive"]
ALL_KINDS: tuple[LightKind, ...] = ("environment", "sun", "point", "spot", "area", "emissive")
SPHERES_KINDS: tuple[LightKind, ...] = ("environment", "sun", "point", "spot")
"""What the closed-form renderer draws; the environment of a scene of spheres is uniform."""

BALANCE = 6.0
KELVIN = (2200.0, 9000.0)
"""Colour temperatures of lights [K]: candle-like to the light of a clear northern sky."""
FLUX = (200.0, 3000.0)
"""Luminous flux of a lamp [lm]."""
SNOOTED = 40.0
"""Least flux that leaves a spot [lm]: its snoot keeps most of the lamp's light back."""
KEY_LUX = (150.0, 1200.0)
"""Illuminance that the key aims at on the table [lx]: from a well-lit living room to a photographer's table."""
LAMP_SHARES = {"point": 0.17, "spot": 0.23, "area": 0.6}
SEEN = 0.6
"""Share of the probes about the still life that a lamp must reach."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class _Post:
    """Where a lamp may hang: azimuth from the cameras' side and elevation [rad], and its strength against the key."""

    name: str
    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    strength: tuple[float, float]


_KEY = _Post("key", (60.0, 150.0), (28.0, 60.0), (1.0, 1.0))
_OTHERS = (
    _Post("fill", (20.0, 80.0), (20.0, 50.0), (0.2, 0.7)),
    _Post("rim", (135.0, 180.0), (20.0, 50.0), (0.3, 1.2)),
    _Post("top", (0.0, 180.0), (62.0, 84.0), (0.3, 1.2)),
    _Post("kicker", (70.0, 140.0), (15.0, 35.0), (0.25, 0.9)),
    _Post("accent", (40.0, 160.0), (25.0, 65.0), (0.25, 1.0)),
)


def sample_rig(
    streams: Streams,
    scene: SceneSpec,
    library: AssetLibrary,
    *,
    kinds: tuple[LightKind, ...] = ALL_KINDS,
    lights: tuple[int, int] = (2, 6),
) -> LightRig:
    """Draw a rig of `lights` (fewest, most) lights of the given kinds for a scene.

    There is always a key lamp from the side or the back, so that shadows fall into view; nearly
    always an environment; the object that is meant to glow glows. Every lamp has a free line of sight. Raises
    `ValueError` where `kinds` holds no lamp (point, spot, area).
    """
    rng = streams("rig")
    place = StillLife.of(scene, library)
    count = int(rng.integers(lights[0], lights[1] + 1))
    rig: list[Light] = []
    strength: list[float] = []
    posts = [_KEY, *(_OTHERS[int(i)] for i in rng.permutation(len(_OTHERS)))]
    lamp_kinds: list[str] = [kind for kind in ("point", "spot", "area") if kind in kinds]
    if not lamp_kinds:
        raise ValueError(f"a rig needs a lamp to be its key: kinds {kinds} hold none of point, spot, area")
    glow = emissive_candidate(scene) if "emissive" in kinds else None
    enclosed = any(body.category in ("wall", "backdrop") for body in scene.bodies)
    # On open ground the environment is the horizon: without it the picture ends in black.
    with_environment = "environment" in kinds and bool(rng.random() < (0.9 if enclosed else 1.0))
    needed = 1 + with_environment + (glow is not None)
    count = min(max(count, needed), lights[1])
    with_environment = with_environment and count >= needed
    with_sun = "sun" in kinds and count > needed and bool(rng.random() < 0.35)
    lamps = max(1, count - with_environment - with_sun - (glow is not None))
    for post in posts[:lamps]:
        rig.append(_lamp(rng, place, post, lamp_kinds, hard=scene.kind == "spheres"))
        strength.append(_log_uniform(rng, *post.strength))
    if with_environment:
        rig.append(_environment(rng, place, uniform=scene.kind == "spheres"))
        strength.append(_log_uniform(rng, 0.4, 2.0))
    if with_sun:
        sun = _sun(rng, place, hard=scene.kind == "spheres")
        rig += [] if sun is None else [sun]
        strength += [] if sun is None else [_log_uniform(rng, 0.6, 2.0)]
    if glow is not None:
        rig.append(_glow(rng, *glow))
        strength.append(_log_uniform(rng, 0.15, 0.6))
    return LightRig(lights=tuple(_balanced(rng, rig, strength, place)))


def scaled(light: Light, factor: float) -> Light:
    """Return the same light `factor` times as strong."""
    match light:
        case EnvironmentLight() | AreaLight() | EmissiveLight():
            return light.model_copy(update={"radiance": _times(light.radiance, factor)})
        case SunLight():
            return light.model_copy(update={"irradiance": _times(light.irradiance, factor)})
        case PointLight() | SpotLight():
            return light.model_copy(update={"intensity": _times(light.intensity, factor)})


def _balanced(rng: np.random.Generator, rig: list[Light], strength: list[float], place: StillLife) -> list[Light]:
    """Set each light's power: the key's illuminance is drawn, the others follow; lamps keep to `FLUX` if they can."""
    # Lamps come in with 1 lm, all others with unit radiance or irradiance.
    unit = np.array([place.table_irradiance(light) for light in rig])
    wanted = np.array(strength) * watts_from_photometric(_log_uniform(rng, *KEY_LUX))
    factor = wanted / np.maximum(unit, 1e-12)
    for i, light in enumerate(rig):
        if isinstance(light, PointLight | SpotLight | AreaLight):
            factor[i] = np.clip(factor[i], SNOOTED if light.kind == "spot" else FLUX[0], FLUX[1])
    middle = float(np.median(factor * unit))
    factor = np.clip(factor * unit, middle / BALANCE, middle * BALANCE) / np.maximum(unit, 1e-12)
    return [scaled(light, float(f)) for light, f in zip(rig, factor, strict=True)]


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw between two positive numbers, evenly in their logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _times(colour: Rgb, factor: float) -> Rgb:
    """Scale a colour."""
    return colour[0] * factor, colour[1] * factor, colour[2] * factor


def _colour(rng: np.random.Generator, *, gels: float, middle: float = 4600.0) -> tuple[Rgb, float, str | None]:
    """Draw a light's colour of unit luminance, its temperature [K] about `middle` and its gel, if any."""
    temperature = round(float(np.clip(np.exp(rng.normal(np.log(middle), 0.33)), *KELVIN)))
    white = temperature_to_rgb(temperature)
    if rng.random() >= gels:
        return white, temperature, None
    gel, density = random_gel(rng), float(rng.uniform(0.4, 0.95))
    red, green, blue = (a * b for a, b in zip(white, gel_rgb(gel, density), strict=True))
    return rgb_from_scalar(1.0, (red, green, blue)), temperature, gel


def _vector(values: Float64) -> Vector3:
    """Turn an array (3,) into the tuple that specifications hold."""
    return float(values[0]), float(values[1]), float(values[2])


def direction_from(azimuth: float, elevation: float) -> Float64:
    """Return the unit vector (3,) at an azimuth and an elevation [rad]."""
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def _lamp(
    rng: np.random.Generator, place: StillLife, post: _Post, kinds: list[str], *, hard: bool
) -> PointLight | SpotLight | AreaLight:
    """Hang a lamp of 1 lm at a post, with a free line of sight from all of its extent."""
    shares = np.array([LAMP_SHARES[kind] for kind in kinds])
    kind = str(rng.choice(kinds, p=shares / shares.sum()))
    width, height = (float(v) for v in _log_uniform(rng, 0.15, 0.7) * np.exp(rng.uniform(-0.3, 0.3, 2)))
    size = max(width, height) / 2 if kind == "area" else 0.0 if hard else _log_uniform(rng, 0.012, 0.08)
    position = _free_place(rng, place, post, size)
    rgb, temperature, gel = _colour(rng, gels=0.05 if post is _KEY else 0.15)
    watts = watts_from_photometric(1.0)
    about = {"name": post.name, "colour_temperature": temperature, "gel": gel}
    distance = float(np.linalg.norm(position - place.aim))
    match kind:
        case "point":
            intensity = _times(rgb, point_intensity_from_flux(watts))
            return PointLight(**about, position=_vector(position), intensity=intensity, radius=size)
        case "spot":
            half = float(np.clip(np.arctan(place.radius * rng.uniform(1.0, 1.8) / distance), 0.3, 1.0))
            return SpotLight(
                **about,
                position=_vector(position),
                direction=_vector((place.aim - position) / distance),
                intensity=_times(rgb, spot_intensity_from_flux(watts, half)),
                half_angle=half,
                blend=float(rng.uniform(0.1, 0.7)),
                radius=size,
            )
        case _:
            disk = rng.random() < 0.35
            area = width * height * (np.pi / 4 if disk else 1.0)
            return AreaLight(
                **about,
                shape="disk" if disk else "rectangle",
                width=width,
                height=height,
                world_from_light=matrix4(_facing(position, place.aim)),
                radiance=_times(rgb, area_radiance_from_flux(watts, area)),
            )


def _facing(position: Float64, aim: Float64) -> Float64:
    """Return the pose of a lamp at `position` that shines at `aim`."""
    way = aim - position
    steep = np.hypot(way[0], way[1]) < 1e-3 * abs(way[2])
    return look_at(position, aim, up=(1.0, 0.0, 0.0) if steep else (0.0, 0.0, 1.0))


def _free_place(rng: np.random.Generator, place: StillLife, post: _Post, size: float) -> Float64:
    """Draw a place at a post from which the still life is seen; the higher, the longer the search takes."""
    for attempt in range(60):
        side = float(rng.choice([-1.0, 1.0]))
        azimuth = place.camera + side * np.radians(rng.uniform(*post.azimuth))
        lift = np.radians(min(attempt, 40))
        elevation = np.clip(np.radians(rng.uniform(*post.elevation)) + lift, 0.2, 1.48)
        distance = max(_log_uniform(rng, 0.5, 2.0) * 0.985**attempt, place.radius + size + 0.15)
        position = place.aim + distance * direction_from(azimuth, float(elevation))
        pose = _facing(position, place.aim)
        rim = [position + size * (x * pose[:3, 0] + y * pose[:3, 1]) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        # A hair's breadth before a wall is as bad as behind it: look a little further out.
        rim += [position + (size + 0.05) * pose[:3, 2]]
        if all(place.seen_share(point) >= SEEN for point in [position, *rim]):
            return position
    return place.aim + np.array([0.0, 0.0, place.top + 1.0])


def _environment(rng: np.random.Generator, place: StillLife, *, uniform: bool) -> EnvironmentLight:
    """Draw an environment of unit radiance; its bright side comes over a random open side."""
    maps = () if uniform else place.library.list("environment")
    if not maps:
        rgb, temperature, gel = _colour(rng, middle=6000.0, gels=0.0)
        return EnvironmentLight(name="environment", colour_temperature=temperature, gel=gel, radiance=rgb)
    info = maps[int(rng.integers(len(maps)))]
    directions, solid_angle = map_directions(0.0)
    bright = luminance(small_map(place.library, info.id)) * solid_angle[:, None] * (directions[..., 2] > 0)
    # A power above one makes the brightest windows decide, not the dim rest.
    mean = (bright[..., None] ** 1.5 * directions).sum(axis=(0, 1))
    wanted = rng.uniform(0.0, 2 * np.pi, 12)
    open_share = place.open_share(np.array([direction_from(azimuth, 0.5) for azimuth in wanted]))
    chosen = float(wanted[int(np.argmax(open_share >= min(SEEN, float(open_share.max()))))])
    rotation = (chosen - float(np.arctan2(mean[1], mean[0]))) % (2 * np.pi)
    return EnvironmentLight(name="environment", map=info.id, rotation=rotation)


def _sun(rng: np.random.Generator, place: StillLife, *, hard: bool) -> SunLight | None:
    """Draw a sun of unit irradiance from the side or the back where that is open; None where it cannot come in."""
    offset = np.concatenate([rng.uniform(50.0, 155.0, 12), rng.uniform(15.0, 180.0, 12)])
    azimuth = place.camera + np.radians(offset) * rng.choice([-1.0, 1.0], 24)
    elevation = np.radians(rng.uniform(20.0, 65.0, 24))
    towards = np.array([direction_from(a, e) for a, e in zip(azimuth, elevation, strict=True)])
    free = np.flatnonzero(place.open_share(towards) >= SEEN)
    if not len(free):
        return None
    # Low suns are warm, high ones white (CIE daylight).
    warm = float(np.interp(elevation[free[0]], [0.35, 1.1], [3200.0, 5600.0]))
    rgb, temperature, _ = _colour(rng, middle=warm, gels=0.0)
    angle = 0.00918 if hard or rng.random() < 0.5 else _log_uniform(rng, 0.00918, 0.06)
    return SunLight(
        name="sun", colour_temperature=temperature, direction=_vector(-towards[free[0]]), irradiance=rgb, angle=angle
    )


def _glow(rng: np.random.Generator, body: str, part: int) -> EmissiveLight:
    """Let a part of a body glow with unit radiance: warm mostly, coloured sometimes."""
    rgb, temperature, gel = _colour(rng, middle=3000.0, gels=0.2)
    return EmissiveLight(name="glow", colour_temperature=temperature, gel=gel, body=body, part=part, radiance=rgb)
