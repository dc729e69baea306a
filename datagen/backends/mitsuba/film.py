"""The film: sums over samples, pixel by pixel, of which each may have another number."""

from collections.abc import Collection, Iterable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from multilight.datagen.backends.mitsuba.adaptive import Blocks
from multilight.datagen.backends.mitsuba.device import on_device
from multilight.datagen.backends.protocol import LARGE
from multilight.datagen.files.shelf import Shelf
from multilight.scenes.arrays import Float32, Int64

Key = tuple[str, str]
"""A variant or a mask, and the object that it is of."""
Values = list[mi.Color3f] | list[mi.Normal3f]
"""What samples bring, one lane each."""


class Film:
    """What a view's samples add up to; always in the same order, so to the same bits.

    Sums lie in the host's memory, where what nothing was added to takes none; those of a large picture on disk, in a
    nameless file in a folder.
    """

    def __init__(self, height: int, width: int, scratch: Path | None = None) -> None:
        self._shape = height, width
        self._shelf = Shelf(scratch) if height * width > LARGE else None
        self._samples: Int64 = np.zeros(height * width, np.int64)
        self._sums: dict[Key, Float32] = {}
        self._squares: dict[Key, Float32] = {}

    def __contains__(self, key: Key) -> bool:
        return key in self._sums

    def add(self, blocks: Blocks, values: Iterable[tuple[Key, Values]], *, squares: Collection[Key] = ()) -> None:
        """Add the samples of some blocks; of what is named in `squares`, `variance` can be asked for then."""
        pixels = slice(int(blocks.pixel[0]), int(blocks.pixel[-1]) + 1)
        counts = np.bincount(blocks.pixel - blocks.pixel[0])
        self._samples[pixels] += counts * blocks.size
        count = on_device(mi.UInt32, counts.astype(np.uint32))
        first = on_device(mi.UInt32, (np.cumsum(counts) - counts).astype(np.uint32))

        def add(known: dict[Key, Float32], key: Key, sums: list[mi.Float]) -> None:
            if key not in known:
                known[key] = self._zeros((len(sums), self._samples.size))
            totals = known[key]
            before = [on_device(mi.Float, channel[pixels]) for channel in totals]
            for channel, total in zip(totals, _added(before, sums, first, count), strict=True):
                if (found := np.array(total)).any():
                    channel[pixels] = found

        for key, several in values:
            sums = [dr.block_sum(channel, blocks.size) for value in several for channel in value]
            add(self._sums, key, sums)
            if key in squares:
                add(self._squares, key, [sum(dr.square(channel) for channel in sums)])
        self._rest()

    def _rest(self) -> None:
        if self._shelf is not None:
            self._shelf.rest()

    def _zeros(self, shape: tuple[int, ...]) -> Float32:
        return np.zeros(shape, np.float32) if self._shelf is None else self._shelf.zeros(shape, np.float32)

    def mean(self, key: Key) -> Float32:
        """Return means over each pixel's samples, (n, H, W, 3)."""
        sums, samples = self._sums[key], self._samples.astype(np.float32)
        means = np.empty((len(sums) // 3, *self._shape, 3), np.float32)
        for place, channel in enumerate(sums):
            means[place // 3, ..., place % 3] = (channel / samples).reshape(self._shape)
        self._rest()
        return means

    def take(self, key: Key) -> Float32:
        """Return `mean`; of a large picture it is gone then, and can be asked for no more."""
        means = self.mean(key)
        if self._samples.size > LARGE:
            del self._sums[key]
        return means

    def variance(self, key: Key, blocks: int) -> tuple[Float32, Float32]:
        """Return what a block adds up to, (H, W), and the variance of that between a pixel's blocks, (H, W).

        Both are summed over layers and channels. `blocks` is the number of blocks that each pixel has had.
        """
        sums = [on_device(mi.Float, channel) for channel in self._sums[key]]
        squares = on_device(mi.Float, self._squares[key][0])
        self._rest()
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
