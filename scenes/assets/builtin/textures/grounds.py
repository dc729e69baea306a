"""Patterns of open ground as tileable fields: lawn, gravel, paving, setts, asphalt, sand.

As in `patterns`: albedo (N, N, 3) in [0, 1], sRGB-encoded, and height (N, N) in metres, wrapping around.
"""

import numpy as np
from PIL import Image, ImageDraw
from scipy.ndimage import gaussian_filter

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.textures.patterns import Colour, axes, cells, noise, ramp, step
from multilight.scenes.random_streams import Rng

BLADES = 20000
"""Blades of grass on a tile of lawn."""


def lawn(rng: Rng, n: int, *, colours: tuple[Colour, ...]) -> tuple[Float64, Float64]:
    """Strew blades of grass seen from above, later ones over earlier and lighter, with drier patches."""
    canvas = Image.new("RGB", (n, n), tuple(int(180 * c) for c in colours[0]))
    relief = Image.new("L", (n, n), 0)
    pen, deep = ImageDraw.Draw(canvas), ImageDraw.Draw(relief)
    patch = noise(rng, n, scale=(3, 3), rough=1.2)
    for i in range(BLADES):
        level = i / BLADES
        x, y = rng.uniform(0, n, 2)
        angle, length = rng.uniform(0, 2 * np.pi), n * rng.uniform(0.015, 0.05)
        dry = 0.12 * patch[int(y) % n, int(x) % n]
        tone = np.clip(0.15 + 0.6 * level + dry + rng.normal(0, 0.1), 0, 1)
        colour = ramp(np.array([tone]), colours)[0] * (0.7 + 0.3 * level)
        ink = tuple(int(255 * c) for c in np.clip(colour, 0, 1))
        dx, dy = length * np.cos(angle), length * np.sin(angle)
        for ox in (-n, 0, n):
            for oy in (-n, 0, n):
                ends = (x + ox, y + oy, x + ox + dx, y + oy + dy)
                if max(ends[0], ends[2]) < 0 or min(ends[0], ends[2]) > n or max(ends[1], ends[3]) < 0:
                    continue
                pen.line(ends, fill=ink, width=max(1, n // 300))
                deep.line(ends, fill=int(255 * level), width=max(1, n // 300))
    height = gaussian_filter(np.asarray(relief, np.float64) / 255, 0.8, mode="wrap")
    return np.asarray(canvas, np.float64) / 255, 6e-3 * height


def gravel(rng: Rng, n: int, *, colours: tuple[Colour, ...], count: int) -> tuple[Float64, Float64]:
    """Strew `count` rounded stones, each of its own tone, dark between them."""
    near, second, index = cells(rng, n, count)
    rise = np.clip((second - near) * np.sqrt(count) * 1.4, 0, 1)
    dome = np.sqrt(np.clip(1 - (1 - rise) ** 2, 0, 1))
    tone = rng.uniform(0, 1, count)[index] + 0.06 * noise(rng, n, scale=(120, 120), rough=0.4)
    albedo = ramp(np.clip(tone, 0, 1), colours) * (0.35 + 0.65 * step(rise, 0.02, 0.4))[..., None]
    return np.clip(albedo, 0, 1), 0.35 / np.sqrt(count) * dome


def paving(rng: Rng, n: int, *, colours: tuple[Colour, ...], rows: int, joint: float) -> tuple[Float64, Float64]:
    """Lay slabs in courses, each shifted by half a slab; `rows` is even, a slab is half as wide again as high."""
    v, u = axes(n)
    row = np.floor(v * rows).astype(int)
    across = max(1, round(rows / 1.5))
    along = (u * across + 0.5 * (row % 2)) % across
    column = np.floor(along).astype(int)
    edge = np.minimum(np.minimum(v * rows % 1, 1 - v * rows % 1) / rows, np.minimum(along % 1, 1 - along % 1) / across)
    edge = edge + 0.0012 * noise(rng, n, scale=(30, 30), rough=0.8)
    slab = step(edge, joint / 2, joint / 2 + 0.004)
    tone = rng.uniform(0.15, 0.85, (rows, across))[row, column]
    tone = tone + 0.1 * noise(rng, n, scale=(6, 6)) + 0.08 * noise(rng, n, scale=(150, 150), rough=0.3)
    albedo = ramp(np.clip(tone, 0, 1), colours) * (0.45 + 0.55 * slab)[..., None]
    grain = noise(rng, n, scale=(60, 60), rough=0.5)
    return np.clip(albedo, 0, 1), 4e-3 * slab + 1.5e-4 * grain


def setts(rng: Rng, n: int, *, colours: tuple[Colour, ...], rows: int) -> tuple[Float64, Float64]:
    """Lay small cubes of stone in courses, worn round, each of its own tone."""
    v, u = axes(n)
    sway = 0.004 * noise(rng, n, scale=(4, 4), rough=1.5)
    row = np.floor((v + sway) * rows).astype(int) % rows
    shift = rng.random(rows)[row]
    along = (u * rows + shift + 30 * sway) % rows
    column = np.floor(along).astype(int) % rows
    a, b = (v + sway) * rows % 1, along % 1
    inside = np.minimum(np.minimum(a, 1 - a), np.minimum(b, 1 - b))
    dome = step(inside + 0.03 * noise(rng, n, scale=(40, 40), rough=0.8), 0.02, 0.3)
    tone = rng.uniform(0.1, 0.9, (rows, rows))[row, column] + 0.12 * noise(rng, n, scale=(100, 100), rough=0.3)
    albedo = ramp(np.clip(tone, 0, 1), colours) * (0.4 + 0.6 * step(inside, 0.02, 0.1))[..., None]
    return np.clip(albedo, 0, 1), 0.008 * dome


def asphalt(rng: Rng, n: int, *, colour: Colour) -> tuple[Float64, Float64]:
    """Roll asphalt: grains of stone in dark binder, a little stained."""
    near, second, index = cells(rng, n, 16000)
    stone = rng.random(16000) < 0.55
    light = rng.uniform(0.7, 1.7, 16000)[index]
    shown = stone[index] * step((second - near) * np.sqrt(16000), 0.05, 0.25)
    stain = 1 + 0.06 * noise(rng, n, scale=(3, 3), rough=1.2)
    tone = (1 + shown * (light - 1)) * stain
    return np.clip(np.array(colour) * tone[..., None], 0, 1), 1.2e-3 * shown


def sand(rng: Rng, n: int, *, colours: tuple[Colour, ...], ripples: int) -> tuple[Float64, Float64]:
    """Blow sand into ripples of uneven course, with grains of several tones."""
    v, _ = axes(n)
    phase = v * ripples + 0.45 * noise(rng, n, scale=(2, 2), rough=1.8)
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * phase)
    strength = step(noise(rng, n, scale=(2, 2), rough=1.5), -1.2, 1.2)
    grain = noise(rng, n, scale=(400, 400), rough=0.2)
    tone = 0.5 + 0.12 * strength * (wave - 0.5) + 0.13 * grain + 0.06 * noise(rng, n, scale=(4, 4))
    return ramp(np.clip(tone, 0, 1), colours), 5e-3 * strength * wave**1.5 + 1.5e-4 * grain
