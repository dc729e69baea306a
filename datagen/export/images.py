"""Pictures of a view as other people's formats want them: 8-bit masks, 16-bit depth, PNG and JPEG bytes."""

import io

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from multilight.scenes.arrays import UInt8

DEEPEST = 65.535
"""Metres that fit into 16 bits of millimetres; what is farther counts as unknown."""


def png(pixels: UInt8 | NDArray[np.uint16]) -> bytes:
    """Encode (H, W) grey of 8 or 16 bits, or (H, W, 3) uint8 RGB, as PNG."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    return stream.getvalue()


def jpeg(pixels: UInt8, quality: int) -> bytes:
    """Encode (H, W, 3) uint8 RGB as JPEG, colours at full resolution."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=quality, subsampling=0)
    return stream.getvalue()


def to_byte(values: ArrayLike) -> UInt8:
    """Round values in [0, 1] to 8 bits."""
    return np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)


def depth_mm(z_depth: ArrayLike) -> NDArray[np.uint16]:
    """Round z_depth [m] to whole millimetres, uint16; 0 where there is nothing or it is beyond `DEEPEST`."""
    depth = np.asarray(z_depth, np.float64)
    return np.rint(np.where(depth <= DEEPEST, depth, 0.0) * 1000.0).astype(np.uint16)
