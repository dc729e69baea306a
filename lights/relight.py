"""The one weighted sum: any lighting of a view from its per-light layers."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32


def gain_matrix(lights: Sequence[str], condition: LightingCondition) -> Float32:
    """Return the linear gain of each light and channel, exposure included: (L, 3) float32.

    A light that the condition does not name is off. Raises `ValueError` where the condition names a light that
    is not among `lights`.
    """
    unknown = [name for name in condition.gains if name not in lights]
    if unknown:
        raise ValueError(f"condition {condition.name!r} names the light(s) {unknown}, but the rig holds {list(lights)}")
    off = (0.0, 0.0, 0.0)
    gains = np.array([condition.gains.get(name, off) for name in lights], np.float64).reshape(-1, 3)
    return (gains * 2.0**condition.exposure_ev).astype(np.float32)


def mix(radiance: NDArray[np.floating], lights: Sequence[str], condition: LightingCondition) -> Float32:
    """Light a view: the sum over lights of gain * layer * 2**ev.

    radiance (L, H, W, 3) linear Rec.709, any float type, one layer a light in the order of `lights`; returns
    (H, W, 3) float32, linear. Layers whose gain is zero are not read. Raises `ValueError` where the shapes
    disagree or the condition names an unknown light.
    """
    if radiance.ndim != 4 or radiance.shape[0] != len(lights) or radiance.shape[3] != 3:
        raise ValueError(
            f"radiance has shape {radiance.shape}, but {len(lights)} light(s) need ({len(lights)}, H, W, 3)"
        )
    total = np.zeros(radiance.shape[1:], np.float32)
    for layer, gain in zip(radiance, gain_matrix(lights, condition), strict=True):
        if gain.any():
            total += np.multiply(layer, gain, dtype=np.float32)
    return total
