"""Blender's Cycles as a backend: the only room for `bpy`."""

import sys
from pathlib import PurePath

# A process spawned by one that has Blender loaded inherits Blender's own search path, and the helper
# package `bpy` in there would hide the real one.
if "bpy" not in sys.modules:
    sys.path[:] = [p for p in sys.path if not PurePath(p).match("bpy/*/scripts/*")]

from datagen.backends.blender.backend import BlenderBackend

__all__ = ["BlenderBackend"]
