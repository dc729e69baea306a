"""A few plausible luminaires, by formula: (vertical angle, horizontal angle) [degrees] → relative candelas."""

import math
from collections.abc import Callable

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.formats.ies import SAMPLES, Luminaire, ies_text, mean_about_axis, parse_ies, profile_flux


def _beam(angle: Float64, width: float, spill: float) -> Float64:
    """A reflector's beam of full width at half maximum `width`, with a fraction of spill up to a cut-off at 75."""
    core = np.exp(-math.log(2.0) * (2.0 * angle / width) ** 2)
    return (1.0 - spill) * core + spill * np.cos(np.radians(np.minimum(angle * 1.2, 90.0))) ** 2


def _batwing(angle: Float64) -> Float64:
    wing = np.exp(-(((angle - 42.0) / 16.0) ** 2))
    return (0.45 + 0.75 * wing) * np.clip((88.0 - angle) / 22.0, 0.0, 1.0)


def _washer(angle: Float64, azimuth: Float64) -> Float64:
    towards = 0.5 + 0.5 * np.cos(np.radians(azimuth))
    return (0.15 + 0.85 * towards) * np.exp(-(((angle - 30.0 * towards) / 24.0) ** 2)) * (angle < 85.0)


def _bulb(angle: Float64) -> Float64:
    """A globe whose cap hides the light towards its socket."""
    return np.clip((168.0 - angle) / 38.0, 0.0, 1.0) * (0.9 + 0.1 * np.sin(np.radians(angle)))


LUMINAIRES: dict[str, tuple[float, Callable[[Float64, Float64], Float64]]] = {
    "downlight_narrow": (900.0, lambda v, _: _beam(v, 15.0, 0.03)),
    "downlight_medium": (1100.0, lambda v, _: _beam(v, 36.0, 0.05)),
    "downlight_wide": (1400.0, lambda v, _: _beam(v, 70.0, 0.12)),
    "batwing": (3200.0, lambda v, _: _batwing(v)),
    "uplight": (1800.0, lambda v, _: _beam(180.0 - v, 95.0, 0.1)),
    "up_and_down": (1000.0, lambda v, _: _beam(v, 40.0, 0.02) + 0.8 * _beam(180.0 - v, 50.0, 0.02)),
    "wall_washer": (1500.0, _washer),
    "pendant_shade": (1200.0, lambda v, _: np.clip((62.0 - v) / 14.0, 0.0, 1.0) + 0.12 * (v > 150.0)),
    "bare_bulb": (800.0, lambda v, _: _bulb(v)),
}
"""Plausible luminaires: flux [lm] and distribution; after common catalogue shapes, not measured."""


def luminaire(name: str) -> Luminaire:
    """Return a built-in luminaire as its IES file would be read; raises `ValueError` for a name not in `LUMINAIRES`."""
    if name not in LUMINAIRES:
        raise ValueError(f"no luminaire {name!r}; there are {', '.join(sorted(LUMINAIRES))}")
    lumens, shape = LUMINAIRES[name]
    vertical = np.arange(0.0, 180.1, 2.5)
    horizontal = np.arange(0.0, 180.1, 15.0) if name == "wall_washer" else np.array([0.0])
    candela = np.array([shape(vertical, np.full_like(vertical, azimuth)) for azimuth in horizontal])
    mean = np.interp(np.linspace(0, 180, SAMPLES), vertical, mean_about_axis(horizontal, candela))
    candela *= lumens / profile_flux(tuple(mean))
    return parse_ies(ies_text(vertical, horizontal, candela, form=".3f"), source=name)
