"""The tone curve of DTC-MultiLight: extended Reinhard on each channel, exposed by the pictures' own log-mean.

Source: Reinhard et al. 2002, "Photographic tone reproduction for digital images", equation 4, with the exposure and
the white point of MV-CoLight's `resize_tonemapping.py`. No sRGB curve follows: the values are stored as they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import UInt8

OFFSET = -2.0
"""Exposure of step -1 over the pictures' key, in natural logarithm (one stop is 0.69)."""
STEP = 0.5
"""Distance of the exposures, in natural logarithm."""


@dataclass(frozen=True)
class Metering:
    """What a lighting's pictures meter: `key`, mean of the natural logarithm of radiance; `white`, the largest one."""

    key: float
    white: float

    def exposure(self, step: int) -> float:
        """Return the exposure of step 0, 1, ... in natural logarithm: -key - 2 + (step + 1) / 2."""
        return -self.key + OFFSET + STEP * (step + 1)


@dataclass(frozen=True)
class ViewMetering:
    """One view's part in a `Metering`; `key` is None where nothing in the view is lit."""

    key: float | None
    white: float


def meter_view(radiance: ArrayLike, geometry: ArrayLike) -> ViewMetering:
    """Meter linear radiance (H, W, 3) over the pixels (H, W) that see geometry; zero counts in no channel."""
    values = np.asarray(radiance, np.float64)[np.asarray(geometry, bool)]
    lit = values[values > 0.0]
    return ViewMetering(float(np.log(lit).mean()) if lit.size else None, float(lit.max(initial=0.0)))


def join(views: Sequence[ViewMetering]) -> Metering:
    """Join the views of a lighting: the mean of their keys, as published, and the largest radiance.

    Where nothing is lit in any view, the key is 0 and white is 1: such pictures are black at any exposure.
    """
    keys = [view.key for view in views if view.key is not None]
    if not keys:
        return Metering(0.0, 1.0)
    return Metering(float(np.mean(keys)), max(view.white for view in views))


def tone_map(radiance: ArrayLike, metering: Metering, step: int) -> UInt8:
    """Tone-map linear radiance (..., 3) at exposure `step` to 8 bits, cut off (not rounded) as published.

    x' = x e^ev, w = white e^ev, y = x' (1 + x' / w^2) / (1 + x'): white comes out as 1, more is clipped.
    """
    gain = np.exp(metering.exposure(step))
    x = np.maximum(np.asarray(radiance, np.float32), 0.0) * np.float32(gain)
    white = metering.white * gain
    y = x * (1.0 + x * np.float32(1.0 / white**2)) / (1.0 + x)
    return np.clip(y * 255.0, 0.0, 255.0).astype(np.uint8)
