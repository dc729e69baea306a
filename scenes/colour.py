"""Colour: the sRGB transfer curve, Rec.709 luminance, and CIE XYZ; twins for torch and Dr.Jit are tested against it."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multilight.scenes.frozen import Rgb, triple

LUMINOUS_EFFICACY = 179.0
"""lm/W of equal-energy white light over the visible range: the constant of the Radiance software (WHTEFFICACY in
its color.h; G. Ward Larson and R. Shakespeare, Rendering with Radiance, 1998). One constant for every colour keeps
photometric input proportional to Rec.709 luminance."""
LUMINANCE_WEIGHTS = (0.2126, 0.7152, 0.0722)
"""Relative luminance of the Rec.709 primaries under D65 (ITU-R BT.709-6, item 3.2)."""
RGB_FROM_XYZ = np.array(
    [[3.2404542, -1.5371385, -0.4985314], [-0.9692660, 1.8760108, 0.0415560], [0.0556434, -0.2040259, 1.0572252]]
)
"""Linear Rec.709 from CIE XYZ, both with D65 white (IEC 61966-2-1)."""
XYZ_FROM_RGB = np.linalg.inv(RGB_FROM_XYZ)
"""CIE XYZ from linear Rec.709."""


def luminance(radiance: ArrayLike) -> NDArray[np.floating]:
    """Return the Rec.709 relative luminance of linear RGB (..., 3): (...), in the same unit and float type."""
    rgb = np.asarray(radiance)
    weights = np.array(LUMINANCE_WEIGHTS, rgb.dtype if np.issubdtype(rgb.dtype, np.floating) else np.float64)
    return rgb @ weights


def srgb_encode(linear: ArrayLike) -> NDArray[np.floating]:
    """Encode linear values in [0, 1] with the sRGB transfer curve (IEC 61966-2-1); clips to [0, 1]."""
    x = np.clip(linear, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_decode(encoded: ArrayLike) -> NDArray[np.floating]:
    """Invert `srgb_encode`: sRGB-encoded values in [0, 1] to linear ones."""
    x = np.clip(encoded, 0.0, 1.0)
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def linear_from_hex(colour: str) -> Rgb:
    """Decode six hex digits of sRGB to linear Rec.709."""
    return triple(srgb_decode([int(colour[i : i + 2], 16) / 255 for i in (0, 2, 4)]))
