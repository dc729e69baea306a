"""What can be measured on a finished scene's pictures."""

import numpy as np
from PIL import Image

from multilight.datagen.errors import StoreError
from multilight.datagen.stats.facts import Values
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import file_sha256, scene_folder
from multilight.scenes.arrays import Float64
from multilight.scenes.colour import luminance
from multilight.scenes.files.limits import open_picture


def read_preview(source: DatasetSource, record: SceneRecord) -> Image.Image:
    """Read a scene's preview (RGB); raises `StoreError` where it is missing or not as it was written."""
    name = f"{scene_folder(record.index)}/preview.png"
    try:
        with source.local(name) as path:
            # By the record: Pillow decodes much that is damaged without a word.
            if record.preview_sha256 and file_sha256(path) != record.preview_sha256:
                raise StoreError(f"{path} is damaged or replaced: its hash is not the one that scene.json states")
            with open_picture(path) as image:
                return image.convert("RGB")
    except (OSError, ValueError, SyntaxError) as error:
        raise StoreError(f"{source.address}/{name} cannot be read: {error}") from None


def picture_values(source: DatasetSource, record: SceneRecord) -> Values:
    """Measure the preview (all lights on, as displayed) and the radiance of the first and the last view."""
    preview = np.asarray(read_preview(source, record), np.float64)
    tiles = np.array_split(preview, min(4, len(record.views)), axis=1)
    ends = sorted({0, len(record.views) - 1})
    targets = (source.view(record, view).combined for view in ends)
    return {
        "luminance": [float(luminance(tile / 255.0).mean()) for tile in tiles],
        "colourfulness": [colourfulness(tile) for tile in tiles],
        "dynamic_range": [dynamic_range(np.asarray(target, np.float64)) for target in targets],
    }


def colourfulness(rgb: Float64) -> float:
    """Return the colourfulness M of 8-bit sRGB values (H, W, 3): about 0 (grey) to 110 (extremely colourful).

    D. Hasler and S. Süsstrunk, Measuring colourfulness in natural images, 2003, eq. 3.
    """
    red, green, blue = np.moveaxis(rgb, -1, 0)
    opponents = np.stack([red - green, 0.5 * (red + green) - blue])
    spread = np.hypot(*opponents.reshape(2, -1).std(axis=1))
    return float(spread + 0.3 * np.hypot(*opponents.reshape(2, -1).mean(axis=1)))


def dynamic_range(radiance: Float64) -> float:
    """Return the stops between the 1st and the 99th percentile of the luminance of radiance (H, W, 3)."""
    low, high = np.percentile(luminance(radiance), [1, 99])
    return float(np.log2(max(high, 1e-9) / max(low, high * 2.0**-20, 1e-9)))
