"""Do the views of a scene agree with one another? Pixels carried from view to view by the true depth."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from multilight.scenes.arrays import Float32, Float64, Mask
from multilight.scenes.cameras.pinhole import project, unproject
from multilight.scenes.spec import Camera

TOLERANCE = 0.01
"""Relative difference of depth up to which a point counts as seen in the other view."""
LEAST = 50
"""Fewest pixels that two views must share for their agreement to be measured."""


@dataclass(frozen=True)
class Pair:
    """What two views both show: pixels (H, W) of view `first`, and where view `second` has each: (N, 2) x, y."""

    first: int
    second: int
    seen: Mask
    pixels: Float64


def shared_pairs(cameras: Sequence[Camera], depths: Sequence[Float32], regions: Sequence[Mask]) -> list[Pair]:
    """List every ordered pair of views that share `LEAST` pixels of the first one's region.

    z_depths (H, W) [m], 0 where nothing; regions (H, W).
    """
    found = []
    for a, b in itertools.permutations(range(len(cameras)), 2):
        seen, pixels = shared_pixels(cameras[a], depths[a], cameras[b], depths[b])
        kept = regions[a][seen]
        if np.count_nonzero(kept) >= LEAST:
            found.append(Pair(a, b, seen & regions[a], pixels[kept]))
    return found


def disagreement(pictures: Sequence[Float32], pairs: Sequence[Pair]) -> float:
    """Return how much views of one scene disagree: the mean |difference| over all pairs, in [0, 1]; NaN without any.

    Pictures (H, W, 3). True pictures disagree as well, where surfaces shine; compare with theirs.
    """
    found = [
        np.abs(pictures[pair.first][pair.seen] - sample(pictures[pair.second], pair.pixels)).mean(dtype=np.float64)
        for pair in pairs
    ]
    return float(np.mean(found)) if found else float("nan")


def shared_pixels(camera_a: Camera, depth_a: Float32, camera_b: Camera, depth_b: Float32) -> tuple[Mask, Float64]:
    """Return the pixels (H, W) of view a that view b sees, and where it sees each: (N, 2) pixels x, y of b.

    A point counts as seen where all four of b's pixels around it have its depth, within `TOLERANCE`.
    """
    seen = depth_a > 0
    pixels, depth = project(camera_b, unproject(camera_a, depth_a)[seen])
    grid = pixels - 0.5
    with np.errstate(invalid="ignore"):
        inside = (depth > 0) & np.all((grid >= 0) & (grid < [camera_b.width - 1, camera_b.height - 1]), axis=1)
    x, y = np.where(inside[:, None], grid, 0.0).astype(np.int64).T
    around = np.stack([depth_b[y + j, x + i] for j in (0, 1) for i in (0, 1)])
    inside &= (np.abs(around - depth) <= TOLERANCE * depth).all(axis=0)
    found = seen.copy()
    found[seen] = inside
    return found, pixels[inside]


def sample(picture: Float32, pixels: Float64) -> Float32:
    """Look up a picture (H, W, 3) at pixels (N, 2) x, y, bilinearly: (N, 3)."""
    places = pixels[:, ::-1].T - 0.5
    channels = [ndimage.map_coordinates(picture[..., c], places, order=1, mode="nearest") for c in range(3)]
    return np.stack(channels, axis=-1)
