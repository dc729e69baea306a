"""Conversions between the quantities that lamps are sold by and those that `lights.spec` holds.

Radiometric: W (flux), W/sr (intensity), W/m² (irradiance), W/(m² sr) (radiance). Formulas: W. R. McCluney,
Introduction to Radiometry and Photometry, 2nd ed., 2014, ch. 1 and 2.
"""

import math

from multilight.scenes.colour import LUMINANCE_WEIGHTS
from multilight.scenes.frozen import Rgb

LUMINOUS_EFFICACY = 179.0
"""lm/W of equal-energy white light over the visible range: the constant of the Radiance software (WHTEFFICACY in
its color.h; G. Ward Larson and R. Shakespeare, Rendering with Radiance, 1998). One constant for every colour keeps
photometric input proportional to Rec.709 luminance."""


def watts_from_photometric(value: float) -> float:
    """Convert a photometric quantity to its radiometric one: lm to W, cd to W/sr, lux to W/m², nit to W/(m² sr)."""
    return _not_negative("photometric value", value) / LUMINOUS_EFFICACY


def photometric_from_watts(value: float) -> float:
    """Convert a radiometric quantity to its photometric one: W to lm, W/sr to cd, W/m² to lux."""
    return _not_negative("radiometric value", value) * LUMINOUS_EFFICACY


def point_intensity_from_flux(flux: float) -> float:
    """Return the intensity [W/sr] of an isotropic point of radiant flux [W]: I = flux / (4 pi)."""
    return _not_negative("flux", flux) / (4.0 * math.pi)


def point_flux_from_intensity(intensity: float) -> float:
    """Return the flux [W] of an isotropic point of intensity [W/sr]."""
    return _not_negative("intensity", intensity) * 4.0 * math.pi


def spot_intensity_from_flux(flux: float, half_angle: float) -> float:
    """Return the intensity [W/sr] of a flux [W] spread evenly over a cone: I = flux / (2 pi (1 - cos(half_angle))).

    `half_angle` [rad] in (0, pi]. For a soft edge divide by
    `spot_solid_angle` instead.
    """
    if not 0.0 < half_angle <= math.pi:
        raise ValueError(f"half angle {half_angle} rad is outside (0, pi]")
    # 1 - cos written as 2 sin² keeps its digits for narrow cones.
    return _not_negative("flux", flux) / (4.0 * math.pi * math.sin(half_angle / 2.0) ** 2)


def spot_solid_angle(half_angle: float, blend: float = 0.0) -> float:
    """Return the solid angle [sr] that times the axial intensity gives the flux of a `lights.spec.SpotLight`.

    2 pi (1 - cos(half_angle)) (1 - blend / 2): the smoothstep over the soft share of the cosines averages one half.
    """
    if not 0.0 < half_angle <= math.pi or not 0.0 <= blend <= 1.0:
        raise ValueError(f"half angle {half_angle} rad must be in (0, pi] and blend {blend} in [0, 1]")
    return 4.0 * math.pi * math.sin(half_angle / 2.0) ** 2 * (1.0 - blend / 2.0)


def area_radiance_from_flux(flux: float, area: float) -> float:
    """Return the radiance [W/(m² sr)] of a one-sided Lambertian emitter: flux = pi * area * L, area in m²."""
    if area <= 0.0:
        raise ValueError(f"area {area} m² must be above 0")
    return _not_negative("flux", flux) / (math.pi * area)


def area_flux_from_radiance(radiance: float, area: float) -> float:
    """Return the flux [W] of a one-sided Lambertian emitter of radiance [W/(m² sr)] and area [m²]."""
    if area <= 0.0:
        raise ValueError(f"area {area} m² must be above 0")
    return _not_negative("radiance", radiance) * math.pi * area


def irradiance_from_intensity(intensity: float, distance: float, cosine: float = 1.0) -> float:
    """Return the irradiance [W/m²] at a distance [m] from a point: E = I cos(theta) / d², 0 from behind."""
    if distance <= 0.0:
        raise ValueError(f"distance {distance} m must be above 0")
    return _not_negative("intensity", intensity) * max(cosine, 0.0) / distance**2


def intensity_for_irradiance(irradiance: float, distance: float) -> float:
    """Return the intensity [W/sr] that gives an irradiance [W/m²] on a surface facing a point at a distance [m]."""
    if distance <= 0.0:
        raise ValueError(f"distance {distance} m must be above 0")
    return _not_negative("irradiance", irradiance) * distance**2


def rgb_from_scalar(value: float, colour: Rgb) -> Rgb:
    """Give a scalar quantity a colour: linear Rec.709 `colour` scaled so that its luminance equals `value`."""
    brightness = sum(weight * channel for weight, channel in zip(LUMINANCE_WEIGHTS, colour, strict=True))
    if min(colour) < 0.0 or brightness <= 0.0:
        raise ValueError(f"colour {colour} needs channels of 0 or more and one above 0")
    scale = _not_negative("value", value) / brightness
    return (colour[0] * scale, colour[1] * scale, colour[2] * scale)


# --- what lamps are sold by, as the coloured quantities that `lights.spec` holds ---


def intensity_from_candela(candela: float, colour: Rgb) -> Rgb:
    """Return the `intensity` [W/sr] of a point or spot of so many candela on its axis, in a colour."""
    return rgb_from_scalar(watts_from_photometric(candela), colour)


def intensity_from_lumens(lumens: float, colour: Rgb, solid_angle: float = 4.0 * math.pi) -> Rgb:
    """Return the `intensity` [W/sr] of a point or spot of so many lumens, in a colour.

    `solid_angle` [sr] is what the lamp shines into, weighted by its distribution: a whole sphere, or what
    `spot_solid_angle` and `lights.photometry.ies.profile_flux` return.
    """
    if solid_angle <= 0.0:
        raise ValueError(f"solid angle {solid_angle} sr must be above 0")
    return rgb_from_scalar(watts_from_photometric(lumens) / solid_angle, colour)


def irradiance_from_lux(lux: float, colour: Rgb) -> Rgb:
    """Return the `irradiance` [W/m²] of a sun that gives so many lux on a surface that faces it, in a colour."""
    return rgb_from_scalar(watts_from_photometric(lux), colour)


def radiance_from_nits(nits: float, colour: Rgb) -> Rgb:
    """Return the `radiance` [W/(m² sr)] of a luminous surface or a uniform sky of so many nits (cd/m²), in a colour."""
    return rgb_from_scalar(watts_from_photometric(nits), colour)


def area_radiance_from_lumens(lumens: float, area: float, colour: Rgb) -> Rgb:
    """Return the `radiance` [W/(m² sr)] of a one-sided Lambertian lamp of so many lumens and m², in a colour."""
    return rgb_from_scalar(area_radiance_from_flux(watts_from_photometric(lumens), area), colour)


def _not_negative(what: str, value: float) -> float:
    """Return the value; raises `ValueError` where it is negative or not finite."""
    if not 0.0 <= value < math.inf:
        raise ValueError(f"{what} {value} must be 0 or more, and finite")
    return value
