"""Space-filling curves: Hilbert's in two and three dimensions, Morton's as its plain counterpart.

Cells are integers in [0, 2**bits) on each axis; an index counts the cells along the curve from 0. The curve starts
at the origin and ends at (2**bits - 1, 0[, 0]). All functions are vectorised: a handful of integer operations a bit.

Source of the Hilbert transform: J. Skilling, "Programming the Hilbert curve", AIP Conf. Proc. 707 (2004) 381-387.
"""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Int64


def hilbert_index(cells: ArrayLike, bits: int) -> Int64:
    """Return where on the Hilbert curve cells (N, D) lie: (N,) int64, a bijection onto [0, 2**(bits * D)).

    D is 2 or 3. Raises `ValueError` where cells lie outside [0, 2**bits) or bits * D exceeds 63.
    """
    axes = list(_checked_cells(cells, bits).T.copy())
    for bit in range(bits - 1, 0, -1):
        for i in range(len(axes)):
            _rotate(axes, i, bit)
    for i in range(1, len(axes)):
        axes[i] ^= axes[i - 1]
    flips = np.zeros_like(axes[0])
    for bit in range(bits - 1, 0, -1):
        flips ^= ((axes[-1] >> bit) & 1) * ((1 << bit) - 1)
    return _interleave([axis ^ flips for axis in axes], bits)


def morton_index(cells: ArrayLike, bits: int) -> Int64:
    """Return where on the Z-order curve (Morton 1966) cells (N, D) lie, (N,) int64; limits as for `hilbert_index`."""
    return _interleave(list(_checked_cells(cells, bits).T), bits)


def curve_order(points: ArrayLike, bits: int = 10) -> Int64:
    """Return the order (N,) int64 that sorts points (N, 3) along the Hilbert curve over their bounding box.

    Each axis is normalised by its own extent; a point counts as the cell it lies in, whose centre is the nearest of
    all. The sort is stable: points of one cell keep their order. Raises `ValueError` where points are not finite.
    """
    return np.argsort(hilbert_index(box_cells(points, bits), bits), kind="stable")


def box_cells(points: ArrayLike, bits: int) -> Int64:
    """Return the cells (N, D) int64 of points (N, D) in a grid of 2**bits cells a side over their bounding box."""
    values = np.asarray(points, np.float64)
    if values.size == 0:
        return np.zeros(values.shape, np.int64)
    if not np.isfinite(values).all():
        raise ValueError("points must be finite to be put in order")
    low, extent = values.min(axis=0), np.ptp(values, axis=0)
    normalised = (values - low) / np.where(extent > 0, extent, 1.0)
    return np.minimum((normalised * (1 << bits)).astype(np.int64), (1 << bits) - 1)


def fold(side: int) -> Int64:
    """Return the map cells (side * side, 2) int64, row and column, that a sequence visits along the 2D Hilbert curve.

    The curve goes from (0, 0) to the first row's end, (0, side - 1), as in MV-CoLight's maps.
    Raises `ValueError` unless `side` is a power of two.
    """
    bits = side.bit_length() - 1
    if side < 1 or side != 1 << bits:
        raise ValueError(f"a map's side must be a power of two, not {side}")
    cells = np.stack(np.divmod(np.arange(side * side), side), axis=-1)
    return cells[np.argsort(hilbert_index(cells[:, ::-1], max(bits, 1)))]


def _rotate(axes: list[Int64], i: int, bit: int) -> None:
    """Undo one level's rotation of the curve in place: flip axis 0 below `bit`, or swap it with axis i there."""
    below = (1 << bit) - 1
    mirrored = -((axes[i] >> bit) & 1)  # all ones where the bit is set, else zero
    swapped = (axes[0] ^ axes[i]) & below & ~mirrored
    axes[0] ^= swapped | (mirrored & below)
    if i:
        axes[i] ^= swapped


def _interleave(axes: list[Int64], bits: int) -> Int64:
    index = np.zeros_like(axes[0])
    for bit in range(bits - 1, -1, -1):
        for axis in axes:
            index = (index << 1) | ((axis >> bit) & 1)
    return index


def _checked_cells(cells: ArrayLike, bits: int) -> Int64:
    values = np.asarray(cells)
    if values.ndim != 2 or not np.issubdtype(values.dtype, np.integer):
        raise ValueError(f"cells must be integers of shape (N, D), not {values.dtype} {values.shape}")
    dimensions = values.shape[1]
    if dimensions not in (2, 3):
        raise ValueError(f"curves have 2 or 3 dimensions, not {dimensions}")
    if not 1 <= bits <= 63 // dimensions:
        raise ValueError(f"{bits} bits in {dimensions} dimensions: must be 1 to {63 // dimensions}")
    if values.size and not (values.min() >= 0 and values.max() < 1 << bits):
        raise ValueError(f"cells from {values.min()} to {values.max()} lie outside [0, {1 << bits})")
    return values.astype(np.int64)
