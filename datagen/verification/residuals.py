"""What was stored against what was rendered: the largest difference that noise does not explain.

A denoiser changes each pixel, but over some dozens of pixels it should keep the light that was rendered, in each
colour. So the means over blocks of several sizes are compared: small ones find a small piece of something that should
not be there, large ones a faint one in noise.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from multilight.scenes.arrays import Float32, Float64, Mask

Blocks = Float64

SIDES = (8, 16, 32)  # pixels
LEAST = 0.25  # of a block's pixels must count, else it is left out
SIGMAS = 4.0  # standard errors of a block's mean that noise explains
AROUND = 13  # blocks a side over which noise is estimated: where it is rare bright dots, one block may have none
LIMIT = 0.1
"""Above it a variant is denoised as a whole: of healthy layers one in some hundreds is, by the denoiser's own bias."""
GREY, FAINT = 0.1, 0.02  # of the block's mean of all channels, and of the picture's: below it light is not missed


def residual(stored: Float32, rendered: Float32, *where: Mask, least_side: int = SIDES[0]) -> list[float]:
    """Return by how much of the local radiance blocks of a layer differ from what was rendered, beyond noise.

    stored, rendered: (H, W, 3) linear radiance; each `where` (H, W): pixels that count. The result for each is the
    largest over channels and over blocks of at least so many pixels a side, up to the whole picture; 0 where noise
    explains all.
    """
    change = stored - rendered
    # The noise of a pixel; edges are in both.
    noise = _blocks(np.square(change - uniform_filter(change, (3, 3, 1))) * np.float32(9 / 8))
    faint = FAINT * float(rendered.mean())
    pictures = change, np.square(change), rendered
    return [_largest([_blocks(part, mask) for part in pictures], _blocks(mask[..., None]), noise, faint, least_side)
            for mask in where]  # fmt: skip


def _largest(sums: list[Blocks], pixels: Blocks, noise: Blocks, faint: float, least_side: int) -> float:
    found = []
    for side in SIDES:
        if side > SIDES[0]:
            *sums, pixels, noise = (_joined(values) for values in (*sums, pixels, noise))
        if side >= least_side:
            around = uniform_filter(noise, (AROUND, AROUND, 1)) / side**2
            found.append(_beyond_noise(sums, pixels, around, faint, LEAST * side**2))
    *whole, count, total = (values.sum(axis=(0, 1), keepdims=True) for values in (*sums, pixels, noise))
    found.append(
        _beyond_noise(whole, count, total / (noise[..., 0].size * SIDES[-1] ** 2), faint, LEAST * SIDES[-1] ** 2)
    )
    return max(found)


def _beyond_noise(sums: Sequence[Blocks], pixels: Blocks, noise: Blocks, faint: float, least: float) -> float:
    """Return the largest residual of blocks, from sums over their pixels and one pixel's noise variance round them."""
    change, squares, light = sums
    n = np.maximum(pixels, 1)
    mean = change / n
    error = np.sqrt(np.maximum(squares / n - mean**2, noise) / n)
    local = light / n
    local = local + GREY * local.mean(axis=-1, keepdims=True) + faint
    beyond = (np.abs(mean) - SIGMAS * error) / np.maximum(local, 1e-30)
    return float(beyond.max(initial=0.0, where=np.broadcast_to(pixels >= least, beyond.shape)))


def _blocks(values: NDArray[np.generic], where: Mask | None = None) -> Blocks:
    """Add up over blocks of the smallest side; the picture is filled up with zeros to whole blocks of the largest."""
    height, width, channels = values.shape
    rows, columns = (-(-side // SIDES[-1]) * SIDES[-1] for side in (height, width))
    whole = np.zeros((rows, columns, channels), np.float64)
    whole[:height, :width] = values if where is None else np.where(where[..., None], values, 0)
    side = SIDES[0]
    return whole.reshape(rows // side, side, columns // side, side, channels).sum(axis=(1, 3))


def _joined(blocks: Blocks) -> Blocks:
    rows, columns, channels = blocks.shape
    return blocks.reshape(rows // 2, 2, columns // 2, 2, channels).sum(axis=(1, 3))


def noise_variance(image: Float32) -> Float64:
    """Estimate the noise variance of an (H, W, 3) render's pixels (mean over channels), (H, W).

    It is the square of a pixel's distance from its four neighbours' mean, less what those add (Immerkær 1996 has
    the same idea with a larger mask). Edges and texture count as noise, so averages of it are not too small.
    """
    grey = image.mean(axis=-1, dtype=np.float64)
    padded = np.pad(grey, 1, mode="reflect")
    around = (padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]) / 4
    return np.square(grey - around) * 0.8
