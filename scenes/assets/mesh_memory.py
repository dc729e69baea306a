"""Meshes that a process has read, and what was worked out about them."""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

from multilight.scenes.meshes import Mesh

MOST_BYTES = 1 << 30
"""The longest unused are forgotten where all take more than this."""
BYTES_PER_FACE = 800
"""What is worked out about a mesh and kept with it, estimated: triangles, and the trees of three libraries."""


class MeshMemory:
    """Keeps meshes by the file that they lie in."""

    def __init__(self) -> None:
        self._meshes: OrderedDict[Path, Mesh] = OrderedDict()
        self._bytes = 0

    def recall(self, path: Path, load: Callable[[], Mesh]) -> Mesh:
        """Return what was loaded before, or load it."""
        if path not in self._meshes:
            self._meshes[path] = load()
            self._bytes += _bytes(self._meshes[path])
        self._meshes.move_to_end(path)
        while self._bytes > MOST_BYTES and len(self._meshes) > 1:
            self._bytes -= _bytes(self._meshes.popitem(last=False)[1])
        return self._meshes[path]


def _bytes(mesh: Mesh) -> int:
    arrays = (array for part in mesh.parts for array in (part.vertices, part.faces, part.normals, part.uv))
    return sum(array.nbytes for array in arrays) + BYTES_PER_FACE * sum(len(part.faces) for part in mesh.parts)
