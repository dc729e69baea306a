"""Scenes that are nearly the same: made of the same things, or looking the same."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from PIL import Image
from scipy.sparse import csr_matrix

from multilight.scenes.arrays import Mask

ALIKE = 0.75
"""Scenes share this fraction of what they are made of (Jaccard index) to count as near-duplicates."""
HASH_SIZE = (33, 8)
"""Width and height [pixels] that a preview is shrunk to; each pixel but the first of a row gives one bit."""
DIFFERENT_BITS = 0.1
"""Previews whose hashes differ in at most this fraction of the bits count as near-duplicates."""

Bits = Mask


@dataclass(frozen=True)
class Pair:
    """Two scenes and how far apart they are, 0 (the same) to 1, by what they hold or by their previews."""

    first: int
    second: int
    by: Literal["content", "picture"]
    distance: float


def picture_hash(preview: Image.Image) -> Bits:
    """Return the difference hash of a picture: whether each pixel of a tiny version is brighter than its left one.

    N. Krawetz, Kind of like that, 2013.
    """
    grey = np.asarray(preview.convert("L").resize(HASH_SIZE, Image.Resampling.BOX), np.int16)
    return (np.diff(grey, axis=1) > 0).ravel()


def alike_in_content(indices: Sequence[int], tokens: Sequence[frozenset[str]]) -> list[Pair]:
    """List pairs of scenes that share at least `ALIKE` of their tokens, nearest first."""
    words = {word: column for column, word in enumerate(sorted(frozenset().union(*tokens)))}
    columns = [words[word] for held in tokens for word in sorted(held)]
    ends = np.cumsum([0] + [len(held) for held in tokens])
    table = csr_matrix((np.ones(len(columns)), columns, ends), shape=(len(tokens), max(1, len(words))))
    shared = (table @ table.T).tocoo()
    sizes = np.diff(ends)
    jaccard = shared.data / (sizes[shared.row] + sizes[shared.col] - shared.data)
    keep = (shared.row < shared.col) & (jaccard >= ALIKE)
    found = zip(shared.row[keep], shared.col[keep], jaccard[keep], strict=True)
    pairs = [Pair(indices[a], indices[b], "content", round(1.0 - float(likeness), 4)) for a, b, likeness in found]
    return sorted(pairs, key=lambda pair: (pair.distance, pair.first, pair.second))


def alike_in_picture(indices: Sequence[int], hashes: Sequence[Bits]) -> list[Pair]:
    """List pairs of scenes whose hashes differ in at most `DIFFERENT_BITS` of the bits, nearest first."""
    signs = np.array(hashes, np.float32) * 2 - 1
    pairs = []
    for row in range(len(signs) - 1):
        # Of n signs, the product sums to n - 2 x (number that differ).
        distance = (1.0 - signs[row + 1 :] @ signs[row] / signs.shape[1]) / 2.0
        for other in np.flatnonzero(distance <= DIFFERENT_BITS):
            apart = round(float(distance[other]), 4)
            pairs.append(Pair(indices[row], indices[row + 1 + int(other)], "picture", apart))
    return sorted(pairs, key=lambda pair: (pair.distance, pair.first, pair.second))
