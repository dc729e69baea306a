"""Where layers of a large picture wait to be denoised: on disk, in memory only while they are looked at."""

import mmap
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from multilight.datagen.storage.layers import LayerStack
from multilight.scenes.arrays import Float32


class Shelf:
    """Keeps arrays in files without names in a folder (None: that of the system)."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._areas: list[mmap.mmap] = []

    def put(self, stack: LayerStack) -> LayerStack:
        """Put what is large of a stack on disk; it is read when it is looked at."""
        albedo, normal = stack.guide_albedo, stack.guide_normal
        return replace(
            stack,
            radiance=self._on_disk(stack.radiance),
            guide_albedo=None if albedo is None else self._on_disk(albedo),
            guide_normal=None if normal is None else self._on_disk(normal),
        )

    def rest(self) -> None:
        """Give back the memory of all that was looked at."""
        for area in self._areas:
            area.madvise(mmap.MADV_DONTNEED)

    def _on_disk(self, values: Float32) -> Float32:
        with tempfile.TemporaryFile(dir=self._folder) as file:
            values.tofile(file)
            file.flush()
            area = mmap.mmap(file.fileno(), values.nbytes, access=mmap.ACCESS_COPY)
        self._areas.append(area)
        return np.frombuffer(area, np.float32).reshape(values.shape)
