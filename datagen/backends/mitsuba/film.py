"""The film: sums over samples, pixel by pixel, of which each may have another number."""

from collections.abc import Collection, Iterable, Sequence
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
Parts = Sequence[tuple[Key, int]]
"""Whose planes lie one after the other, and how many each has."""


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

    def add(self, blocks: Blocks, values: Iterable[tuple[Parts, mi.Float]], *, squares: Collection[Key] = ()) -> None:
        """Add the samples of some blocks, given plane after plane; of what is named in `squares`, `variance` can be
        asked for then."""
        pixels = slice(int(blocks.pixel[0]), int(blocks.pixel[-1]) + 1)
        counts = np.bincount(blocks.pixel - blocks.pixel[0])
        self._samples[pixels] += counts * blocks.size
        count = on_device(mi.UInt32, counts.astype(np.uint32))
        first = on_device(mi.UInt32, (np.cumsum(counts) - counts).astype(np.uint32))

        def known(sums: dict[Key, Float32], parts: Parts) -> list[Float32]:
            for key, planes in parts:
                if key not in sums:
                    sums[key] = self._zeros((planes, self._samples.size))
            return [plane for key, _ in parts for plane in sums[key]]

        def add(planes: list[Float32], sums: mi.Float) -> None:
            before = on_device(mi.Float, np.stack([plane[pixels] for plane in planes]))
            for plane, found in zip(planes, _added(before, sums, first, count, len(blocks)), strict=True):
                if found.any():
                    plane[pixels] = found

        for parts, several in values:
            sums = dr.block_sum(several, blocks.size)
            add(known(self._sums, parts), sums)
            start = 0
            for key, planes in parts:
                if key in squares:
                    add(known(self._squares, [(key, 1)]), _squared(sums, start, planes, len(blocks)))
                start += planes
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
        total, squared = np.zeros((2, *self._shape), np.float32)
        for plane in self._sums[key]:
            total += plane.reshape(self._shape)
            squared += np.square(plane).reshape(self._shape)
        self._rest()
        squares = self._squares[key][0].reshape(self._shape)
        return total / blocks, np.maximum(squares - squared / blocks, 0) / (blocks - 1)


def _added(before: mi.Float, sums: mi.Float, first: mi.UInt32, count: mi.UInt32, blocks: int) -> Float32:
    """Add to each pixel of each plane the sums of its blocks, which are `count` from the `first` on; (n, P)."""
    pixels, blocks = dr.opaque(mi.UInt32, dr.width(first)), dr.opaque(mi.UInt32, blocks)
    index = dr.arange(mi.UInt32, dr.width(before))
    plane = index // pixels
    pixel = index - plane * pixels
    start, end = plane * blocks + dr.gather(mi.UInt32, first, pixel), dr.gather(mi.UInt32, count, pixel)

    def step(total, place):  # type: ignore[no-untyped-def]
        return total + dr.gather(mi.Float, sums, start + place), place + 1

    total, _ = dr.while_loop((before, mi.UInt32(0)), lambda _, place: place < end, step, label="film")
    return np.array(total).reshape(-1, dr.width(first))


def _squared(sums: mi.Float, start: int, planes: int, blocks: int) -> mi.Float:
    """Return the squares of each block's sums in some planes, added up."""
    width, end = dr.opaque(mi.UInt32, blocks), dr.opaque(mi.UInt32, start + planes)
    block = dr.arange(mi.UInt32, blocks)

    def step(total, plane):  # type: ignore[no-untyped-def]
        return total + dr.square(dr.gather(mi.Float, sums, plane * width + block)), plane + 1

    state = mi.Float(0), dr.opaque(mi.UInt32, start)
    return dr.while_loop(state, lambda _, plane: plane < end, step, label="squares")[0]
