"""Colours of light: colour temperatures and gels, as linear Rec.709 RGB of unit luminance.

colour-science is imported when first needed: its import takes about a second.
"""

import warnings
from functools import lru_cache
from types import ModuleType

import numpy as np

from multilight.lights.photometry.radiometry import rgb_from_scalar
from multilight.scenes.arrays import Float64
from multilight.scenes.colour import srgb_decode
from multilight.scenes.frozen import Rgb, triple
from multilight.scenes.numbers import smoothstep
from multilight.scenes.random_streams import Rng

COLDEST, HOTTEST = 1000.0, 25000.0
"""Range of colour temperatures in K: below, Rec.709 shows red only; above, the CIE daylight formula ends."""

EMBERS = 1800.0
"""The reddest light [K] that `temperature_of` still calls white."""

PLANCKIAN_BELOW, DAYLIGHT_ABOVE = 4000.0, 5000.0
"""Between these temperatures in K the chromaticity runs smoothly from the blackbody's to daylight's."""

GELS: dict[str, tuple[int, int, int]] = {
    "primary_red": (214, 30, 36),
    "fire_orange": (240, 92, 26),
    "deep_amber": (250, 150, 20),
    "medium_yellow": (252, 220, 50),
    "lime_green": (150, 215, 50),
    "primary_green": (30, 160, 72),
    "blue_green": (20, 165, 150),
    "steel_blue": (125, 190, 220),
    "medium_blue": (25, 105, 205),
    "deep_blue": (30, 52, 170),
    "lavender": (160, 125, 215),
    "purple": (125, 45, 165),
    "magenta": (215, 35, 125),
    "rose_pink": (245, 115, 165),
    "straw": (250, 222, 165),
}
"""Transmissions of stage filters under white light as 8-bit sRGB: approximate, after the look of common swatch
books, not measured. None is purer than a real filter, so that no channel is quite dark."""


@lru_cache(maxsize=256)  # a blackbody's spectrum takes milliseconds
def temperature_to_xy(kelvin: float) -> tuple[float, float]:
    """Return the CIE 1931 chromaticity of white light of a colour temperature in K.

    A blackbody below 4000 K, CIE daylight (D series, CIE 015:2018) above 5000 K, in between a smoothstep from one
    locus to the other, which lie apart by about 0.005. Raises `ValueError` outside 1000..25000 K.
    """
    if not COLDEST <= kelvin <= HOTTEST:
        raise ValueError(f"colour temperature {kelvin} K is outside {COLDEST:.0f}..{HOTTEST:.0f} K")
    colour, kelvin = _colour(), float(kelvin)
    t = (kelvin - PLANCKIAN_BELOW) / (DAYLIGHT_ABOVE - PLANCKIAN_BELOW)
    weight = float(smoothstep(min(max(t, 0.0), 1.0)))
    xy = np.zeros(2)
    if weight < 1.0:
        spectrum = colour.sd_blackbody(kelvin, colour.SpectralShape(360, 780, 1))
        xyz = colour.sd_to_XYZ(spectrum, k=683, method="Integration")
        xy += (1.0 - weight) * xyz[:2] / xyz.sum()
    if weight > 0.0:
        xy += weight * colour.temperature.CCT_to_xy_CIE_D(kelvin)
    return float(xy[0]), float(xy[1])


def temperature_to_rgb(kelvin: float) -> Rgb:
    """Return the linear Rec.709 RGB of unit luminance of a colour temperature in K (1000..25000).

    White is 6504 K, the CIE's D65. Below about 1900 K the light is redder than Rec.709 can show: the negative
    blue is set to zero and the luminance restored.
    """
    x, y = temperature_to_xy(kelvin)
    xyz = np.array([x / y, 1.0, (1.0 - x - y) / y])
    matrix = _colour().RGB_COLOURSPACES["ITU-R BT.709"].matrix_XYZ_to_RGB
    return rgb_from_scalar(1.0, triple(np.maximum(matrix @ xyz, 0.0)))


def temperature_of(colour: Rgb) -> tuple[float, float]:
    """Return the correlated colour temperature [K] of a linear Rec.709 colour, and how far it is from white light.

    The temperature is that of the nearest white of `temperature_to_xy` in CIE 1960 uv (the CIE's definition, with
    daylight as the hot end), held to 1800..25000 K: below candle-light, red counts as a colour. The distance from it
    is in CIE 1976 u'v'.
    """
    matrix = _colour().RGB_COLOURSPACES["ITU-R BT.709"].matrix_RGB_to_XYZ
    x, y, z = (float(value) for value in matrix @ np.array(colour))
    own = np.array([4 * x, 6 * y]) / (x + 15 * y + 3 * z)
    mired, locus = _locus()
    # The foot of the perpendicular on each stretch of the polyline.
    start, step = locus[:-1], np.diff(locus, axis=0)
    along = np.clip(((own - start) * step).sum(axis=1) / (step**2).sum(axis=1), 0.0, 1.0)
    foot = start + along[:, None] * step
    nearest = int(np.argmin(np.linalg.norm(own - foot, axis=1)))
    temperature = 1e6 / float(mired[nearest] + along[nearest] * (mired[nearest + 1] - mired[nearest]))
    return temperature, float(np.linalg.norm((own - foot[nearest]) * [1.0, 1.5]))


def gel_rgb(name: str, density: float = 1.0) -> Rgb:
    """Return the linear Rec.709 RGB of unit luminance of a gel under white light.

    `density` in [0, 1] mixes it with white, as a gel that covers part of a lamp does. Raises `ValueError` for a
    name that is not in `GELS`.
    """
    if name not in GELS:
        raise ValueError(f"no gel {name!r}; there are {', '.join(sorted(GELS))}")
    full = rgb_from_scalar(1.0, triple(srgb_decode(np.array(GELS[name]) / 255.0)))
    return triple((1.0 - density) + density * channel for channel in full)


def random_gel(rng: Rng) -> str:
    """Draw the name of a gel, each as likely as any other."""
    return str(rng.choice(sorted(GELS)))


@lru_cache(maxsize=1)
def _locus() -> tuple[Float64, Float64]:
    """Return reciprocal temperatures (N,) [1/MK] in even steps and the CIE 1960 uv of their white light, (N, 2)."""
    mired = np.linspace(1e6 / HOTTEST, 1e6 / EMBERS, 49)
    xy = np.array([temperature_to_xy(min(float(1e6 / m), HOTTEST)) for m in mired])
    return mired, np.stack([4 * xy[:, 0], 6 * xy[:, 1]], axis=1) / (12 * xy[:, 1:] - 2 * xy[:, :1] + 3)


@lru_cache(maxsize=1)
def _colour() -> ModuleType:
    """Import colour-science, silencing only its warning that plotting is not installed."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message='"Matplotlib" related API features are not available')
        import colour
    return colour
