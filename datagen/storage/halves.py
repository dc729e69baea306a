"""Layers in half the memory: kept as files hold them, made float32 each time that they are asked for."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32


class Halves(Mapping[str, Float32]):
    """Layers (L, H, W, 3) by variant, in half precision unless one of them would overflow."""

    def __init__(self, layers: Mapping[str, NDArray[np.floating]]) -> None:
        self._layers = layers

    def __getitem__(self, variant: str) -> Float32:
        return self._layers[variant].astype(np.float32, copy=False)

    def __iter__(self) -> Iterator[str]:
        return iter(self._layers)

    def __len__(self) -> int:
        return len(self._layers)
