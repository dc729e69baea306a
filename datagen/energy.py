"""How much light a rendered image carries, and how far its denoised version may be from that."""

import numpy as np
from numpy.typing import NDArray

from datagen.layers import Float32

LEAST = 0.02  # of the mean: a denoiser is never held to less
SIGMAS = 4.0  # standard errors of the rendered mean
LOST = 0.04  # of a pixel's noise: denoisers damp the highlights of skewed noise; at most 0.023 was measured


def noise_variance(image: Float32) -> NDArray[np.float64]:
    """Estimate the noise variance of an (H, W, 3) render's pixels (mean over channels), (H, W).

    It is the square of a pixel's distance from its four neighbours' mean, less what those add (Immerkær 1996 has
    the same idea with a larger mask). Edges and texture count as noise, so averages of it are not too small.
    """
    grey = image.mean(axis=-1, dtype=np.float64)
    padded = np.pad(grey, 1, mode="reflect")
    around = (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 4
    return np.square(grey - around) * 0.8


def tolerance(
    mean: float | NDArray[np.floating], noise: float | NDArray[np.floating], pixels: int
) -> NDArray[np.floating]:
    """Return how far the mean over `pixels` of a denoised image may be from that of the rendered one.

    `noise` is the standard deviation of one rendered pixel, in the unit of `mean`.
    """
    return np.maximum(LEAST * np.asarray(mean), noise * np.asarray(SIGMAS / np.sqrt(pixels) + LOST))
