"""Relighting a pasted object in a picture of one's own, and giving it its shadow."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.errors import UserError
from multilight.model.inference.depth import depth_from_metres, guessed_depth
from multilight.model.inference.harmonize import network_harmonizer
from multilight.model.inference.pictures import to_bytes
from multilight.scenes.arrays import Float32

Picture = NDArray[Any]
"""8-bit, or floats in [0, 1]; display-encoded (sRGB)."""


def harmonize(
    composite: Picture,
    background: Picture,
    mask: Picture,
    depth: Picture | None = None,
    *,
    weights: str | Path | None = None,
    device: str = "auto",
) -> Picture:
    """Harmonize a picture into which an object was pasted, of any size, by the ready-made weights or one's own.

    composite, background (H, W, 3): the picture with and without the object, as a screen shows them, 8 bits or floats
    in [0, 1]; mask (H, W): where the object is (booleans, 8 bits or floats); depth (H, W): along the optical axis in
    any unit, 0 where unknown (without one, level ground is assumed). Returns (H, W, 3) of the composite's type.
    Raises `UserError` naming the array and what is allowed.
    """
    pasted, empty = _values("composite", composite, 3), _values("background", background, 3)
    covered = _values("mask", mask, 2)
    for name, other in (("background", empty), ("mask", covered), ("depth", depth)):
        if other is not None and np.shape(other)[:2] != pasted.shape[:2]:
            raise UserError(
                f"{name} has shape {np.shape(other)}, the composite {pasted.shape}; make them of equal size"
            )
    if depth is None:
        seen = guessed_depth(*covered.shape)
    else:
        metres = np.asarray(depth, np.float32)
        if metres.ndim != 2 or not np.isfinite(metres).all() or metres.min() < 0 or metres.max() <= 0:
            raise UserError("depth must be one finite, positive number a pixel (H, W), 0 where unknown")
        seen = depth_from_metres(metres)
    result = network_harmonizer(Path(weights or "slim"), device)(pasted, empty, seen, covered)
    return to_bytes(result) if np.asarray(composite).dtype == np.uint8 else result


def _values(name: str, picture: Picture, dimensions: int) -> Float32:
    """Return a picture (H, W, 3) or mask (H, W) as float32 in [0, 1]."""
    given = np.asarray(picture)
    if given.ndim != dimensions or not given.size or (dimensions == 3 and given.shape[2] != 3):
        wanted = "(H, W, 3)" if dimensions == 3 else "(H, W)"
        raise UserError(f"{name} has shape {given.shape}; it must be {wanted}")
    if given.dtype == np.uint8:
        return (given / np.float32(255.0)).astype(np.float32)
    values = given.astype(np.float32)
    if not np.isfinite(values).all() or values.min() < 0 or values.max() > 1:
        raise UserError(f"{name} runs from {values.min():g} to {values.max():g}; it must be 8-bit, or lie in [0, 1]")
    return values
