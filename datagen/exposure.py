"""Meter each lighting condition on the rendered layers, as a camera would before the picture is taken."""

from collections.abc import Sequence

import numpy as np

from datagen.layers import Float32
from lights.relight import mix
from lights.spec import LightingCondition
from lights.tonemap import meter_ev

THUMBNAIL = 32  # pixels a side of the pictures that are metered


def thumbnail(layers: Float32, size: int = THUMBNAIL) -> Float32:
    """Shrink (L, H, W, 3) layers by averaging blocks to about `size` pixels a side; linear, so light still adds."""
    height, width = layers.shape[1:3]
    step_y, step_x = max(1, height // size), max(1, width // size)
    cut = layers[:, : height // step_y * step_y, : width // step_x * step_x]
    blocks = cut.reshape(len(layers), height // step_y, step_y, width // step_x, step_x, 3)
    return blocks.mean(axis=(2, 4), dtype=np.float32)


def meter_condition(
    condition: LightingCondition, lights: Sequence[str], thumbnails: Sequence[Float32]
) -> LightingCondition:
    """Add the metered exposure over all views to the condition's own exposure offset."""
    unexposed = condition.model_copy(update={"exposure_ev": 0.0})
    pictures = np.concatenate([mix(t, lights, unexposed).reshape(-1, 3) for t in thumbnails])
    return condition.model_copy(update={"exposure_ev": round(condition.exposure_ev + meter_ev(pictures[None]), 4)})
