"""Daylight through the windows of a room: sky or a photographed place outside, and the sun."""

import numpy as np

from multilight.lights.photometry.colour import temperature_to_rgb
from multilight.lights.photometry.irradiance import map_directions, small_map
from multilight.lights.photometry.radiometry import rgb_from_scalar, watts_from_photometric
from multilight.lights.rigs.balance import NOTHING
from multilight.lights.spec import SUN_ANGLE, EnvironmentLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import luminance
from multilight.scenes.frozen import triple
from multilight.scenes.poses import direction_from
from multilight.scenes.random_streams import Rng, log_uniform, pick
from multilight.scenes.spec import Body

SUN_RATIO = (1.0, 5.0)
"""Illuminance of sunlight, facing it, against that of the sky on the window."""
HIGH_UP = 0.15
"""Probability that a room is high above everything, with nothing but sky before the windows."""
WINDOW_SUN_SIZES = (SUN_ANGLE, 0.05)
"""Angular diameters of the sun [rad] that comes in, from its own to a veiled one."""


def daylight(rng: Rng, windows: list[Body], library: AssetLibrary, lux: float) -> EnvironmentLight:
    """Draw what is outside: an outdoor map rotated so that its bright side is before a window, scaled to `lux`."""
    outward = _outward(pick(rng, windows))
    wanted = watts_from_photometric(lux)
    wanted_kind = "sky" if rng.random() < HIGH_UP else "outdoor"
    found = [info for info in library.list("environment") if info.category in ("outdoor", "sky")]
    maps = [info for info in found if info.category == wanted_kind] or found
    if not maps:
        temperature = round(float(rng.uniform(5500.0, 9000.0)))
        # A uniform sphere of radiance L gives pi L.
        colour = rgb_from_scalar(wanted / np.pi, temperature_to_rgb(temperature))
        return EnvironmentLight(name="environment", colour_temperature=temperature, radiance=colour)
    info = pick(rng, maps)
    image = luminance(small_map(library, info.id))
    directions, solid_angle = map_directions(0.0)
    mean = ((image * solid_angle[:, None])[..., None] ** 1.2 * directions).sum(axis=(0, 1))
    azimuth = float(np.arctan2(outward[1], outward[0])) + float(rng.uniform(-1.3, 1.3))
    rotation = (azimuth - float(np.arctan2(mean[1], mean[0]))) % (2 * np.pi)
    directions, _ = map_directions(rotation)
    cosine = np.maximum(directions @ outward, 0.0)
    unit = float((image * solid_angle[:, None] * cosine).sum())
    factor = wanted / max(unit, NOTHING)
    return EnvironmentLight(name="environment", map=info.id, rotation=rotation, radiance=(factor, factor, factor))


def _outward(window: Body) -> Float64:
    """Return the direction out of a window (3,): assets face the room with -Y."""
    pose = np.array(window.world_from_body)
    return np.asarray(pose[:3, 1] / np.linalg.norm(pose[:3, 1]))


def sunlight(rng: Rng, windows: list[Body], sky_lux: float) -> SunLight:
    """Let the sun in at a window, from the side and low enough to reach into the room."""
    outward = _outward(pick(rng, windows))
    azimuth = float(np.arctan2(outward[1], outward[0])) + float(rng.uniform(-1.0, 1.0))
    elevation = float(np.radians(rng.uniform(14.0, 50.0)))
    temperature = round(float(np.interp(elevation, [0.25, 0.9], [3800.0, 5600.0]) * rng.uniform(0.95, 1.05)))
    strength = watts_from_photometric(sky_lux * log_uniform(rng, *SUN_RATIO))
    angle = SUN_ANGLE if rng.random() < 0.6 else log_uniform(rng, *WINDOW_SUN_SIZES)
    return SunLight(
        name="sun",
        colour_temperature=temperature,
        direction=triple(-direction_from(azimuth, elevation)),
        irradiance=rgb_from_scalar(strength, temperature_to_rgb(temperature)),
        angle=angle,
    )
