"""Skies by formula: environment maps without the sun's disc, and the sun that goes with them.

Clear and hazy skies: A. J. Preetham, P. Shirley, B. Smits, A Practical Analytic Model for Daylight, SIGGRAPH 1999,
appendix A.2, for distribution and colours. Its level is several times too high at low sun (G. Zotti, A. Wilkie,
W. Purgathofer, A Critical Review of the Preetham Skylight Model, WSCG 2007), so that is set to the IES's daylight
availability (IES Lighting Handbook, 9th ed., 2000, ch. 8). Overcast: the CIE's (P. Moon, D. Spencer, 1942). The sun: a
blackbody seen through the atmosphere, with the extinctions of Preetham et al., appendix A.1. All in kcd/m² and klx as
linear Rec.709 RGB; the sun stands at azimuth 0 of the map, in its centre column.
"""

import re
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.cache import write_once
from multilight.scenes.colour import LUMINANCE_WEIGHTS, RGB_FROM_XYZ
from multilight.scenes.frozen import Rgb, triple

ELEVATIONS = (3, 8, 15, 25, 40, 60)
"""Heights of the sun above the horizon [degrees] for which there is a map."""
TURBIDITIES = (2, 3, 6)
"""Haziness: 2 is a very clear day, 3 a clear one, 6 light haze. The model holds from about 2 to 10."""
OVERCAST = "sky-overcast"
OVERCAST_ELEVATION = 35.0
"""The sun's height [degrees] that the overcast map's level belongs to."""
SKIES = (*(f"sky-{elevation}-{turbidity}" for elevation in ELEVATIONS for turbidity in TURBIDITIES), OVERCAST)
GROUND = (0.16, 0.15, 0.13)
"""Reflectance of the ground that fills the map's lower half (linear Rec.709): dry soil and grass."""
ROWS = 256

# Rows A to E of the Perez function, slope and offset over turbidity, for Y, x and y.
_PEREZ = np.array(
    [
        [[0.1787, -1.4630], [-0.3554, 0.4275], [-0.0227, 5.3251], [0.1206, -2.5771], [-0.0670, 0.3703]],
        [[-0.0193, -0.2592], [-0.0665, 0.0008], [-0.0004, 0.2125], [-0.0641, -0.8989], [-0.0033, 0.0452]],
        [[-0.0167, -0.2608], [-0.0950, 0.0092], [-0.0079, 0.2102], [-0.0441, -1.6537], [-0.0109, 0.0529]],
    ]
)
# Zenith chromaticity: powers of turbidity (2, 1, 0) by powers of the sun's zenith angle (3, 2, 1, 0), for x and y.
_ZENITH = np.array(
    [
        [
            [0.00166, -0.00375, 0.00209, 0.0],
            [-0.02903, 0.06377, -0.03202, 0.00394],
            [0.11693, -0.21196, 0.06052, 0.25886],
        ],
        [
            [0.00275, -0.00610, 0.00317, 0.0],
            [-0.04214, 0.08970, -0.04153, 0.00516],
            [0.15346, -0.26756, 0.06670, 0.26688],
        ],
    ]
)
# Ozone absorption [1/cm] every 20 nm from 440 to 700 nm (B. Leckner, 1978).
_OZONE = (0.001, 0.006, 0.014, 0.030, 0.048, 0.075, 0.103, 0.120, 0.125, 0.105, 0.079, 0.057, 0.036, 0.023)
SOLAR_KLX = 133.3
"""Illuminance of the sun outside the atmosphere [klx] (S. Darula, R. Kittler, C. Gueymard, 2005)."""


def zenith_luminance(sun_zenith: float, turbidity: float) -> float:
    """Return the luminance of a clear sky's zenith [kcd/m²]; `sun_zenith` [rad]."""
    chi = (4.0 / 9.0 - turbidity / 120.0) * (np.pi - 2.0 * sun_zenith)
    return float((4.0453 * turbidity - 4.9710) * np.tan(chi) - 0.2155 * turbidity + 2.4192)


