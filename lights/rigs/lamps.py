"""Lamps about a still life: where they hang, what shape their light has, in which colour."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from multilight.lights.photometry.colour import gel_rgb, random_gel, temperature_to_rgb
from multilight.lights.photometry.ies import luminaire, profile_flux
from multilight.lights.photometry.irradiance import StillLife
from multilight.lights.photometry.radiometry import (
    area_radiance_from_lumens,
    intensity_from_lumens,
    rgb_from_scalar,
    spot_solid_angle,
)
from multilight.lights.spec import AreaLight, PointLight, SpotLight
from multilight.scenes.arrays import Float64
from multilight.scenes.cameras.pinhole import look_at
from multilight.scenes.frozen import Rgb, Vector3
from multilight.scenes.poses import direction_from, matrix4
from multilight.scenes.streams import log_uniform

LampKind = Literal["area", "point", "spot"]
Lamp = PointLight | SpotLight | AreaLight

KELVIN = (2000.0, 9500.0)
"""Colour temperatures of lamps [K]: candle-like to the light of a clear northern sky."""
SEEN = 0.6
"""Share of the probes about the still life that a lamp must reach."""
DISTANCES = (0.5, 4.0)
"""How far lamps hang from the still life [m]."""
LARGEST = 1.6
"""Longest side of a lamp [m]: a large softbox."""
BEAMS = ("downlight_narrow", "downlight_medium", "downlight_wide", "batwing", "pendant_shade", "bare_bulb")
"""Luminaires that shine along their axis, and so can be aimed."""


@dataclass(frozen=True)
class Tint:
    """A colour of light: linear Rec.709 of unit luminance, its temperature [K] and its gel, if any."""

    rgb: Rgb
    temperature: float
    gel: str | None = None


@dataclass(frozen=True)
class Post:
    """A lamp that is wanted: where it should hang and what it should be like.

    `azimuth` [rad] counts from the cameras' mean; `size` is its angular diameter [rad] from the scene's centre;
    `aspect` the ratio of an area lamp's sides (a strip light has 5 or more).
    """

    name: str
    kind: LampKind
    azimuth: float
    elevation: float
    size: float
    tint: Tint
    shaping: str = "plain"
    aspect: float = 1.0


def white_tint(temperature: float) -> Tint:
    """Return the tint of white light of a colour temperature [K], held within `KELVIN`."""
    kelvin = round(float(np.clip(temperature, *KELVIN)))
    return Tint(temperature_to_rgb(kelvin), kelvin)


def gelled(rng: np.random.Generator, tint: Tint, density: float) -> Tint:
    """Put a random gel of a density in [0, 1] before a light."""
    gel = random_gel(rng)
    red, green, blue = (a * b for a, b in zip(tint.rgb, gel_rgb(gel, density), strict=True))
    return replace(tint, rgb=rgb_from_scalar(1.0, (red, green, blue)), gel=gel)


def draw_tint(rng: np.random.Generator, *, gels: float, middle: float = 4600.0) -> Tint:
    """Draw a colour temperature about `middle` [K] and, for a share `gels`, a gel before it."""
    tint = white_tint(float(np.exp(rng.normal(np.log(middle), 0.33))))
    return gelled(rng, tint, float(rng.uniform(0.4, 0.95))) if rng.random() < gels else tint


def hang(rng: np.random.Generator, place: StillLife, post: Post) -> Lamp:
    """Hang a lamp of 1 lm as near to its post as it has a free line of sight, aimed at the still life."""
    position = _free_place(rng, place, post)
    distance = float(np.linalg.norm(position - place.aim))
    size = min(2.0 * distance * np.tan(post.size / 2), LARGEST)
    about = {"name": post.name, "colour_temperature": post.tint.temperature, "gel": post.tint.gel}
    match post.kind:
        case "point":
            return _point(rng, place, post, PointLight(**about, position=vector(position), intensity=post.tint.rgb,
                                                       radius=min(size, 0.3) / 2))  # fmt: skip
        case "spot":
            reach = place.radius * float(rng.uniform(1.1, 2.0)) / distance
            spot = SpotLight(
                **about,
                position=vector(position),
                direction=vector((place.aim - position) / distance),
                intensity=post.tint.rgb,
                half_angle=float(np.clip(np.arctan(reach), 0.12, 1.0)),
                blend=float(rng.uniform(0.05, 0.8)),
                radius=min(size, 0.3) / 2,
            )
            return _projecting(rng, place, spot) if post.shaping == "gobo" else _lumen(spot)
        case "area":
            return _softbox(rng, place, post, about, position, size)


def _softbox(
    rng: np.random.Generator, place: StillLife, post: Post, about: dict[str, object], position: Float64, size: float
) -> AreaLight:
    """Make an area lamp of as much area as a square of side `size` [m]; round ones are as wide as high."""
    disk = post.aspect == 1.0 and rng.random() < 0.35
    stretch = np.sqrt(post.aspect * (1.0 if disk else np.exp(rng.uniform(-0.4, 0.4))))
    width, height = float(size / stretch), float(size * stretch)
    area = width * height * (np.pi / 4 if disk else 1.0)
    return AreaLight.model_validate(
        {
            **about,
            "shape": "disk" if disk else "rectangle",
            "width": width,
            "height": height,
            "world_from_light": matrix4(_facing(position, place.aim)),
            "radiance": area_radiance_from_lumens(1.0, area, post.tint.rgb),
        }
    )


def _point(rng: np.random.Generator, place: StillLife, post: Post, bulb: PointLight) -> PointLight:
    """Give a bare point 1 lm, or the distribution of a luminaire that is aimed at the still life."""
    if post.shaping != "profile":
        return bulb.model_copy(update={"intensity": intensity_from_lumens(1.0, post.tint.rgb)})
    profile = luminaire(str(rng.choice(BEAMS))).profile
    aimed = vector(place.aim - np.array(bulb.position))
    intensity = intensity_from_lumens(1.0, post.tint.rgb, profile_flux(profile))
    return bulb.model_copy(update={"intensity": intensity, "profile": profile, "direction": aimed})


def _lumen(spot: SpotLight) -> SpotLight:
    """Give a spot 1 lm."""
    solid_angle = spot_solid_angle(spot.half_angle, spot.blend)
    return spot.model_copy(update={"intensity": intensity_from_lumens(1.0, spot.intensity, solid_angle)})


def _projecting(rng: np.random.Generator, place: StillLife, spot: SpotLight) -> SpotLight:
    """Put a gobo before a spot, whose cone then must hold the image's square; small sources project sharply."""
    gobos = [info.id for info in place.library.list("texture") if info.category == "gobo"]
    if not gobos:
        return _lumen(spot)
    changes = {
        "gobo": gobos[int(rng.integers(len(gobos)))],
        "roll": float(rng.normal(0.0, 0.15)),
        "half_angle": float(np.clip(1.5 * spot.half_angle, 0.2, 1.1)),
        "blend": 0.1,
        "radius": min(spot.radius, log_uniform(rng, 0.001, 0.02)),
    }
    return _lumen(spot.model_copy(update=changes))


