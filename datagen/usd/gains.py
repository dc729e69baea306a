"""What a lighting condition sets: the colour and strength of each light, set anew in every variant."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Gf

from multilight.scenes.colour import LUMINOUS_EFFICACY
from multilight.scenes.frozen import Rgb


@dataclass(frozen=True)
class LampStrength:
    """A UsdLux light: `level` is its intensity attribute at each channel, in the unit of that light."""

    light: str
    intensity: Any
    color: Any
    level: Rgb

    def set_gain(self, gain: Sequence[float]) -> None:
        """Author colour and intensity for a gain (R, G, B) in the current edit target."""
        amount = np.array(self.level) * np.array(gain, np.float64)
        peak = float(amount.max())
        self.intensity.Set(peak)
        self.color.Set(Gf.Vec3f(*(amount / peak if peak > 0 else np.ones(3)).tolist()))


@dataclass(frozen=True)
class GlowStrength:
    """A glowing material: its emissive colour [cd/m²], or the scale of the picture that feeds it."""

    light: str
    target: Any
    level: Rgb
    textured: bool

    def set_gain(self, gain: Sequence[float]) -> None:
        """Author the colour for a gain (R, G, B) in the current edit target."""
        red, green, blue = (float(v) for v in np.array(self.level) * np.array(gain, np.float64))
        self.target.Set(Gf.Vec4f(red, green, blue, 1.0) if self.textured else Gf.Vec3f(red, green, blue))


Strength = LampStrength | GlowStrength


def photometric(amount: Rgb) -> Rgb:
    """Convert a coloured radiometric quantity to its photometric one, channel by channel."""
    red, green, blue = (LUMINOUS_EFFICACY * value for value in amount)
    return red, green, blue
