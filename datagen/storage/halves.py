"""Layers in half the memory: kept as files hold them, made float32 each time that they are asked for."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32

HALF_MAX = 65504.0
Planes = Sequence[NDArray[Any]]
"""The channels (H, W) of a layer as a file holds them."""


class Halves(Mapping[str, Float32]):
    """Layers (L, H, W, 3) by variant, each in half precision unless it would overflow.

    `rest` gives back the memory of what was looked at; it is called before another variant is.
    """

    def __init__(self, layers: Mapping[str, Sequence[Planes]], rest: Callable[[], None] | None = None) -> None:
        self._layers, self._rest = layers, rest

    def __getitem__(self, variant: str) -> Float32:
        layers = self.planes(variant)
        joined = np.empty((len(layers), *layers[0][0].shape, len(layers[0])), np.float32)
        for number, planes in enumerate(layers):
            for channel, plane in enumerate(planes):
                joined[number, ..., channel] = plane
        return joined

    def __iter__(self) -> Iterator[str]:
        return iter(self._layers)

    def __len__(self) -> int:
        return len(self._layers)

    def planes(self, variant: str) -> Sequence[Planes]:
        """Return the planes of each layer."""
        self.rest()
        return self._layers[variant]

    def rest(self) -> None:
        """Give back the memory of what was looked at, where it can be read again."""
        if self._rest is not None:
            self._rest()


def stored_layers(variants: Mapping[str, Float32], variant: str) -> Iterator[Planes]:
    """Yield each layer of a variant as a file holds it."""
    if isinstance(variants, Halves):
        yield from variants.planes(variant)
    else:
        yield from map(in_planes, variants[variant])


def in_planes(layer: Float32) -> Planes:
    """Return a layer (H, W, 3) as a file holds it."""
    return planes_of(in_half(layer))


def planes_of(image: NDArray[Any]) -> Planes:
    """Split a picture (H, W) or (H, W, C) into its channels."""
    return [np.ascontiguousarray(plane) for plane in np.moveaxis(np.atleast_3d(image), -1, 0)]


def in_half(values: Float32) -> NDArray[np.floating]:
    """Return radiance as half floats, or as it is where these would overflow: nothing is clamped."""
    return values.astype(np.float16) if float(values.max(initial=0.0)) <= HALF_MAX else values
