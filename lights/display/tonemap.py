"""From scene-linear radiance to what a screen shows: transfer curve, exposure metering, tone curve."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.colour import luminance, srgb_encode

MIDDLE_GREY = 0.18
"""The luminance that a metered picture's key lands on: the reflectance of a photographer's grey card."""

HIGHLIGHT_LIMIT = 1.5
"""Metering keeps the 97th percentile of luminance below this where it can: brighter means near-white."""


def tone_curve(radiance: ArrayLike) -> Float32:
    """Compress linear Rec.709 (..., 3) into [0, 1], linear; negative values count as black.

    The highlight compression of the Khronos PBR Neutral tone mapper (2024), which was made for product pictures:
    below the shoulder nothing changes; above it the brightest channel approaches 1 along a hyperbola and the
    colour fades to white, so that a saturated highlight never clips to another hue. Our shoulder starts at 0.6
    (theirs: 0.8) for a softer roll-off, and their subtraction of a 4 % surface reflection is left out, because it
    crushes and colours shadows.
    """
    rgb = np.maximum(np.asarray(radiance, np.float32), 0.0)
    shoulder, fade = 0.6, 0.15
    peak = rgb.max(axis=-1, keepdims=True)
    bright = np.maximum(peak, shoulder)
    room = 1.0 - shoulder
    new_peak = 1.0 - room**2 / (bright + room - shoulder)
    kept = 1.0 / (fade * (bright - new_peak) + 1.0)
    return np.where(peak <= shoulder, rgb, rgb * (new_peak / bright) * kept + new_peak * (1.0 - kept))


def to_display(radiance: ArrayLike, exposure_ev: float = 0.0) -> UInt8:
    """Turn linear Rec.709 radiance (..., 3) into 8-bit sRGB: exposure, tone curve, transfer curve.

    Values that are not finite show as black (NaN, -inf) or white (inf).
    """
    gain = 2.0**exposure_ev
    # Far beyond white, a cap keeps infinities out of the arithmetic.
    cap = min(1e6 / gain, 1e37)
    capped = np.clip(np.nan_to_num(np.asarray(radiance, np.float32), nan=0.0, posinf=cap, neginf=0.0), 0.0, cap)
    exposed = capped * np.float32(gain)
    return np.rint(srgb_encode(tone_curve(exposed)) * 255.0).astype(np.uint8)


def meter_ev(radiance: ArrayLike) -> float:
    """Return the exposure in EV that brings a picture's key to middle grey.

    The key is the log-mean luminance of radiance (..., 3) over the lit pixels, each held within the 5th and 95th
    percentile, so that a lamp or a black corner does not decide. Where highlights would still be lost, the exposure is
    lowered, by two stops at most. A picture without a lit pixel meters 0.
    """
    values = luminance(np.asarray(radiance, np.float64)).ravel()
    values = values[np.isfinite(values) & (values > 0.0)]
    if values.size == 0:
        return 0.0
    # Pixels a thousand times darker than the bright ones are not lit: they would drag the key without limit.
    bright = np.percentile(values, 97.0)
    lit = values[values >= 1e-3 * bright]
    low, high = np.percentile(lit, (5.0, 95.0))
    key = np.exp(np.mean(np.log(np.clip(lit, low, high))))
    exposure = np.log2(MIDDLE_GREY / key)
    return float(max(min(exposure, np.log2(HIGHLIGHT_LIMIT / bright)), exposure - 2.0))
