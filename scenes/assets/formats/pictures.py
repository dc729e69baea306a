"""Pictures of any kind as 8 bits a channel."""

import io
from pathlib import Path

import numpy as np
from PIL import Image

from multilight.scenes.files.limits import open_picture


def as_eight_bit(source: Path | bytes) -> Image.Image:
    """Decode a picture as L, RGB or RGBA; raises `OSError`, `ValueError` or `SyntaxError` where it is broken.

    16 bits are rounded to 8, palettes and CMYK become RGB.
    """
    with open_picture(io.BytesIO(source) if isinstance(source, bytes) else source) as picture:
        picture.load()
        if picture.mode in ("I", "F") or picture.mode.startswith("I;16"):
            values = np.asarray(picture, np.float64)
            top = 1.0 if picture.mode == "F" else 65535.0
            return Image.fromarray(np.round(np.clip(values / top, 0, 1) * 255).astype(np.uint8))
        if picture.mode in ("L", "RGB", "RGBA"):
            return picture.copy()
        clear = "A" in picture.mode or "a" in picture.mode or "transparency" in picture.info
        return picture.convert("RGBA" if clear else "L" if picture.mode == "1" else "RGB")
