"""Classical harmonization of a pasted object: what a learned model has to beat.

Each takes `composite` and `background` (H, W, 3), float32, display-encoded sRGB in [0, 1], and the object's `mask`
(H, W) in [0, 1], and returns the picture with the object changed, (H, W, 3) float32 in [0, 1]. None of them knows
about shadows.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from multilight.scenes.arrays import Float32, Float64, Mask
from multilight.scenes.colour import XYZ_FROM_RGB, srgb_decode, srgb_encode

Baseline = Callable[[Float32, Float32, Float32], Float32]

_WHITE = XYZ_FROM_RGB.sum(axis=1)


def raw_composite(composite: Float32, background: Float32, mask: Float32) -> Float32:
    """Return the composite as it was pasted."""
    return composite.astype(np.float32)


def colour_transfer(composite: Float32, background: Float32, mask: Float32) -> Float32:
    """Give the object the mean and spread of its surroundings in CIELAB, channel by channel.

    E. Reinhard et al., Color Transfer between Images, 2001; in CIELAB instead of their lαβ, whose logarithm lets
    black pixels decide. Surroundings are the background's pixels that the object does not cover.
    """
    inside, outside = _pixels(mask)
    if not (inside.any() and outside.any()):
        return composite.astype(np.float32)
    return _over(with_colours_of(composite, inside, background[outside]), composite, mask)


def match_histograms(composite: Float32, background: Float32, mask: Float32) -> Float32:
    """Give the object the surroundings' histogram in each of R, G and B.

    Histogram specification: R. C. Gonzalez and R. E. Woods, Digital Image Processing, section 3.3. Equal values stay
    equal: each takes the midpoint of its quantiles.
    """
    inside, outside = _pixels(mask)
    if not (inside.any() and outside.any()):
        return composite.astype(np.float32)
    matched = composite.astype(np.float64)
    for channel in range(3):
        _, place, counts = np.unique(composite[inside, channel], return_inverse=True, return_counts=True)
        quantiles = (np.cumsum(counts) - 0.5 * counts) / counts.sum()
        wanted = np.sort(background[outside, channel])
        levels = (np.arange(len(wanted)) + 0.5) / len(wanted)
        matched[inside, channel] = np.interp(quantiles, levels, wanted)[place]
    return _over(matched, composite, inside.astype(np.float32))


def poisson_blend(composite: Float32, background: Float32, mask: Float32) -> Float32:
    """Keep the object's gradients, and let its outline meet the background (gradient-domain cloning).

    P. Pérez, M. Gangnet and A. Blake, Poisson Image Editing, 2003, equations 7 to 9: inside, the sum over neighbours of
    f_p - f_q equals that of the composite; outside f is the background. What the object stood before is unknown, so
    the gradient across its outline counts as zero; that of the composite would give the composite back.
    """
    inside = mask > 0.5 / 255.0
    if not inside.any() or inside.all():
        return composite.astype(np.float32)
    result = np.array(background, np.float64)
    matrix, right = _poisson_equation(composite.astype(np.float64), result, inside)
    result[inside] = spsolve(matrix, right)
    return np.clip(result, 0.0, 1.0).astype(np.float32)


def _poisson_equation(source: Float64, background: Float64, inside: Mask) -> tuple[sparse.csc_matrix, Float64]:
    """Return the matrix (N, N) and right-hand sides (N, 3) for the N pixels inside."""
    size = int(np.count_nonzero(inside))
    number = np.full(inside.shape, -1)
    number[inside] = np.arange(size)
    right, every = np.zeros((size, 3)), []
    for here, there in _neighbours():
        kept = inside[here]
        row, column = number[here][kept], number[there][kept]
        within = column >= 0
        step = source[here][kept] - source[there][kept]
        right[row] += np.where(within[:, None], step, background[there][kept])
        every += [sparse.coo_matrix((np.ones(len(row)), (row, row)), shape=(size, size))]
        links = -np.ones(np.count_nonzero(within)), (row[within], column[within])
        every += [sparse.coo_matrix(links, shape=(size, size))]
    return sum(every).tocsc(), right


def with_colours_of(picture: Float32, inside: Mask, pixels: Float32) -> Float64:
    """Shift and scale a picture (H, W, 3) in CIELAB: its pixels inside get the mean and spread of others, (N, 3)."""
    lab, wanted = lab_from_srgb(picture), lab_from_srgb(pixels)
    mean, spread = lab[inside].mean(axis=0), lab[inside].std(axis=0)
    return srgb_from_lab((lab - mean) * (wanted.std(axis=0) / np.maximum(spread, 1e-6)) + wanted.mean(axis=0))


BASELINES: dict[str, Baseline] = {
    "raw composite": raw_composite,
    "colour transfer": colour_transfer,
    "histogram": match_histograms,
    "Poisson": poisson_blend,
}
"""What models are compared with, by the name that tables show."""


def lab_from_srgb(encoded: NDArray[np.floating]) -> Float64:
    """Convert display-encoded sRGB (..., 3) in [0, 1] to CIELAB (CIE 15:2004), D65 white."""
    xyz = (srgb_decode(np.asarray(encoded, np.float64)) @ XYZ_FROM_RGB.T) / _WHITE
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def srgb_from_lab(lab: Float64) -> Float64:
    """Invert `lab_from_srgb`; colours outside sRGB are clipped."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], axis=-1)
    xyz = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29)) * _WHITE
    return np.asarray(srgb_encode(xyz @ np.linalg.inv(XYZ_FROM_RGB).T), np.float64)


def _pixels(mask: Float32) -> tuple[Mask, Mask]:
    """Return the pixels that are the object's, and those that are not at all."""
    return mask > 0.5, mask < 0.5 / 255.0


def _over(changed: NDArray[np.floating], composite: Float32, mask: Float32) -> Float32:
    alpha = mask[..., None]
    return np.clip(composite + alpha * (changed - composite), 0.0, 1.0).astype(np.float32)


def _neighbours() -> list[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Return pairs of windows: the pixels that have a neighbour on one side, and those neighbours."""
    first, last, full = slice(None, -1), slice(1, None), slice(None)
    pairs = [((first, full), (last, full)), ((full, first), (full, last))]
    return pairs + [(there, here) for here, there in pairs]
