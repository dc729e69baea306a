"""Random numbers that depend on nothing but (seed, pixel, sample, dimension): Owen-scrambled Sobol' points.

Stateless, so any subset of a view's samples can be traced again with the numbers that it had: the removed-object
variants rely on it. Points of a pixel are stratified among each other in every pair of dimensions (padding).
Sources: Burley, Practical Hash-based Owen Scrambling, JCGT 9(4), 2020; bit mixer by Vegdahl, 2021; the second
dimension in five steps by Ahmed, An Implementation Algorithm of 2D Sobol Sequence Fast, Elegant, and Compact, 2024.
"""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

DIMENSIONS = 4096
"""Dimensions set apart for each vertex of a path."""


def mix(x: mi.UInt32) -> mi.UInt32:
    """Scramble 32 bits (Wellons' lowbias32)."""
    x = x ^ (x >> 16)
    x *= mi.UInt32(0x7FEB352D)
    x ^= x >> 15
    x *= mi.UInt32(0x846CA68B)
    return x ^ (x >> 16)


def _owen(reversed_bits: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """Scramble bit-reversed numbers so that each bit depends on the higher ones only; gives them back in order."""
    x = reversed_bits ^ (reversed_bits * mi.UInt32(0x3D20ADEA))
    x += seed
    x *= (seed >> 16) | mi.UInt32(1)
    x ^= x * mi.UInt32(0x05526C56)
    x ^= x * mi.UInt32(0x53A22864)
    return dr.brev(x)


def _second(x: mi.UInt32) -> mi.UInt32:
    """Return the second dimension of Sobol' point number x, bit-reversed: x times Pascal's triangle modulo 2."""
    x = x ^ (x >> 16)
    x ^= (x >> 8) & mi.UInt32(0x00FF00FF)
    x ^= (x >> 4) & mi.UInt32(0x0F0F0F0F)
    x ^= (x >> 2) & mi.UInt32(0x33333333)
    return x ^ ((x >> 1) & mi.UInt32(0x55555555))


def _unit(x: mi.UInt32) -> mi.Float:
    return mi.Float(x >> 8) * mi.Float(2.0**-24)


def stream_of(pixel: mi.UInt32, seed: mi.UInt32) -> mi.UInt32:
    """Return a pixel's stream."""
    return mix(pixel + mix(seed))


@dataclass
class Sampler:
    """The random numbers of some samples: `stream` (see `stream_of`) and `sample` are one number a lane.

    `vertex` counts along the path and may change from call to call.
    """

    stream: mi.UInt32
    sample: mi.UInt32

    def _shuffled(self, dimension: mi.UInt32 | int, vertex: mi.UInt32 | int) -> tuple[mi.UInt32, mi.UInt32]:
        """Return the dimension's seed and the sample's place in its order."""
        seed = mix(self.stream ^ (mi.UInt32(vertex) * DIMENSIONS + mi.UInt32(dimension) + 1) * mi.UInt32(0x9E3779B9))
        return seed, _owen(dr.brev(self.sample), seed)

    def next_1d(self, dimension: int, vertex: mi.UInt32 | int = 0) -> mi.Float:
        """Return a number in [0, 1)."""
        seed, order = self._shuffled(dimension, vertex)
        return _unit(_owen(order, mix(seed + mi.UInt32(1))))

    def next_2d(self, dimension: int, vertex: mi.UInt32 | int = 0) -> mi.Point2f:
        """Return a point in [0, 1)^2."""
        seed, order = self._shuffled(dimension, vertex)
        x = _owen(order, mix(seed + mi.UInt32(1)))
        y = _owen(_second(order), mix(seed + mi.UInt32(2)))
        return mi.Point2f(_unit(x), _unit(y))
