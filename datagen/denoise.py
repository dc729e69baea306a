"""Denoise each light's layer on its own, so that any mix of layers stays clean.

Intel Open Image Denoise (Áfra 2019) through `mitsuba_oidn`, guided by albedo and normals.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from datagen.layers import Float32, LayerStack

SEAM = 3  # pixels round a changed one in which a variant may differ from `all`


def denoise_all(stack: LayerStack, threads: int) -> Float32:
    """Denoise every layer of variant `all`; returns (L, H, W, 3) float32."""
    return np.stack([_denoise(layer, stack, threads) for layer in stack.radiance])


def denoise_without(stack: LayerStack, everything: LayerStack, clean: Float32, threads: int) -> Float32:
    """Denoise a variant where it differs from `all` and take `all`'s clean pixels elsewhere, (L, H, W, 3).

    With common random numbers most pixels are bit-identical in both renders, so that the effect of the
    removed object is exactly zero wherever it has no influence.
    """
    layers = clean.copy()
    for i, (raw, raw_all) in enumerate(zip(stack.radiance, everything.radiance, strict=True)):
        changed = (raw != raw_all).any(axis=-1)
        if not raw.any():
            layers[i] = 0.0
        elif changed.any():
            weight = _soft_mask(changed)[..., None]
            layers[i] += weight * (_denoise(raw, stack, threads) - clean[i])
    return layers


def foreground_layers(foreground: LayerStack, everything: LayerStack, clean: Float32) -> Float32:
    """Give an object its share of the clean picture: premultiplied radiance, (L, H, W, 3).

    The share is measured between the raw renders, whose samples are the same, so it is exactly one inside
    the object and zero outside.
    """
    assert foreground.coverage is not None
    raw, raw_all = foreground.radiance, everything.radiance
    share = np.divide(raw, raw_all, out=np.zeros_like(raw), where=raw_all > 0)
    share = np.where(foreground.coverage[..., None] >= 1.0, np.float32(1.0), share.clip(0.0, 1.0))
    return np.where(foreground.coverage[..., None] <= 0.0, np.float32(0.0), share * clean)


def _soft_mask(changed: NDArray[np.bool_]) -> Float32:
    wide = binary_dilation(changed, iterations=2 * SEAM)
    soft = gaussian_filter(wide.astype(np.float32), SEAM / 1.5, truncate=1.5)
    return np.where(changed, np.float32(1.0), soft)


@cache
def _device(threads: int) -> Any:
    import mitsuba_oidn

    device = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU)
    device.num_threads = threads
    return device


def _denoise(layer: Float32, stack: LayerStack, threads: int) -> Float32:
    import mitsuba_oidn

    if not layer.any():
        return layer
    clean = mitsuba_oidn.denoise(
        np.ascontiguousarray(layer),
        albedo=np.ascontiguousarray(stack.guide_albedo),
        normal=np.ascontiguousarray(stack.guide_normal),
        hdr=True,
        device=_device(threads),
    )
    return np.maximum(np.asarray(clean, dtype=np.float32), 0.0)
