"""Roughness and normal maps guessed from a picture of the colour, for assets that bring nothing else.

An asset id `pack/name#normal` or `pack/name#roughness` stands for the map derived of `pack/name`. What is used is the
picture's brightness between two scales: fine grain (below a pixel) is mostly noise of the file, broad shading is
mostly baked light or print. Slopes are set by their root mean square, not by a depth in metres, so that the guess
does not depend on how large the texture lies on the model.
"""

import hashlib
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from multilight.scenes.arrays import Float64, UInt8
from multilight.scenes.assets.cache import sources_key, write_once
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import LUMINANCE_WEIGHTS
from multilight.scenes.files.limits import open_picture

MAPS = ("normal", "roughness")
MEAN_ROUGHNESS = 0.75
"""Mean of every roughness map: a material divides its roughness by it, so that the map only varies it."""
SLOPE = 0.08
"""Root mean square of the slopes of a derived normal map: about five degrees."""
_FLAT = 0.015
"""Deviation of brightness below which a picture counts as plain: what is less is not blown up."""


def roughness_map(detail: Float64) -> UInt8:
    """Turn detail (N, M), high where a surface is worn smooth, into a roughness map (N, M) uint8, linear.

    Its mean is `MEAN_ROUGHNESS`, a deviation 0.09; all of it within 0.5 to 1.
    """
    level = (detail - detail.mean()) / max(float(detail.std()), 1e-12) * (detail.std() > 0)
    return np.round(np.clip(MEAN_ROUGHNESS - 0.09 * level, 0.5, 1.0) * 255).astype(np.uint8)


def band(albedo: UInt8) -> Float64:
    """Return the brightness (N, M) of a picture between 0.8 pixels and a fortieth of its size, zero on average."""
    grey = albedo[..., :3].astype(np.float64) @ LUMINANCE_WEIGHTS / 255
    detail = gaussian_filter(grey, 0.8, mode="wrap") - gaussian_filter(grey, max(grey.shape) / 40, mode="wrap")
    return np.clip(detail / max(float(detail.std()), _FLAT), -2.5, 2.5)


def slopes_to_normals(height: Float64) -> UInt8:
    """Encode the normals of a height field (N, M) in pixels as (N, M, 3) uint8, +Y up; at most `SLOPE` deep."""
    right, down = (np.roll(height, -1, axis=a) - np.roll(height, 1, axis=a) for a in (1, 0))
    spread = float(np.sqrt((right**2 + down**2).mean()))
    scale = SLOPE / max(spread, 0.2)
    normals = np.stack([-scale * right, scale * down, np.ones_like(height)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.round((normals * 0.5 + 0.5) * 255).astype(np.uint8)


def derived_map(source: Path, kind: str, cache: Path) -> Path:
    """Return the PNG of a map derived from the picture `source`, made on first use.

    Raises `AssetError` naming the file where it cannot be read.
    """
    key = hashlib.sha256(f"{source} {sources_key(__file__)}".encode()).hexdigest()[:16]
    target = cache / "textures" / "derived" / f"{key}-{kind}.png"

    def write(path: Path) -> None:
        try:
            with open_picture(source) as image:
                detail = band(np.asarray(image.convert("RGB")))
        except (OSError, ValueError, SyntaxError) as error:
            raise AssetError(f"{source} is not a readable picture: {error}") from error
        Image.fromarray(slopes_to_normals(detail) if kind == "normal" else roughness_map(detail)).save(path)

    return write_once(target, write)
