"""Meter each lighting condition on the rendered layers, as a camera would before the picture is taken."""

from collections.abc import Sequence

import numpy as np

from multilight.lights.display.tonemap import meter_ev
from multilight.lights.relight import mix
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import luminance

THUMBNAIL = 32  # pixels a side of the pictures that are metered
DARK = 0.05  # luminance that the brightest twentieth of every view must reach (middle grey is 0.18)
BRIGHT = 4.0  # luminance that the median of every view must stay below
LIFTED_DARK, LIFTED_BRIGHT = 1.2 * DARK, 1.0  # how far a dark view is brightened, and what others may then reach


def thumbnail(layers: Float32, size: int = THUMBNAIL) -> Float32:
    """Shrink (L, H, W, 3) layers by averaging blocks to about `size` pixels a side; linear, so light still adds."""
    height, width = layers.shape[1:3]
    step_y, step_x = max(1, height // size), max(1, width // size)
    cut = layers[:, : height // step_y * step_y, : width // step_x * step_x]
    blocks = cut.reshape(len(layers), height // step_y, step_y, width // step_x, step_x, 3)
    return blocks.mean(axis=(2, 4), dtype=np.float32)


def levels(picture: Float32) -> tuple[float, float]:
    """Return the median and the 95th percentile of a picture's luminance."""
    median, high = np.percentile(luminance(picture), [50, 95])
    return float(median), float(high)


def meter_condition(
    condition: LightingCondition,
    lights: Sequence[str],
    thumbnails: Sequence[Float32],
    seen: Sequence[tuple[float, float]],
) -> LightingCondition:
    """Add the metered exposure over all views to the condition's own exposure offset.

    A view that would come out black is brightened, as far as the others allow: a small lamp may light some views only.
    `seen` are each view's `levels` under the condition at 0 EV, at full size: small lights are lost in thumbnails.
    """
    unexposed = condition.model_copy(update={"exposure_ev": 0.0})
    pictures = [mix(t, lights, unexposed).reshape(-1, 3) for t in thumbnails]
    exposure = condition.exposure_ev + meter_ev(np.concatenate(pictures)[None])
    medians, highs = np.transpose(seen) * 2.0**exposure
    if highs.min() > 0:
        room = np.log2(LIFTED_BRIGHT / max(float(medians.max()), 1e-9))
        exposure += max(0.0, float(min(np.log2(LIFTED_DARK / highs.min()), room)))
    return condition.model_copy(update={"exposure_ev": round(exposure, 4)})
