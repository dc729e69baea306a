"""Denoise each light's layer on its own, so that any mix of layers stays clean.

Intel Open Image Denoise (Áfra 2019) through `mitsuba_oidn`, guided by albedo and normals.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from datagen.layers import Float32, LayerStack

WHOLE = (slice(None), slice(None))
CROP, MARGIN = 64, 16  # pixels: sizes are multiples, so that few filters are made; what a denoiser sees beyond an edge
SEAM = 3  # pixels round a changed one in which a variant may differ from `all`


def denoise_all(stack: LayerStack) -> Float32:
    """Denoise every layer of variant `all`; returns (L, H, W, 3) float32."""
    return np.stack([_denoise(layer, stack) for layer in stack.radiance])


def denoise_without(stack: LayerStack, everything: LayerStack, clean: Float32) -> Float32:
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
            layers[i] += weight * (_denoise(raw, stack) - clean[i])
    return layers


def foreground_layers(foreground: LayerStack, clean: Float32) -> Float32:
    """Give an object its own part of the clean picture: premultiplied radiance, (L, H, W, 3).

    Inside the object that is variant `all` itself and outside it is nothing; on its outline the object's own
    samples are denoised apart from what lies behind, so that nothing of that bleeds in.
    """
    return _inside_all(foreground, clean, foreground.radiance)


def denoise_foreground(foreground: LayerStack, clean: Float32) -> Float32:
    """Denoise an object's own part of the picture, as `foreground_layers`, (L, H, W, 3)."""
    assert foreground.coverage is not None
    rows, columns = _crop(foreground.coverage > 0)
    layers = np.zeros_like(clean)
    for i, raw in enumerate(foreground.radiance):
        layers[i, rows, columns] = _denoise(raw, foreground, (rows, columns))
    return _inside_all(foreground, clean, layers)


def _inside_all(foreground: LayerStack, clean: Float32, edge: Float32) -> Float32:
    assert foreground.coverage is not None
    alpha = foreground.coverage[..., None]
    return np.where(alpha >= 1.0, clean, np.where(alpha <= 0.0, np.float32(0.0), edge))


def _crop(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return rows and columns that hold all of a mask, with a margin, in few different sizes."""

    def span(hit: NDArray[np.bool_]) -> slice:
        where = np.flatnonzero(hit)
        if where.size == 0:
            return slice(0, min(CROP, len(hit)))
        start = max(0, int(where[0]) - MARGIN)
        length = -(-(int(where[-1]) + 1 + MARGIN - start) // CROP) * CROP
        start = max(0, min(start, len(hit) - length))
        return slice(start, min(start + length, len(hit)))

    return span(mask.any(axis=1)), span(mask.any(axis=0))


def _soft_mask(changed: NDArray[np.bool_]) -> Float32:
    wide = binary_dilation(changed, iterations=2 * SEAM)
    soft = gaussian_filter(wide.astype(np.float32), SEAM / 1.5, truncate=1.5)
    return np.where(changed, np.float32(1.0), soft)


@cache
def _device() -> Any:
    """Open the denoiser on one thread: its results depend, in the last bits, on how many there are."""
    import mitsuba_oidn

    device = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU)
    device.num_threads = 1
    return device


def _denoise(layer: Float32, stack: LayerStack, crop: tuple[slice, slice] = WHOLE) -> Float32:
    import mitsuba_oidn

    layer = layer[crop]
    if not layer.any():
        return layer
    assert stack.guide_albedo is not None
    assert stack.guide_normal is not None
    clean = mitsuba_oidn.denoise(
        np.ascontiguousarray(layer),
        albedo=np.ascontiguousarray(stack.guide_albedo[crop]),
        normal=np.ascontiguousarray(stack.guide_normal[crop]),
        hdr=True,
        device=_device(),
    )
    return np.maximum(np.asarray(clean, dtype=np.float32), 0.0)
