"""Where large arrays wait: on disk, in memory only while they are looked at."""

import mmap
import os
import tempfile
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import DTypeLike, NDArray


class Shelf:
    """Keeps arrays in files without names in a folder (None: that of the system).

    Their room is set apart when they are made, so a full disk raises `OSError` then; it is free again when they are
    forgotten.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._areas: WeakSet[mmap.mmap] = WeakSet()

    def zeros(self, shape: tuple[int, ...], kind: DTypeLike) -> NDArray[Any]:
        """Make an array of zeros on disk."""
        size = int(np.prod(shape, dtype=np.int64)) * np.dtype(kind).itemsize
        with tempfile.TemporaryFile(dir=self._folder) as file:
            os.posix_fallocate(file.fileno(), 0, size)
            area = mmap.mmap(file.fileno(), size)
        self._areas.add(area)
        return np.frombuffer(area, kind).reshape(shape)

    def keep(self, values: NDArray[Any]) -> NDArray[Any]:
        """Put an array on disk; what is returned is read when it is looked at."""
        kept = self.zeros(values.shape, values.dtype)
        kept[...] = values
        return kept

    def rest(self) -> None:
        """Give back the memory of all that was looked at, or written."""
        for area in self._areas:
            area.madvise(mmap.MADV_DONTNEED)