def _facing(position: Float64, aim: Float64) -> Float64:
    """Return the pose of a lamp at `position` that shines at `aim`."""
    way = aim - position
    steep = np.hypot(way[0], way[1]) < 1e-3 * abs(way[2])
    return look_at(position, aim, up=(1.0, 0.0, 0.0) if steep else (0.0, 0.0, 1.0))


def _free_place(rng: np.random.Generator, place: StillLife, post: Post) -> Float64:
    """Draw a place near a post from which the still life is seen; the search goes ever wider, higher and nearer."""
    tangent = 2.0 * np.tan(post.size / 2) * np.sqrt(post.aspect)
    furthest = min(DISTANCES[1], LARGEST / tangent)
    nearest = min(max(DISTANCES[0], (place.radius + 0.12) / max(1.0 - tangent / 2, 0.3)), furthest)
    for attempt in range(60):
        wide = attempt / 60
        azimuth = place.camera + post.azimuth + rng.normal(0.0, 0.04 + 0.9 * wide)
        elevation = float(np.clip(post.elevation + rng.normal(0.0, 0.03) + 0.8 * wide, 0.15, 1.5))
        distance = max(log_uniform(rng, nearest, furthest) * 0.985**attempt, nearest)
        position = place.aim + distance * direction_from(azimuth, elevation)
        pose, half = _facing(position, place.aim), distance * tangent / 2
        rim = [position + half * (x * pose[:3, 0] + y * pose[:3, 1]) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        # A hair's breadth before a wall is as bad as behind it: look a little further out.
        rim += [position + (half + 0.05) * pose[:3, 2]]
        if all(place.seen_share(point) >= SEEN for point in [position, *rim]):
            return position
    return place.aim + np.array([0.0, 0.0, place.top + 1.0])


def vector(values: Float64) -> Vector3:
    """Turn an array (3,) into the tuple that specifications hold."""
    return float(values[0]), float(values[1]), float(values[2])
