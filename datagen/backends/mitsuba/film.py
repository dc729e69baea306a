"""The film: sums over samples, pixel by pixel, of which each may have another number."""

from collections.abc import Collection, Iterable

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.adaptive import Blocks
from multilight.datagen.backends.mitsuba.device import on_device
from multilight.scenes.arrays import Float32, Int64

Key = tuple[str, str]
"""A variant or a mask, and the object that it is of."""
Values = list[mi.Color3f] | list[mi.Normal3f]
"""What samples bring, one lane each."""


class Film:
    """What a view's samples add up to; always in the same order, so to the same bits."""

    def __init__(self, height: int, width: int) -> None:
        self._shape = height, width
        self._samples: Int64 = np.zeros(height * width, np.int64)
        self._sums: dict[Key, list[mi.Float]] = {}
        self._squares: dict[Key, list[mi.Float]] = {}

    def add(self, blocks: Blocks, values: Iterable[tuple[Key, Values]], *, squares: Collection[Key] = ()) -> None:
        """Add the samples of some blocks; of what is named in `squares`, `variance` can be asked for then."""
        counts = np.bincount(blocks.pixel, minlength=self._samples.size)
        self._samples += counts * blocks.size
        count = on_device(mi.UInt32, counts.astype(np.uint32))
        first = on_device(mi.UInt32, (np.cumsum(counts) - counts).astype(np.uint32))
        for key, several in values:
            sums = [dr.block_sum(channel, blocks.size) for value in several for channel in value]
            before = self._sums.get(key, [dr.zeros(mi.Float, self._samples.size) for _ in sums])
            self._sums[key] = _added(before, sums, first, count)
            if key in squares:
                known = self._squares.get(key, [dr.zeros(mi.Float, self._samples.size)])
                self._squares[key] = _added(known, [sum(dr.square(channel) for channel in sums)], first, count)

    def mean(self, key: Key) -> Float32:
        """Return means over each pixel's samples, (n, H, W, 3)."""
        sums = np.stack([np.array(channel) for channel in self._sums[key]])
        means = (sums / self._samples.astype(np.float32)).reshape(-1, 3, *self._shape)
        return np.ascontiguousarray(means.transpose(0, 2, 3, 1))

    def variance(self, key: Key, blocks: int) -> tuple[Float32, Float32]:
        """Return what a block adds up to, (H, W), and the variance of that between a pixel's blocks, (H, W).

        Both are summed over layers and channels. `blocks` is the number of blocks that each pixel has had.
        """
        sums, squares = self._sums[key], self._squares[key][0]
        spread = dr.maximum(squares - sum(dr.square(channel) for channel in sums) / blocks, 0) / (blocks - 1)
        return np.array(sum(sums) / blocks).reshape(self._shape), np.array(spread).reshape(self._shape)


def _added(before: list[mi.Float], sums: list[mi.Float], first: mi.UInt32, count: mi.UInt32) -> list[mi.Float]:
    """Add to each pixel the sums of its blocks, which are `count` from the `first` on."""

    def step(totals, place):  # type: ignore[no-untyped-def]
        more = (dr.gather(mi.Float, channel, first + place) for channel in sums)
        return [total + one for total, one in zip(totals, more, strict=True)], place + 1

    totals, _ = dr.while_loop((before, mi.UInt32(0)), lambda _, place: place < count, step, label="film")
    dr.eval(totals)
    return totals
