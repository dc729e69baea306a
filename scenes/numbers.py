"""Small formulas that many places need."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float64


def smoothstep(t: ArrayLike) -> Float64:
    """Rise from 0 to 1 without a kink: 3 t² - 2 t³ for `t` in [0, 1]."""
    t = np.asarray(t, np.float64)
    return np.asarray(t * t * (3.0 - 2.0 * t))
