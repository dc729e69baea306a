"""Lamps about a still life: where they hang, what shape their light has, in which colour."""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from multilight.lights.photometry.colour import gel_rgb, random_gel, temperature_to_rgb
from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.photometry.luminaires import luminaire
from multilight.lights.photometry.radiometry import (
    area_radiance_from_flux,
    rgb_from_scalar,
    spot_solid_angle,
    watts_from_photometric,
)
from multilight.lights.spec import AreaLight, PointLight, SpotLight
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.formats.ies import profile_flux
from multilight.scenes.cameras.pinhole import look_at
from multilight.scenes.frozen import Rgb, triple
from multilight.scenes.poses import direction_from, matrix4
from multilight.scenes.random_streams import Rng, log_uniform, pick

LampKind = Literal["area", "point", "spot"]
Lamp = PointLight | SpotLight | AreaLight

KELVIN = (2000.0, 9500.0)
"""Colour temperatures of lamps [K]: candle-like to the light of a clear northern sky."""
SEEN = 0.6
"""Fraction of the probes about the still life that a lamp must reach."""
DISTANCES = (0.5, 4.0)
"""How far lamps hang from the still life [m]."""
LARGEST = 1.6
"""Longest side of a lamp [m]: a large softbox."""
LARGEST_GLOBE = 0.3
"""Largest diameter of the source of a point or spot [m]: a globe."""
TINT_SPREAD = 0.33
"""Standard deviation of colour temperatures in natural logarithm: two of three lie within a third of the median."""
TRIES = 60
"""Positions that are tried for a lamp, ever further from the wanted one."""
BEAMS = ("downlight_narrow", "downlight_medium", "downlight_wide", "batwing", "pendant_shade", "bare_bulb")
"""Luminaires that shine along their axis, and so can be aimed."""


@dataclass(frozen=True)
class Tint:
    """A colour of light: linear Rec.709 of unit luminance, its temperature [K] and its gel, if any."""

    rgb: Rgb
    temperature: float
    gel: str | None = None


@dataclass(frozen=True)
class LampPlan:
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


def gelled(rng: Rng, tint: Tint, density: float) -> Tint:
    """Put a random gel of a density in [0, 1] before a light."""
    gel = random_gel(rng)
    colour = triple(a * b for a, b in zip(tint.rgb, gel_rgb(gel, density), strict=True))
    return replace(tint, rgb=rgb_from_scalar(1.0, colour), gel=gel)


def draw_tint(rng: Rng, *, gels: float, median: float = 4600.0) -> Tint:
    """Draw a colour temperature about `median` [K] and, with probability `gels`, a gel before it."""
    tint = white_tint(float(np.exp(rng.normal(np.log(median), TINT_SPREAD))))
    return gelled(rng, tint, float(rng.uniform(0.4, 0.95))) if rng.random() < gels else tint


def hang(rng: Rng, meter: LightMeter, plan: LampPlan) -> Lamp:
    """Hang a lamp of 1 lm as near to where it is wanted as it has a free line of sight, aimed at the still life."""
    position = _free_position(rng, meter, plan)
    distance = float(np.linalg.norm(position - meter.aim))
    size = min(2.0 * distance * np.tan(plan.size / 2), LARGEST)
    about = {"name": plan.name, "colour_temperature": plan.tint.temperature, "gel": plan.tint.gel}
    aimed = {"position": triple(position), "intensity": plan.tint.rgb, "radius": min(size, LARGEST_GLOBE) / 2}
    lamp: Lamp
    match plan.kind:
        case "point":
            lamp = PointLight.model_validate(about | aimed)
            if plan.shaping == "profile":
                beam = {"profile": luminaire(str(rng.choice(BEAMS))).profile, "direction": triple(meter.aim - position)}
                lamp = lamp.model_copy(update=beam)
        case "spot":
            reach = meter.radius * float(rng.uniform(1.1, 2.0)) / distance
            cone = {
                "direction": triple((meter.aim - position) / distance),
                "half_angle": float(np.clip(np.arctan(reach), 0.12, 1.0)),
                "blend": float(rng.uniform(0.05, 0.8)),
            }
            lamp = SpotLight.model_validate(about | aimed | cone)
            if plan.shaping == "gobo":
                lamp = _projecting(rng, meter, lamp)
        case "area":
            # As much area as a square of that size; round ones are as wide as high.
            disk = plan.aspect == 1.0 and rng.random() < 0.35
            stretch = np.sqrt(plan.aspect * (1.0 if disk else np.exp(rng.uniform(-0.4, 0.4))))
            panel = {
                "shape": "disk" if disk else "rectangle",
                "width": float(size / stretch),
                "height": float(size * stretch),
                "world_from_light": matrix4(_facing(position, meter.aim)),
                "radiance": plan.tint.rgb,
            }
            lamp = AreaLight.model_validate(about | panel)
    return one_lumen(lamp)


