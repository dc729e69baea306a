"""Blender's Cycles as a backend: the only room for `bpy`."""

import ctypes
import sys
from pathlib import Path, PurePath


def _load_system_libraries(folder: Path) -> None:
    """Load the shared libraries that `make system-libraries` unpacked where there was no root to install them."""
    waiting = sorted(folder.rglob("lib*.so.*"))
    loaded = True
    while waiting and loaded:
        loaded = False
        for library in tuple(waiting):
            try:
                ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)
            except OSError:
                continue  # needs one of the others first
            waiting.remove(library)
            loaded = True


if "bpy" not in sys.modules:
    # A process spawned by one that has Blender loaded inherits Blender's own search path, and the helper
    # package `bpy` in there would hide the real one.
    sys.path[:] = [p for p in sys.path if not PurePath(p).match("bpy/*/scripts/*")]
    _load_system_libraries(Path(sys.prefix) / "system")

from datagen.backends.blender.backend import BlenderBackend  # noqa: E402

__all__ = ["BlenderBackend"]
