"""Denoise each light's layer on its own, so that any mix of layers stays clean.

Intel Open Image Denoise (Áfra 2019) through `mitsuba_oidn`, guided by albedo and normals. Its cost is proportional
to the area, so of a variant only those rectangles are denoised in which it differs from `all`, and by OIDN's smaller
network ("balanced"): it costs a third, and loses 0.2 dB in those rectangles where over a whole picture it loses 0.7.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, gaussian_filter, label, uniform_filter

from datagen.layers import Float32, LayerStack
from lights.tonemap import LUMINANCE_WEIGHTS, MIDDLE_GREY

AUTO_SPP = 2048  # samples a pixel at which raw layers were as near to a converged render as denoised ones
Mask = NDArray[np.bool_]
Box = tuple[int, int, int, int]
"""Rows and columns of a rectangle: first row, end row, first column, end column."""

TILE = 8  # pixels: rectangles are made of such tiles, and reach at least one beyond what they are for
BLOCK = 16  # pixels over which the denoiser's exposure is metered
VISIBLE = 0.03  # share of the local radiance that a change must reach: about the least contrast that an eye notices
WINDOW = 9  # pixels over which that share is taken
SEAM = 3  # pixels round a change within which the clean pictures of a variant and of `all` are blended


def denoise_all(stack: LayerStack, *, threads: int = 1) -> Float32:
    """Denoise every layer of variant `all`, (L, H, W, 3) float32; the number of threads changes no bit."""

    def one(light: int) -> Float32:
        return _denoise(stack, light, None, _scale(stack.radiance[light]))

    return _each_light(one, stack, threads)


def denoise_without(stack: LayerStack, everything: LayerStack, clean: Float32, *, threads: int = 1) -> Float32:
    """Denoise a variant where it differs visibly from `all` and take `all`'s clean pixels elsewhere, (L, H, W, 3).

    With common random numbers most pixels are bit-identical in both renders. Farther than WINDOW / 2 + 2 SEAM pixels
    from those that changed, the effect of the removed object is exactly zero.
    """

    def one(light: int) -> Float32:
        raw, raw_all, layer = stack.radiance[light], everything.radiance[light], clean[light].copy()
        if not raw.any():
            return raw
        seen = _visible_change(raw, raw_all, layer)
        weight = _soft_mask(seen)[..., None]
        for box in _rectangles(seen):
            at = np.s_[box[0] : box[1], box[2] : box[3]]
            layer[at] += weight[at] * (_denoise(stack, light, box, _scale(raw_all)) - layer[at])
        return layer

    return _each_light(one, stack, threads)


def foreground_layers(foreground: LayerStack, whole: Float32) -> Float32:
    """Give an object its own part of the picture: premultiplied radiance, (L, H, W, 3).

    Inside the object that is `whole`, variant `all`, itself, and outside it is nothing; its outline shows the
    object's own samples.
    """
    return _inside_all(foreground, whole, foreground.radiance)


def denoise_foreground(foreground: LayerStack, clean: Float32, *, threads: int = 1) -> Float32:
    """Denoise an object's own part of the picture, as `foreground_layers`, (L, H, W, 3).

    On its outline the object's own samples are denoised apart from what lies behind, so that nothing of that
    bleeds in.
    """
    assert foreground.coverage is not None
    boxes = _rectangles((foreground.coverage > 0) & (foreground.coverage < 1))

    def one(light: int) -> Float32:
        layer = np.zeros_like(clean[light])
        for box in boxes:
            layer[box[0] : box[1], box[2] : box[3]] = _denoise(foreground, light, box, _scale(clean[light]))
        return layer

    return _inside_all(foreground, clean, _each_light(one, foreground, threads))


def _inside_all(foreground: LayerStack, whole: Float32, edge: Float32) -> Float32:
    assert foreground.coverage is not None
    alpha = foreground.coverage[..., None]
    return np.where(alpha >= 1.0, whole, np.where(alpha <= 0.0, np.float32(0.0), edge))


def _visible_change(raw: Float32, raw_all: Float32, clean: Float32) -> Mask:
    """Tell where a variant differs from `all` by more than chance, and by more than an eye would miss.

    A few paths that met the object change a pixel at random, in the whole picture; shadows and reflections change
    all pixels of a neighbourhood alike, and what is left of an outline changes some by a lot.
    """
    change = (raw - raw_all).mean(axis=-1)
    local = uniform_filter(clean.mean(axis=-1), WINDOW) + VISIBLE * clean.mean()
    chance = np.sqrt(np.maximum(uniform_filter(change * change, WINDOW), 0)) / WINDOW  # standard error of the mean
    alike = np.abs(uniform_filter(change, WINDOW)) > VISIBLE * local + 2 * chance
    return alike | (uniform_filter(np.abs(change), 3) > local)


def _soft_mask(mask: Mask) -> Float32:
    """Return 1 in the mask, falling to 0 within 2 SEAM pixels of it."""
    wide = binary_dilation(mask, iterations=SEAM)
    soft = gaussian_filter(wide.astype(np.float32), SEAM / 1.5, truncate=1.5)
    return np.where(mask, np.float32(1.0), soft)


def _rectangles(mask: Mask) -> list[Box]:
    """Cover a mask, with a margin, by disjoint rectangles of little area."""
    height, width = mask.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    padded = np.zeros((rows * TILE, columns * TILE), bool)
    padded[:height, :width] = mask
    tiles = padded.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))
    around = np.ones((3, 3), bool)
    labels, _ = label(binary_dilation(tiles, around), around)
    boxes = [(r.start, r.stop, c.start, c.stop) for r, c in find_objects(labels)]
    while (pair := next((p for p in combinations(boxes, 2) if _better_joined(*p)), None)) is not None:
        boxes = [box for box in boxes if box not in pair] + [_joined(*pair)]
    return [
        (top * TILE, min(end * TILE, height), left * TILE, min(right * TILE, width)) for top, end, left, right in boxes
    ]


def _joined(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), max(a[1], b[1]), min(a[2], b[2]), max(a[3], b[3])


def _better_joined(a: Box, b: Box) -> bool:
    """Tell whether two rectangles overlap, or one round both would be no larger than the two."""
    overlap = a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]
    return overlap or _area(_joined(a, b)) <= _area(a) + _area(b)


def _area(box: Box) -> int:
    return (box[1] - box[0]) * (box[3] - box[2])


def _scale(layer: Float32) -> float:
    """Return the factor that brings a layer's log-mean luminance to middle grey, over blocks of BLOCK x BLOCK pixels.

    It is what the denoiser would choose itself (OIDN 2, "autoexposure"), but from the whole layer: rectangles that
    each chose their own would show seams.
    """
    height, width = layer.shape[:2]
    tops, lefts = np.arange(0, height, BLOCK), np.arange(0, width, BLOCK)
    grey = layer @ np.array(LUMINANCE_WEIGHTS, np.float32)
    sums = np.add.reduceat(np.add.reduceat(grey, tops, axis=0), lefts, axis=1)
    blocks = sums / (np.diff(tops, append=height)[:, None] * np.diff(lefts, append=width))
    lit = blocks[blocks > 1e-8]
    return float(MIDDLE_GREY / np.exp(np.log(lit).mean())) if lit.size else 1.0


def _each_light(denoise: Callable[[int], Float32], stack: LayerStack, threads: int) -> Float32:
    lights = range(len(stack.lights))
    return np.stack(list(map(denoise, lights) if threads == 1 else _pool(threads).map(denoise, lights)))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="denoise")


class _Denoiser(threading.local):
    """Two filters a thread, used for every layer: a filter takes images of other sizes at next to no cost.

    Each computes on one thread, because its results depend, in the last bits, on how many there are.
    """

    def __init__(self) -> None:
        import mitsuba_oidn

        device, quality = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU), mitsuba_oidn.Quality
        device.num_threads = 1
        self.whole, self.part = _filter(device, quality.High), _filter(device, quality.Balanced)


def _filter(device: Any, quality: Any) -> Any:
    made = device.new_filter("RT")
    made.hdr, made.quality = True, quality
    # The guides come from the same samples as the colour, so what noise they have the colour shares.
    made.clean_aux = True
    return made


@cache
def _denoiser() -> _Denoiser:
    return _Denoiser()


def _denoise(stack: LayerStack, light: int, box: Box | None, scale: float) -> Float32:
    """Denoise a layer, or a rectangle of it."""
    at = np.s_[:, :] if box is None else np.s_[box[0] : box[1], box[2] : box[3]]
    layer = np.ascontiguousarray(stack.radiance[light][at])
    clean = np.empty_like(layer)
    if not layer.any():
        return layer
    assert stack.guide_albedo is not None
    assert stack.guide_normal is not None
    images = {"color": layer, "albedo": stack.guide_albedo[at], "normal": stack.guide_normal[at], "output": clean}
    denoiser = _denoiser().whole if box is None else _denoiser().part
    for name, image in images.items():
        denoiser.set_image(name, np.ascontiguousarray(image))
    denoiser.input_scale = scale
    denoiser.execute()
    return np.maximum(clean, 0.0)
