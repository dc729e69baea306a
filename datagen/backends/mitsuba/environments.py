"""Equirectangular maps as Mitsuba's `envmap` takes them."""

import math
from typing import Any

import mitsuba as mi
import numpy as np

from multilight.scenes.arrays import Float32


def envmap(pixels: Float32, rotation: float) -> dict[str, Any]:
    """Describe an emitter that shows a map, (H, W, 3) float32, as `lights.spec.EnvironmentLight` lays it out."""
    about_z = mi.ScalarTransform4f().rotate([0, 0, 1], math.degrees(rotation))
    # Mitsuba's maps have +Y up and their centre column along +Z.
    axes = mi.ScalarTransform4f(np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]]))
    return {"type": "envmap", "bitmap": mi.Bitmap(_rows_at_poles(pixels)), "to_world": about_z @ axes}


def _rows_at_poles(pixels: Float32) -> Float32:
    """Put rows between the rows: Mitsuba's first and last row lie on the poles, ours half a row off.

    Interpolated as Mitsuba does, the result is the map interpolated as we do.
    """
    between = (pixels[1:] + pixels[:-1]) / 2
    result = np.empty((2 * len(pixels) + 1, *pixels.shape[1:]), np.float32)
    result[1::2] = pixels
    result[2:-1:2] = between
    result[0], result[-1] = pixels[0].mean(axis=0), pixels[-1].mean(axis=0)
    return result
