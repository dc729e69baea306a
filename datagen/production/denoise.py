"""Denoise each light's layer on its own, so that any mix of layers stays clean.

Intel Open Image Denoise (Áfra 2019) through `mitsuba_oidn`, guided by albedo and normals. Its cost is proportional
to the area, so of a variant only those rectangles are denoised in which it differs from `all`. Where the removed object
was to be seen a variant is made of its own samples alone, by the same network as all else, so that nothing tells where
that was. OIDN's smaller network ("balanced"), at less than half the cost, serves for outlines.
"""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from scipy.ndimage import binary_dilation, find_objects, gaussian_filter, label, uniform_filter

from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.verification.residuals import LIMIT, residual
from multilight.lights.display.tonemap import MIDDLE_GREY
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.colour import LUMINANCE_WEIGHTS

AUTO_SPP = 2048  # samples a pixel at which raw layers were as near to a converged render as denoised ones
T = TypeVar("T")
Box = tuple[int, int, int, int]
"""Rows and columns of a rectangle: first row, end row, first column, end column."""

TILE = 8  # pixels: rectangles are made of such tiles
AROUND = 2  # tiles that rectangles reach beyond what they are for: more brought a variant no nearer to the truth
BLOCK = 16  # pixels over which the denoiser's exposure is metered
VISIBLE = 0.01  # of a channel's local radiance: what a change must reach; about the least contrast that an eye notices
FAINT = 0.03  # of the mean radiance: below it less of a change counts
GREY = 0.1  # of the local radiance of all channels counts for each: a dark one's small changes are not seen
WINDOWS = 9, 27, 81  # pixels over which a change is judged: where noise is rare bright dots, only wide ones tell it
MOST_MEMORY = 2000
"""MB, of all threads: what takes more, pictures of 2.4 megapixels, OIDN denoises in tiles, to the same bits. They
overlap: two of 2048 x 2048 pixels cost 1.09 times what they would at once, four 1.18 times."""
KEPT = 1 << 18  # pixels: up to so many a filter keeps its memory for the next picture; made anew it takes 15 ms
MARGIN = 3  # pixels round where an object was to be seen in which `all` may have taken some of its colour
SEAM = 3  # pixels round a change within which the clean pictures of a variant and of `all` are blended


def denoise_all(stack: LayerStack, *, threads: int = 1, rest: Callable[[], None] | None = None) -> Float32:
    """Denoise every layer of variant `all`, (L, H, W, 3) float32; the number of threads changes no bit.

    `rest` is called after each layer, so that what only it needed can be forgotten.
    """
    layers = np.empty(stack.radiance.shape, np.float32)

    def one(light: int) -> None:
        layers[light] = _denoise(stack, light, None, _scale(stack.radiance[light]), threads=threads)

    _each_light(one, stack, threads, rest)
    return layers


@dataclass(frozen=True)
class Removed:
    """A variant's denoised layers, (L, H, W, 3); how far each is from what was rendered, and what was done about it.

    `inside`, `outside` (L,): residuals where the removed object was to be seen, and elsewhere. `anew`: the lights whose
    layers had too large ones and were denoised as a whole.
    """

    layers: Float32
    inside: tuple[float, ...]
    outside: tuple[float, ...]
    anew: tuple[str, ...]


def denoise_without(
    stack: LayerStack,
    everything: LayerStack,
    clean: Float32,
    shown: Mask,
    *,
    threads: int = 1,
    rest: Callable[[], None] | None = None,
) -> Removed:
    """Denoise a variant where it differs from `all` and take `all`'s clean pixels elsewhere.

    `shown` (H, W) is where the removed object was to be seen, straight, in mirrors or through glass: there and MARGIN
    pixels round it, the variant is made of its own samples whatever they look like. With common random numbers most
    other pixels are bit-identical in both renders: farther than half the widest window and 2 SEAM pixels from those
    that changed, the effect of the removed object is exactly zero. A layer that does not hold the light that was
    rendered is denoised as a whole instead, where that is better.
    """
    own = binary_dilation(shown, np.ones((3, 3), bool), iterations=MARGIN)
    layers = np.empty(clean.shape, np.float32)

    def one(light: int) -> tuple[float, float, bool]:
        raw, raw_all, layer = stack.radiance[light], everything.radiance[light], layers[light]
        layer[:] = clean[light]
        if not raw.any():
            layer[:] = 0.0
            return 0.0, 0.0, False
        seen = _changed(own, raw, raw_all, layer)
        weight = _soft_mask(seen)[..., None]
        for box in _rectangles(seen):
            at = np.s_[box[0] : box[1], box[2] : box[3]]
            layer[at] += weight[at] * (_denoise(stack, light, box, _scale(raw_all), threads=threads) - layer[at])
        found = residual(layer, raw, own, ~own)
        if max(found) > LIMIT:
            whole = _denoise(stack, light, None, _scale(raw), threads=threads)
            again = residual(whole, raw, own, ~own)
            if max(again) < 0.9 * max(found):  # else it is the denoiser's own bias
                layer[:] = whole
                return again[0], again[1], True
        return found[0], found[1], False

    inside, outside, anew = zip(*_each_light(one, stack, threads, rest), strict=True)
    named = tuple(name for name, again in zip(stack.lights, anew, strict=True) if again)
    return Removed(layers, inside, outside, named)


def foreground_layers(foreground: LayerStack, whole: Float32) -> Float32:
    """Give an object its own part of the picture: premultiplied radiance, (L, H, W, 3).

    Inside the object that is `whole`, variant `all`, itself, and outside it is nothing; its outline shows the
    object's own samples.
    """
    assert foreground.coverage is not None
    layers = np.zeros(whole.shape, np.float32)
    covered, inside = foreground.coverage > 0, foreground.coverage >= 1
    for layer, own, everything in zip(layers, foreground.radiance, whole, strict=True):
        layer[covered] = own[covered]
        layer[inside] = everything[inside]
    return layers