def one_lumen(lamp: Lamp) -> Lamp:
    """Return a lamp that gives 1 lm in the same colour and with the same distribution."""
    match lamp:
        case AreaLight():
            radiance = area_radiance_from_flux(watts_from_photometric(1.0), lamp.area)
            return lamp.model_copy(update={"radiance": rgb_from_scalar(radiance, lamp.radiance)})
        case SpotLight():
            solid_angle = spot_solid_angle(lamp.half_angle, lamp.blend)
        case PointLight():
            solid_angle = 4.0 * math.pi if lamp.profile is None else profile_flux(lamp.profile)
    intensity = watts_from_photometric(1.0) / solid_angle
    return lamp.model_copy(update={"intensity": rgb_from_scalar(intensity, lamp.intensity)})


def _projecting(rng: Rng, meter: LightMeter, spot: SpotLight) -> SpotLight:
    """Put a gobo before a spot, whose cone then must hold the image's square; small sources project sharply."""
    gobos = [info.id for info in meter.library.list("texture") if info.category == "gobo"]
    if not gobos:
        return spot
    changes = {
        "gobo": pick(rng, gobos),
        "roll": float(rng.normal(0.0, 0.15)),
        "half_angle": float(np.clip(1.5 * spot.half_angle, 0.2, 1.1)),
        "blend": 0.1,
        "radius": min(spot.radius, log_uniform(rng, 0.001, 0.02)),
    }
    return spot.model_copy(update=changes)


def _facing(position: Float64, aim: Float64) -> Float64:
    """Return the pose of a lamp at `position` that shines at `aim`."""
    towards = aim - position
    steep = np.hypot(towards[0], towards[1]) < 1e-3 * abs(towards[2])
    return look_at(position, aim, up=(1.0, 0.0, 0.0) if steep else (0.0, 0.0, 1.0))


def _free_position(rng: Rng, meter: LightMeter, plan: LampPlan) -> Float64:
    """Draw a position near the wanted one that sees the still life; the search goes ever wider, higher and nearer."""
    tangent = 2.0 * np.tan(plan.size / 2) * np.sqrt(plan.aspect)
    furthest = min(DISTANCES[1], LARGEST / tangent)
    nearest = min(max(DISTANCES[0], (meter.radius + 0.12) / max(1.0 - tangent / 2, 0.3)), furthest)
    for attempt in range(TRIES):
        wide = attempt / TRIES
        azimuth = meter.camera + plan.azimuth + rng.normal(0.0, 0.04 + 0.9 * wide)
        elevation = float(np.clip(plan.elevation + rng.normal(0.0, 0.03) + 0.8 * wide, 0.15, 1.5))
        distance = max(log_uniform(rng, nearest, furthest) * 0.985**attempt, nearest)
        position = meter.aim + distance * direction_from(azimuth, elevation)
        pose, half = _facing(position, meter.aim), distance * tangent / 2
        rim = [position + half * (x * pose[:3, 0] + y * pose[:3, 1]) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        # A hair's breadth before a wall is as bad as behind it: look a little further out.
        rim += [position + (half + 0.05) * pose[:3, 2]]
        if all(meter.seen_fraction(point) >= SEEN for point in [position, *rim]):
            return position
    return meter.aim + np.array([0.0, 0.0, meter.top + 1.0])
