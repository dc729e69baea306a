"""Blender's Cycles as a backend: the only room for `bpy`."""

import sys
from pathlib import Path, PurePath

from multilight.datagen.backends.machine.probe import load_in_any_order

if "bpy" not in sys.modules:
    # A process spawned by one that has Blender loaded inherits Blender's own search path, and the helper
    # package `bpy` in there would hide the real one.
    sys.path[:] = [p for p in sys.path if not PurePath(p).match("bpy/*/scripts/*")]
    # What `make system-libraries` unpacked where there was no root to install it.
    load_in_any_order([str(path) for path in sorted((Path(sys.prefix) / "system").rglob("lib*.so.*"))])

from multilight.datagen.backends.blender.backend import BlenderBackend

__all__ = ["BlenderBackend"]
