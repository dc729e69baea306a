"""Depth maps as the files of a capture have them."""

from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.inference.pictures import read_depth
from multilight.scenes.arrays import Float32


def read_depth_map(path: Path) -> Float32:
    """Read one of COLMAP's own (`.bin`), or what `read_depth` reads: (H, W) in the file's unit, 0 where unknown."""
    if path.suffix != ".bin":
        return read_depth(path)
    import pycolmap  # an extra

    depth = pycolmap.DepthMap()
    try:
        depth.read(path)
    except (ValueError, RuntimeError, OSError) as error:
        raise UserError(f"depth map {path} cannot be read: {str(error).splitlines()[0]}") from None
    values = np.asarray(depth.to_array(), np.float32)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(0.0))