def clear_sky(directions: Float64, *, elevation: float, turbidity: float) -> Float64:
    """Return the luminance of a clear sky as linear Rec.709 [kcd/m²], (..., 3).

    `directions` (..., 3) are unit vectors, +Z up; the sun stands at azimuth 0 and `elevation` [rad]. Directions
    below the horizon count as just above it.
    """
    sun_zenith = np.pi / 2 - elevation
    sun = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
    gamma = np.arccos(np.clip(directions @ sun, -1.0, 1.0))
    cosine = np.maximum(directions[..., 2], 1e-3)
    powers = sun_zenith ** np.arange(3, -1, -1)
    x_zenith, y_zenith = (np.array([turbidity**2, turbidity, 1.0]) @ table @ powers for table in _ZENITH)
    zenith = (zenith_luminance(sun_zenith, turbidity), x_zenith, y_zenith)
    luminance, x, y = (
        value * _perez(row, cosine, gamma) / _perez(row, np.cos(0.0), np.array(sun_zenith))
        for value, row in zip(zenith, _PEREZ @ [turbidity, 1.0], strict=True)
    )
    return _rgb(np.stack([x / y * luminance, luminance, (1 - x - y) / y * luminance], axis=-1))


def sky_illuminance(*, elevation: float, turbidity: float) -> float:
    """Return the illuminance of a sky without the sun on level ground [klx]; `elevation` of the sun [rad].

    The IES's clear sky at turbidity 2, half-way to its partly cloudy one at 6.
    """
    height = np.sin(elevation)
    clear, partly = 0.8 + 15.5 * height**0.5, 0.3 + 45.0 * height
    haze = np.clip((turbidity - 2.0) / 8.0, 0.0, 1.0)
    return float(clear + haze * max(partly - clear, 0.0))


def overcast_sky(directions: Float64, *, elevation: float) -> Float64:
    """Return the luminance of the CIE's overcast sky as linear Rec.709 [kcd/m²], (..., 3).

    Its level gives 0.3 + 21 sin(elevation) klx on the ground (IES Lighting Handbook, cloudy sky); `elevation` of the
    sun [rad].
    """
    # L = L_z (1 + 2 sin) / 3 gives E = 7 pi L_z / 9.
    zenith = (0.3 + 21.0 * np.sin(elevation)) * 9.0 / (7.0 * np.pi)
    luminance = zenith * (1.0 + 2.0 * np.maximum(directions[..., 2], 0.0)) / 3.0
    return np.asarray(luminance[..., None] * np.ones(3))


def sun_illuminance(*, elevation: float, turbidity: float) -> Rgb:
    """Return the sun's illuminance on a surface that faces it, as linear Rec.709 [klx]; `elevation` [rad]."""
    nm = np.arange(380.0, 781.0, 5.0)
    micron = nm / 1000.0
    height = np.degrees(elevation)
    # F. Kasten, A. T. Young, Revised optical air mass tables, Applied Optics 28, 1989.
    mass = 1.0 / (np.sin(elevation) + 0.50572 * (height + 6.07995) ** -1.6364)
    ozone = np.interp(nm, np.arange(440.0, 701.0, 20.0), _OZONE, left=0.0, right=0.0)
    beta = 0.04608 * turbidity - 0.04586
    depth = 0.008735 * micron**-4.08 + beta * micron**-1.3 + 0.35 * ozone
    planck = micron**-5 / np.expm1(14387.77 / (micron * 1000.0) / 5778.0 * 1000.0)
    matching = colour_matching(nm)
    outside = planck @ matching
    xyz = (planck * np.exp(-mass * depth)) @ matching * SOLAR_KLX / outside[1]
    return triple(_rgb(xyz))


