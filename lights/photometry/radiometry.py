"""Conversions between the quantities that lamps are sold by and those that `lights.spec` holds.

Radiometric: W (flux), W/sr (intensity), W/m² (irradiance), W/(m² sr) (radiance). Formulas: W. R. McCluney,
Introduction to Radiometry and Photometry, 2nd ed., 2014, ch. 1 and 2.
"""

import math

from multilight.scenes.colour import LUMINANCE_WEIGHTS, LUMINOUS_EFFICACY
from multilight.scenes.frozen import Rgb


def watts_from_photometric(value: float) -> float:
    """Convert a photometric quantity to its radiometric one: lm to W, cd to W/sr, lux to W/m², nit to W/(m² sr)."""
    return _not_negative("photometric value", value) / LUMINOUS_EFFICACY


def photometric_from_watts(value: float) -> float:
    """Convert a radiometric quantity to its photometric one: W to lm, W/sr to cd, W/m² to lux."""
    return _not_negative("radiometric value", value) * LUMINOUS_EFFICACY


def spot_solid_angle(half_angle: float, blend: float = 0.0) -> float:
    """Return the solid angle [sr] that times the axial intensity gives the flux of a `lights.spec.SpotLight`.

    2 pi (1 - cos(half_angle)) (1 - blend / 2): the smoothstep over the soft part of the cosines averages one half.
    """
    if not 0.0 < half_angle <= math.pi or not 0.0 <= blend <= 1.0:
        raise ValueError(f"half angle {half_angle} rad must be in (0, pi] and blend {blend} in [0, 1]")
    # 1 - cos written as 2 sin² keeps its digits for narrow cones.
    return 4.0 * math.pi * math.sin(half_angle / 2.0) ** 2 * (1.0 - blend / 2.0)


def area_radiance_from_flux(flux: float, area: float) -> float:
    """Return the radiance [W/(m² sr)] of a one-sided Lambertian emitter: flux = pi * area * L, area in m²."""
    if area <= 0.0:
        raise ValueError(f"area {area} m² must be above 0")
    return _not_negative("flux", flux) / (math.pi * area)


def rgb_from_scalar(value: float, colour: Rgb) -> Rgb:
    """Give a scalar quantity a colour: linear Rec.709 `colour` scaled so that its luminance equals `value`."""
    brightness = sum(weight * channel for weight, channel in zip(LUMINANCE_WEIGHTS, colour, strict=True))
    if min(colour) < 0.0 or brightness <= 0.0:
        raise ValueError(f"colour {colour} needs channels of 0 or more and one above 0")
    scale = _not_negative("value", value) / brightness
    return (colour[0] * scale, colour[1] * scale, colour[2] * scale)


def _not_negative(what: str, value: float) -> float:
    """Return the value; raises `ValueError` where it is negative or not finite."""
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{what} {value} must be 0 or more, and finite")
    return value
