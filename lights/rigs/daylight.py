"""Light from far away: environment maps rotated to where it is open, the sun, and the sky that goes with it."""

import numpy as np

from multilight.lights.photometry.colour import temperature_to_rgb
from multilight.lights.photometry.irradiance import LightMeter, map_directions, small_map
from multilight.lights.photometry.radiometry import watts_from_photometric
from multilight.lights.rigs.lamps import SEEN, Tint
from multilight.lights.spec import SUN_ANGLE, EnvironmentLight, SunLight
from multilight.scenes.assets.builtin.skies import OVERCAST, sky_name, sky_parameters, sun_illuminance
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.colour import luminance
from multilight.scenes.frozen import triple
from multilight.scenes.poses import direction_from
from multilight.scenes.random_streams import Rng, log_uniform, pick

SUN_SIZES = (SUN_ANGLE, 0.06)
"""Angular diameters [rad] of the suns that are drawn: from the sun's own to a veiled one."""
MOON_LUX, MOON_KELVIN = 0.27, 4150.0
"""The full moon high in a clear sky, on a surface that faces it [lx], and its colour temperature [K]."""
_SKY_UNIT = watts_from_photometric(1000.0)
"""Radiance [W/(m² sr)] of a map's 1 kcd/m²."""


def sun_and_sky(azimuth: float, elevation: float, turbidity: float) -> tuple[SunLight, EnvironmentLight]:
    """Return the sun at an azimuth and elevation [rad] and the clear sky about it, in their true strengths.

    The sun keeps to the nearest elevation and turbidity for which there is a sky (`scenes.assets.builtin.skies`).
    """
    name = sky_name(elevation, turbidity)
    height, haze = sky_parameters(name)
    beam = [watts_from_photometric(1000.0 * klx) for klx in sun_illuminance(elevation=height, turbidity=haze)]
    sun = SunLight(
        name="sun", direction=triple(-direction_from(azimuth, height)), irradiance=triple(beam), angle=SUN_ANGLE
    )
    return sun, _sky(name, azimuth)


def overcast(azimuth: float) -> EnvironmentLight:
    """Return the CIE's overcast sky in its true strength, with an azimuth [rad] for its map's centre."""
    return _sky(OVERCAST, azimuth)


def moon(azimuth: float, elevation: float) -> SunLight:
    """Return the full moon in a clear sky, half a degree wide."""
    irradiance = triple(watts_from_photometric(MOON_LUX) * c for c in temperature_to_rgb(MOON_KELVIN))
    direction = triple(-direction_from(azimuth, elevation))
    return SunLight(name="moon", colour_temperature=MOON_KELVIN, direction=direction, irradiance=irradiance)


def environment(rng: Rng, meter: LightMeter, tint: Tint, *, name: str, categories: frozenset[str]) -> EnvironmentLight:
    """Draw a map of the categories, of unit radiance; its bright side comes over a random open side.

    A uniform environment of the tint where no map is installed, or none is asked for.
    """
    maps = [info for info in meter.library.list("environment") if info.category in categories]
    if not maps:
        return EnvironmentLight(name=name, colour_temperature=tint.temperature, gel=tint.gel, radiance=tint.rgb)
    info = _draw_place(rng, maps)
    wanted = rng.uniform(0.0, 2 * np.pi, 12)
    open_fraction = meter.open_fraction(np.array([direction_from(azimuth, 0.5) for azimuth in wanted]))
    chosen = float(wanted[int(np.argmax(open_fraction >= min(SEEN, float(open_fraction.max()))))])
    return rotated_to(EnvironmentLight(name=name, map=info.id), meter, chosen)


def rotated_to(light: EnvironmentLight, meter: LightMeter, azimuth: float) -> EnvironmentLight:
    """Rotate a map so that its brightest part lies at an azimuth [rad]; a uniform environment stays as it is."""
    if light.map is None:
        return light
    directions, solid_angle = map_directions(0.0)
    bright = luminance(small_map(meter.library, light.map)) * solid_angle[:, None] * (directions[..., 2] > 0)
    # A power above one makes the brightest windows decide, not the dim rest.
    mean = (bright[..., None] ** 1.5 * directions).sum(axis=(0, 1))
    return light.model_copy(update={"rotation": (azimuth - float(np.arctan2(mean[1], mean[0]))) % (2 * np.pi)})


def open_direction(rng: Rng, meter: LightMeter, azimuth: float, elevation: float) -> tuple[float, float] | None:
    """Return the azimuth and elevation [rad] nearest to those wanted from which the still life is free; None if none.

    Nearest of 48 about the wanted direction, ever further from it.
    """
    spread = np.linspace(0.0, 1.0, 48) ** 1.5
    around = azimuth + np.pi * spread * rng.choice([-1.0, 1.0], 48)
    above = np.clip(elevation + spread * rng.uniform(-0.4, 0.6, 48), 0.12, 1.4)
    towards = np.array([direction_from(a, e) for a, e in zip(around, above, strict=True)])
    free = np.flatnonzero(meter.open_fraction(towards) >= SEEN)
    return (float(around[free[0]]), float(above[free[0]])) if len(free) else None


def plain_sun(rng: Rng, meter: LightMeter, azimuth: float, elevation: float) -> SunLight | None:
    """Return a sun of unit irradiance near a direction [rad] where that is open; None where it cannot come in."""
    found = open_direction(rng, meter, azimuth, elevation)
    if found is None:
        return None
    # Low suns are warm, high ones white (CIE daylight).
    warm = float(np.interp(found[1], [0.2, 1.1], [2800.0, 5600.0]))
    temperature = round(float(np.clip(warm * np.exp(rng.normal(0.0, 0.12)), 2200.0, 9000.0)))
    direction = triple(-direction_from(*found))
    rgb = temperature_to_rgb(temperature)
    angle = SUN_ANGLE if rng.random() < 0.5 else log_uniform(rng, *SUN_SIZES)
    return SunLight(name="sun", colour_temperature=temperature, direction=direction, irradiance=rgb, angle=angle)


def _sky(name: str, azimuth: float) -> EnvironmentLight:
    rotation = azimuth % (2 * np.pi)
    return EnvironmentLight(name="sky", map=f"builtin/{name}", radiance=(_SKY_UNIT,) * 3, rotation=rotation)


def _draw_place(rng: Rng, maps: list[AssetInfo]) -> AssetInfo:
    """Draw a place first, so that one that comes in several packs counts once."""
    wanted = pick(rng, sorted({info.place or info.id for info in maps}))
    return next(info for info in maps if (info.place or info.id) == wanted)
