"""Gobos: images that a spot projects, made by formula. Linear transmission in [0, 1], row 0 at the top.

What lies past the border goes on as there, so every image ends in black or in one even tone.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from multilight.scenes.arrays import Float64, UInt8
from multilight.scenes.assets.builtin.textures.patterns import noise
from multilight.scenes.random_streams import Rng, generator_of

RESOLUTION = 512
_EDGE = 0.004
"""Width of an edge, as a fraction of the image: a gobo is metal or glass, a little out of focus."""


def _grid(n: int) -> tuple[Float64, Float64]:
    """Return (x to the right, y up) of pixel centres in [-1, 1], each (n, n)."""
    line = (2 * np.arange(n) + 1) / n - 1
    x, y = np.meshgrid(line, -line)
    return x, y


def _frame(image: Float64, margin: float = 0.04) -> Float64:
    """Cut an image to the square that is left within a black margin, and soften its edges."""
    x, y = _grid(len(image))
    inside = np.maximum(np.abs(x), np.abs(y)) < 1 - 2 * margin
    return np.clip(gaussian_filter(image * inside, _EDGE * len(image)), 0.0, 1.0)


def window(rng: Rng, n: int, *, columns: int, rows: int, arched: bool = False) -> Float64:
    """Open a window of panes between muntins; arched ones end in a half circle."""
    x, y = _grid(n)
    half = 0.36 + 0.12 * columns / rows
    open_area = (np.abs(x) < half) & (np.abs(y) < 0.82)
    if arched:
        open_area &= (y < 0.82 - half) | (np.hypot(x, y - 0.82 + half) < half)
    bar = 0.022 + 0.012 * rng.random()
    across = np.abs(((x + half) / (2 * half) * columns + 0.5) % 1 - 0.5) * 2 * half / columns
    along = np.abs(((y + 0.82) / 1.64 * rows + 0.5) % 1 - 0.5) * 1.64 / rows
    return _frame((open_area & (across > bar) & (along > bar)).astype(float))


def blinds(rng: Rng, n: int, *, slats: int) -> Float64:
    """Let light through between slats; each hangs a little differently."""
    x, y = _grid(n)
    slat = np.floor((y + 1) / 2 * slats).astype(int)
    gap = 0.45 + 0.08 * rng.standard_normal(slats)
    tilt = 0.012 * rng.standard_normal(slats)
    phase = ((y + tilt[slat] * x) + 1) / 2 * slats % 1
    cords = np.abs(np.abs(x) - 0.5) > 0.008
    return _frame((phase < gap[slat]) * cords.astype(float), margin=0.06)


def foliage(rng: Rng, n: int, *, leaves: int, length: float) -> Float64:
    """Cover the image with leaves, so that light falls through the gaps."""
    x, y = _grid(n)
    blocked = np.zeros((n, n))
    for _ in range(leaves):
        cx, cy = rng.uniform(-1.1, 1.1, 2)
        angle, size = rng.uniform(0, 2 * np.pi), length * rng.uniform(0.6, 1.4)
        u = ((x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)) / size
        v = (-(x - cx) * np.sin(angle) + (y - cy) * np.cos(angle)) / size
        # Two arcs that meet in points: a leaf.
        blocked = np.maximum(blocked, (np.abs(v) < 0.3 * (1 - u * u)) & (np.abs(u) < 1))
    return _frame(0.04 + 0.96 * (1 - gaussian_filter(blocked, 0.006 * n)), margin=0.02)


def dots(rng: Rng, n: int, *, count: int) -> Float64:
    """Punch a hexagonal field of round holes."""
    x, y = _grid(n)
    pitch = 2.0 / count
    row = np.round(y / (pitch * np.sqrt(0.75)))
    shifted = x / pitch + 0.5 * (row % 2)
    distance = np.hypot((shifted - np.round(shifted)) * pitch, y - row * pitch * np.sqrt(0.75))
    return _frame((distance < pitch * rng.uniform(0.27, 0.36)).astype(float))


def breakup(rng: Rng, n: int, *, scale: float, open_fraction: float) -> Float64:
    """Break light up into irregular patches that cover a fraction of the image."""
    field = noise(rng, n, scale=(scale, scale), rough=2.2)
    return _frame((field > np.quantile(field, 1 - open_fraction)).astype(float), margin=0.02)


def lattice(rng: Rng, n: int, *, count: int) -> Float64:
    """Cross two sets of diagonal laths, as in a garden fence or a screen."""
    x, y = _grid(n)
    width = rng.uniform(0.3, 0.45)
    a, b = ((x + y) * count / 2 % 1, (x - y) * count / 2 % 1)
    return _frame(((a > width) & (b > width)).astype(float))


GOBOS: dict[str, Callable[[Rng, int], Float64]] = {
    "gobo-window-2x2": partial(window, columns=2, rows=2),
    "gobo-window-2x3": partial(window, columns=2, rows=3),
    "gobo-window-3x4": partial(window, columns=3, rows=4),
    "gobo-window-arched": partial(window, columns=2, rows=4, arched=True),
    "gobo-blinds-wide": partial(blinds, slats=9),
    "gobo-blinds-narrow": partial(blinds, slats=18),
    "gobo-foliage-large": partial(foliage, leaves=42, length=0.3),
    "gobo-foliage-small": partial(foliage, leaves=160, length=0.15),
    "gobo-dots": partial(dots, count=9),
    "gobo-breakup-coarse": partial(breakup, scale=4.0, open_fraction=0.45),
    "gobo-breakup-fine": partial(breakup, scale=9.0, open_fraction=0.5),
    "gobo-lattice": partial(lattice, count=6),
}


def make_gobo(name: str, *, resolution: int = RESOLUTION) -> UInt8:
    """Make a gobo by name: linear transmission (N, N) uint8, the same for the same name."""
    return np.round(GOBOS[name](generator_of(name), resolution) * 255).astype(np.uint8)
