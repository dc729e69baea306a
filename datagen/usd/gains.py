"""What a lighting condition sets: the colour and strength of each light, set anew in every variant."""

from collections.abc import Callable
from typing import Any

import numpy as np
from pxr import Gf

from multilight.scenes.arrays import Float64
from multilight.scenes.colour import LUMINOUS_EFFICACY
from multilight.scenes.frozen import Rgb

Strength = tuple[str, Callable[[Float64], None]]
"""A light's name, and what authors its strength for a gain (3,) in the current edit target."""


def lamp_strength(light: str, made: Any, level: Float64) -> Strength:
    """Vary a UsdLux light: `level` (3,) is its intensity attribute at each channel, in the unit of that light."""
    intensity, color = made.CreateIntensityAttr(), made.CreateColorAttr()

    def set_gain(gain: Float64) -> None:
        amount = level * gain
        peak = float(amount.max())
        intensity.Set(peak)
        color.Set(Gf.Vec3f(*(amount / peak if peak > 0 else np.ones(3)).tolist()))

    return light, set_gain


def glow_strength(light: str, target: Any, radiance: Rgb, *, textured: bool) -> Strength:
    """Vary a glowing material: `target` is its emissive colour [cd/m²], or the scale of the picture that feeds it."""

    def set_gain(gain: Float64) -> None:
        amount = (photometric(radiance) * gain).tolist()
        target.Set(Gf.Vec4f(*amount, 1.0) if textured else Gf.Vec3f(*amount))

    return light, set_gain


def photometric(amount: Rgb) -> Float64:
    """Convert a coloured radiometric quantity to its photometric one, channel by channel, (3,)."""
    return LUMINOUS_EFFICACY * np.array(amount, np.float64)