def colour_matching(nm: ArrayLike) -> Float64:
    """Return the CIE 1931 colour matching functions at wavelengths (N,) [nm]: (N, 3).

    The fit of C. Wyman, P.-P. Sloan, P. Shirley, Simple Analytic Approximations to the CIE XYZ Color Matching
    Functions, JCGT 2(2), 2013.
    """
    wavelength = np.asarray(nm, np.float64)

    def lobe(height: float, peak: float, left: float, right: float) -> Float64:
        width = np.where(wavelength < peak, left, right)
        return np.asarray(height * np.exp(-0.5 * ((wavelength - peak) / width) ** 2))

    x = lobe(1.056, 599.8, 37.9, 31.0) + lobe(0.362, 442.0, 16.0, 26.7) + lobe(-0.065, 501.1, 20.4, 26.2)
    y = lobe(0.821, 568.8, 46.9, 40.5) + lobe(0.286, 530.9, 16.3, 31.1)
    z = lobe(1.217, 437.0, 11.8, 36.0) + lobe(0.681, 459.0, 26.0, 13.8)
    return np.stack([x, y, z], axis=-1)


def sky_map(name: str) -> Float32:
    """Make the map of a name such as `sky-25-3`: (ROWS, 2 ROWS, 3) float32, linear Rec.709 [kcd/m²].

    The lower half is ground of reflectance `GROUND` under sky and sun, fading into the horizon's haze. The layout is
    that of `lights.spec.EnvironmentLight`.
    """
    latitude = np.pi / 2 - np.pi * (np.arange(ROWS) + 0.5) / ROWS
    azimuth = np.pi - np.pi * (np.arange(2 * ROWS) + 0.5) / ROWS
    flat = np.cos(latitude)[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    directions = np.concatenate([flat, np.broadcast_to(np.sin(latitude)[:, None, None], (*flat.shape[:2], 1))], -1)
    weight = np.maximum(directions[..., 2:], 0.0) * np.cos(latitude)[:, None, None] * (np.pi / ROWS) ** 2
    if name == OVERCAST:
        image, beam = overcast_sky(directions, elevation=np.radians(OVERCAST_ELEVATION)), np.zeros(3)
    else:
        elevation, turbidity = sky_parameters(name)
        image = clear_sky(directions, elevation=elevation, turbidity=turbidity)
        own = float((image * weight).sum(axis=(0, 1)) @ LUMINANCE_WEIGHTS)
        image *= sky_illuminance(elevation=elevation, turbidity=turbidity) / own
        beam = np.array(sun_illuminance(elevation=elevation, turbidity=turbidity)) * np.sin(elevation)
    ground = np.array(GROUND) / np.pi * ((image * weight).sum(axis=(0, 1)) + beam)
    haze = np.exp(np.minimum(latitude, 0.0) / np.radians(1.5))[:, None, None]
    below = (latitude < 0)[:, None, None]
    return np.where(below, ground + haze * (image - ground), image).astype(np.float32)


def sky_parameters(name: str) -> tuple[float, float]:
    """Return the sun's elevation [rad] and the turbidity of a clear sky's name."""
    elevation, turbidity = (int(number) for number in re.findall(r"\d+", name))
    return float(np.radians(elevation)), float(turbidity)


def sky_name(elevation: float, turbidity: float) -> str:
    """Return the name of the map whose sun and haze come nearest to `elevation` [rad] and `turbidity`."""
    height = float(np.degrees(elevation))
    return f"sky-{min(ELEVATIONS, key=lambda e: abs(e - height))}-{min(TURBIDITIES, key=lambda t: abs(t - turbidity))}"


def sky_path(name: str, folder: Path) -> Path:
    """Return the EXR file of a sky, made in `folder` on first use."""

    def write(path: Path) -> None:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        with OpenEXR.File(header, {"RGB": sky_map(name).astype(np.float16)}) as file:
            file.write(str(path))

    return write_once(folder / f"{name}.exr", write)


def _perez(row: Float64, cosine: ArrayLike, gamma: Float64) -> Float64:
    a, b, c, d, e = row
    return np.asarray((1 + a * np.exp(b / cosine)) * (1 + c * np.exp(d * gamma) + e * np.cos(gamma) ** 2))


def _rgb(xyz: Float64) -> Float64:
    """Turn XYZ into linear Rec.709; what Rec.709 cannot show loses its negative channel and keeps its luminance."""
    rgb = np.maximum(xyz @ RGB_FROM_XYZ.T, 0.0)
    luminance = rgb @ LUMINANCE_WEIGHTS
    return np.asarray(rgb * (xyz[..., 1] / np.maximum(luminance, 1e-12))[..., None])
