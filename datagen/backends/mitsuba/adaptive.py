"""Adaptive sampling: the pixels that need more samples get more, for the cost of as many for each as was asked for.

A picture's mean squared error is smallest where each pixel's number of samples is proportional to the standard
deviation that one of them brings, over the root of what it costs (Neyman 1934, optimal allocation). A denoiser divides
a pixel's variance further, by the number of neighbours that look alike to it, so that is counted in. Where little
varies, Sobol' points converge faster than that rule knows, so a part goes to all pixels alike. Samples come in
blocks, each of them well distributed in itself (a power of two of Sobol' points): FIRST for every pixel, whose
differences tell the variance, and then the rest where they serve most.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, maximum_filter, uniform_filter

from multilight.scenes.arrays import Float32, Int64, UInt32

FIRST = 4
"""Blocks for every pixel."""
USUAL = 8
"""Blocks a pixel on average, at least."""
MOST = 8
"""Times the mean number of samples that one pixel gets at most."""
EVEN = 0.6
"""What every pixel needs, in units of the mean need."""
WINDOW, REACH = 5, 2  # pixels: where variance is estimated, and where a denoiser finds what looks alike
ALIKE = 0.2  # standard deviation of the kernel by which guides (albedo, normal) are compared


@dataclass(frozen=True)
class Blocks:
    """Blocks of `size` samples, pixel by pixel: each one's `pixel` (N,) uint32 and `first` sample (N,) uint32."""

    size: int
    pixel: UInt32
    first: UInt32

    def __len__(self) -> int:
        return len(self.pixel)

    def __getitem__(self, part: slice) -> "Blocks":
        return Blocks(self.size, self.pixel[part], self.first[part])


def blocks_of(counts: NDArray[np.integer], size: int, *, after: int = 0) -> Blocks:
    """Return `counts` (P,) blocks for each pixel that has had `after` of them."""
    ends = np.cumsum(counts)
    pixel = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
    place = np.arange(after, after + len(pixel), dtype=np.uint32)
    place -= np.repeat((ends - counts).astype(np.uint32), counts)
    return Blocks(size, pixel, place * np.uint32(size))


def first_blocks(pixels: int, spp: int) -> Blocks:
    """Return the blocks to begin with; where `spp` is too small to be shared out, all of them."""
    if spp < USUAL:
        return blocks_of(np.ones(pixels, np.int64), spp)
    return blocks_of(np.full(pixels, FIRST), 1 << (spp // USUAL).bit_length() - 1)


@dataclass(frozen=True)
class Pilot:
    """What a variant's first blocks tell of it, summed over layers and channels: `mean` (H, W) of a block, `variance`
    (H, W) between a pixel's blocks. `guides` (H, W, G) are what a denoiser goes by."""

    mean: Float32
    variance: Float32
    guides: Float32


def further_blocks(first: Blocks, pilots: Iterable[Pilot], cost: Float32, spp: int) -> Blocks:
    """Share out what is left of the cost of `spp` samples for each pixel.

    `pilots` are of the variants, `all` first. They share their samples, so a pixel gets what the neediest of them
    needs: else a background would be noisier, or cleaner, where an object stood. `cost` (H, W) is what a block costs.
    """
    cost = uniform_filter(cost, WINDOW).ravel()
    # What is not a number is for those to find who check the pictures.
    need = np.nan_to_num(_need(pilots), nan=0.0, posinf=0.0).ravel()
    left = (spp * cost.size // first.size - len(first)) * float(cost.mean())
    return blocks_of(_shared_out(need, cost, left, MOST * spp // first.size), first.size, after=FIRST)


def _need(pilots: Iterable[Pilot]) -> Float32:
    pilots = iter(pilots)  # one at a time: of a large picture each takes much memory
    everything = next(pilots)
    guides = everything.guides
    usual = _alike(guides)
    need = _noise(everything) / np.sqrt(usual)
    for pilot in pilots:
        alike = usual.copy()
        other = maximum_filter((pilot.guides != guides).any(axis=-1), WINDOW)
        for box in find_objects(other.astype(int)):
            reached = tuple(slice(max(0, side.start - REACH), side.stop + REACH) for side in box)
            alike[reached] = np.where(other[reached], _alike(pilot.guides[reached]), alike[reached])
        need = np.maximum(need, _noise(pilot) / np.sqrt(alike))
    return need


def _noise(pilot: Pilot) -> Float32:
    """Return a block's standard deviation over the local brightness, with all lights on, (H, W).

    The variance is that of a pixel's neighbours, not its own: a number of samples that depends on what they show
    would bias their mean.
    """
    relative = pilot.variance / np.square(uniform_filter(pilot.mean, 3) + pilot.mean.mean() + 1e-30)
    around = uniform_filter(relative, WINDOW) * WINDOW**2 - relative
    return np.sqrt(np.maximum(around, 0) / (WINDOW**2 - 1))


def _alike(guides: Float32) -> Float32:
    """Return how many pixels of the window look like the one in its centre, by a Gaussian kernel, (H, W)."""
    height, width, _ = guides.shape
    padded = np.pad(guides, ((REACH, REACH), (REACH, REACH), (0, 0)), mode="edge")
    found = np.zeros((height, width), np.float32)
    for down in range(WINDOW):
        for right in range(WINDOW):
            away = padded[down : down + height, right : right + width] - guides
            found += np.exp(np.square(away).sum(axis=-1) / (-2 * ALIKE**2))
    return found


def _shared_out(need: Float32, cost: Float32, budget: float, most: int) -> Int64:
    """Return how many blocks each pixel gets beyond FIRST, so that with these they follow need over root of cost, (P,).

    None gets more than `most`, so some of the budget may be left over.
    """
    weight = (need / max(float(need.mean()), 1e-30) + EVEN) / np.sqrt(cost)

    def counts(scale: float) -> Int64:
        return np.clip(np.rint(scale * weight - FIRST), 0, most).astype(np.int64)

    low, high = 0.0, (most + FIRST + 1) / float(weight.min())
    while high - low > 1e-6 * high:
        midpoint = (low + high) / 2
        low, high = (midpoint, high) if counts(midpoint) @ cost <= budget else (low, midpoint)
    return counts(low)
