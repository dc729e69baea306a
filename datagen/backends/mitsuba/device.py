"""NumPy arrays as Dr.Jit arrays, so that the code compiled for one scene serves the next."""

from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Array = TypeVar("Array", mi.Float, mi.UInt32)
ALIGNMENT = 64


def on_device(kind: type[Array], array: NDArray[np.generic]) -> Array:
    """Put an array on the device, flat.

    Dr.Jit uses NumPy's memory where it is, and compiles other code for memory that is not aligned.
    """
    flat = np.ascontiguousarray(array).ravel()
    buffer = np.empty(flat.nbytes + ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % ALIGNMENT
    aligned = buffer[start : start + flat.nbytes].view(flat.dtype)
    aligned[:] = flat
    return kind(aligned)


def opaque(value: float) -> mi.Float:
    """Put a number on the device as data: a literal would become part of the compiled code."""
    return dr.opaque(mi.Float, float(value))