def denoise_foreground(
    foreground: LayerStack, clean: Float32, *, threads: int = 1, rest: Callable[[], None] | None = None
) -> Float32:
    """Denoise an object's own part of the picture, as `foreground_layers`, (L, H, W, 3).

    On its outline the object's own samples are denoised apart from what lies behind, so that nothing of that
    bleeds in.
    """
    assert foreground.coverage is not None
    covered, inside = foreground.coverage > 0, foreground.coverage >= 1
    boxes = _rectangles(covered & ~inside)
    layers = np.zeros(clean.shape, np.float32)

    def one(light: int) -> None:
        for box in boxes:
            at = np.s_[box[0] : box[1], box[2] : box[3]]
            outline = _denoise(foreground, light, box, _scale(clean[light]), threads=threads, smaller=True)
            layers[light][at] = np.where(covered[at][..., None], outline, np.float32(0.0))
        layers[light][inside] = clean[light][inside]

    _each_light(one, foreground, threads, rest)
    return layers


def _changed(shown: Mask, raw: Float32, raw_all: Float32, clean: Float32) -> Mask:
    """Tell where a variant differs from `all`: where the object was to be seen, and where any channel has changed by
    more than chance, and by more than an eye would miss.

    A few paths that met the object change a pixel at random, in the whole picture; shadows and reflections change
    all pixels of a neighbourhood alike, and what is left of an outline changes some by a lot.
    """
    change, light = raw - raw_all, clean + GREY * clean.mean(axis=-1, keepdims=True)
    least = FAINT * clean.mean()
    seen = shown
    for window in WINDOWS:
        # Of what is not known to have changed yet, else a wide window would find that everywhere.
        left = (~seen[..., None]).astype(np.float32)
        chance = np.sqrt(np.maximum(_local(change * change * left, window), 0)) / window  # standard error of the mean
        needed = VISIBLE * (_local(light, window) + least) * _local(left, window) + 2 * chance
        found = np.abs(_local(change * left, window)) > needed
        seen = seen | found.any(axis=-1)
    return seen


def _local(picture: Float32, window: int) -> Float32:
    """Return means over windows, channel by channel."""
    return uniform_filter(picture, (window, window, 1))


def _soft_mask(mask: Mask) -> Float32:
    """Return 1 in the mask, falling to 0 within 2 SEAM pixels of it."""
    wide = binary_dilation(mask, iterations=SEAM)
    soft = gaussian_filter(wide.astype(np.float32), SEAM / 1.5, truncate=1.5)
    return np.where(mask, np.float32(1.0), soft)


def _rectangles(mask: Mask) -> list[Box]:
    """Cover a mask, and AROUND tiles round it, by disjoint rectangles of little area."""
    height, width = mask.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    padded = np.zeros((rows * TILE, columns * TILE), bool)
    padded[:height, :width] = mask
    tiles = padded.reshape(rows, TILE, columns, TILE).any(axis=(1, 3))
    around = np.ones((3, 3), bool)
    labels, _ = label(binary_dilation(tiles, around, iterations=AROUND), around)
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


def _each_light(
    denoise: Callable[[int], T], stack: LayerStack, threads: int, rest: Callable[[], None] | None
) -> list[T]:
    def one(light: int) -> T:
        found = denoise(light)
        if rest is not None:
            rest()
        return found

    lights = range(len(stack.lights))
    return list(map(one, lights) if threads == 1 else _pool(threads).map(one, lights))


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="denoise")


class _Denoiser(threading.local):
    """Two filters a thread, used for every layer: a filter takes images of other sizes at next to no cost.

    Each computes on one thread, because its results depend, in the last bits, on how many there are.
    """

    def __init__(self, threads: int) -> None:
        import mitsuba_oidn

        device, quality = mitsuba_oidn.Device(mitsuba_oidn.DeviceType.CPU), mitsuba_oidn.Quality
        device.num_threads = 1
        most = MOST_MEMORY // threads
        self.better, self.smaller = _filter(device, quality.High, most), _filter(device, quality.Balanced, most)


def _filter(device: Any, quality: Any, most: int) -> Any:
    made = device.new_filter("RT")
    made.hdr, made.quality, made.max_memory_mb = True, quality, most
    # The guides come from the same samples as the colour, so what noise they have the colour shares.
    made.clean_aux = True
    return made


@cache
def _denoiser(threads: int) -> _Denoiser:
    return _Denoiser(threads)


def _denoise(
    stack: LayerStack, light: int, box: Box | None, scale: float, *, threads: int, smaller: bool = False
) -> Float32:
    """Denoise a layer, or a rectangle of it, by OIDN's better or its smaller network, on one of so many threads."""
    at = np.s_[:, :] if box is None else np.s_[box[0] : box[1], box[2] : box[3]]
    layer = np.ascontiguousarray(stack.radiance[light][at])
    clean = np.empty_like(layer)
    if not layer.any():
        return layer
    assert stack.guide_albedo is not None
    assert stack.guide_normal is not None
    images = {"color": layer, "albedo": stack.guide_albedo[at], "normal": stack.guide_normal[at], "output": clean}
    filters = _denoiser(min(threads, len(stack.lights)))
    denoiser = filters.smaller if smaller else filters.better
    for name, image in images.items():
        denoiser.set_image(name, np.ascontiguousarray(image))
    denoiser.input_scale = scale
    denoiser.execute()
    if layer[..., 0].size > KEPT:
        _denoiser.cache_clear()
    return np.maximum(clean, 0.0)
