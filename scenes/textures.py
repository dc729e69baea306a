"""Procedural surface textures as tileable bitmaps, and normal maps derived from height.

A recipe returns albedo (N, N, 3) in [0, 1], sRGB-encoded, and height (N, N) in metres; both wrap around at
their borders. Row 0 is the image's top.
"""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Rng = np.random.Generator
Colour = tuple[float, float, float]
RESOLUTION = 1024


def noise(rng: Rng, n: int, *, scale: tuple[float, float], rough: float = 1.0) -> Array:
    """Make periodic noise of zero mean and unit deviation, (n, n).

    Spectral synthesis: white noise shaped by a power law `1 / (1 + f^2)^((1 + rough) / 2)`, where f counts periods
    over the tile divided by `scale` (rows, columns): the larger a scale, the finer the grain along that axis.
    """
    rows = np.fft.fftfreq(n, 1 / n)[:, None] / scale[0]
    columns = np.fft.rfftfreq(n, 1 / n)[None] / scale[1]
    spectrum = np.fft.rfft2(rng.standard_normal((n, n))) * (1 + rows**2 + columns**2) ** (-(1 + rough) / 2)
    spectrum[0, 0] = 0
    field = np.fft.irfft2(spectrum, (n, n))
    return field / field.std()


def axes(n: int) -> tuple[Array, Array]:
    """Return the tile coordinates (v down, u right) of pixel centres in [0, 1), each (n, n)."""
    line = (np.arange(n) + 0.5) / n
    v, u = np.meshgrid(line, line, indexing="ij")
    return v, u


def warp(field: Array, down: Array, right: Array) -> Array:
    """Look a periodic field up at pixels shifted by (down, right) pixels."""
    rows, columns = np.indices(field.shape)
    return map_coordinates(field, [rows + down, columns + right], order=1, mode="grid-wrap")


def ramp(t: Array, colours: tuple[Colour, ...]) -> Array:
    """Map t in [0, 1] through evenly spaced colours, (..., 3)."""
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(t, stops, [c[i] for c in colours]) for i in range(3)], -1)


def _step(x: Array, low: float, high: float) -> Array:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def wood(rng: Rng, n: int, *, colours: tuple[Colour, ...], rings: int) -> tuple[Array, Array]:
    """Grow wood grain along the columns: rings bent by slow noise, fibres and pores."""
    v, _ = axes(n)
    bend = noise(rng, n, scale=(2.0, 0.7), rough=1.6)
    phase = v * rings + 0.75 * bend * rings / 6 + 0.04 * noise(rng, n, scale=(12, 2))
    saw = phase - np.floor(phase)
    late = np.where(saw < 0.82, _step(saw, 0.1, 0.82), 1 - _step(saw, 0.82, 1.0))
    fibre = noise(rng, n, scale=(180, 2.5), rough=0.6)
    cloud = noise(rng, n, scale=(3, 1), rough=1.2)
    pores = _step(noise(rng, n, scale=(220, 9), rough=0.8), 1.6, 2.6)
    tone = np.clip(0.42 + 0.26 * (late - 0.5) + 0.085 * fibre + 0.07 * cloud, 0, 1)
    albedo = ramp(tone, colours) * (1 - 0.3 * pores[..., None])
    return albedo, 3e-5 * fibre - 1.2e-4 * pores


def planks(rng: Rng, n: int, *, colours: tuple[Colour, ...], rows: int) -> tuple[Array, Array]:
    """Lay boards of wood grain along the columns, with joints between them."""
    base, fine = wood(rng, n, colours=colours, rings=5 * rows)
    albedo, height = np.empty_like(base), np.empty_like(fine)
    line = (np.arange(n) + 0.5) / n
    for row in range(rows):
        band = slice(row * n // rows, (row + 1) * n // rows)
        inside = np.minimum(line[band] * rows - row, row + 1 - line[band] * rows) / rows
        joints = np.sort((rng.random() + np.array([0.0, 0.5]) + rng.uniform(-0.08, 0.08, 2)) % 1)
        board = np.searchsorted(joints, line) % 2
        near = np.abs((line[:, None] - joints + 0.5) % 1 - 0.5).min(axis=1)
        gap = np.minimum(_step(inside, 0.0006, 0.0022)[:, None], _step(near, 0.0006, 0.0022)[None])
        shifts, tones = rng.integers(n, size=(2, 2)), 1 + 0.13 * rng.standard_normal(2)
        grain = [np.roll(base, tuple(s), axis=(0, 1))[band] * tone for s, tone in zip(shifts, tones, strict=True)]
        relief = [np.roll(fine, tuple(s), axis=(0, 1))[band] for s in shifts]
        albedo[band] = np.where(board[None, :, None] == 0, *grain) * (0.25 + 0.75 * gap[..., None])
        height[band] = np.where(board[None] == 0, *relief) - 8e-4 * (1 - gap)
    return np.clip(albedo, 0, 1), height


def marble(rng: Rng, n: int, *, colours: tuple[Colour, ...], vein: Colour) -> tuple[Array, Array]:
    """Make polished marble: clouds, a few bold veins and many thin ones."""
    pixels = n / 16
    dx, dy = (pixels * noise(rng, n, scale=(3, 3), rough=1.5) for _ in range(2))
    clouds = warp(noise(rng, n, scale=(3, 3), rough=1.0), dx, dy)
    albedo = ramp(np.clip(0.5 + 0.22 * clouds, 0, 1), colours)
    for scale, width, strength in ((1.5, 0.035, 0.75), (3.0, 0.03, 0.45), (7.0, 0.03, 0.25)):
        field = warp(noise(rng, n, scale=(scale, scale), rough=2.0), 0.7 * dy, 0.7 * dx)
        presence = _step(noise(rng, n, scale=(2, 2), rough=1.5), -0.4, 1.4)
        line = np.exp(-((field / width) ** 2)) + 0.35 * np.exp(-((field / (5 * width)) ** 2))
        albedo += (strength * np.clip(line, 0, 1) * presence)[..., None] * (np.array(vein) - albedo)
    return np.clip(albedo, 0, 1), 1e-6 * clouds


def _cells(rng: Rng, n: int, count: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """Distances to the nearest and second nearest of `count` random points on the torus, and the nearest's index."""
    tree = cKDTree(rng.random((count, 2)), boxsize=1.0)
    v, u = axes(n)
    distance, index = tree.query(np.stack([v, u], -1).reshape(-1, 2), k=2)
    return distance[:, 0].reshape(n, n), distance[:, 1].reshape(n, n), index[:, 0].reshape(n, n)


def terrazzo(rng: Rng, n: int, *, base: Colour, chips: tuple[Colour, ...]) -> tuple[Array, Array]:
    """Strew angular stone chips of two sizes into a ground."""
    albedo = np.array(base) * (1 + 0.02 * noise(rng, n, scale=(60, 60), rough=0.3)[..., None])
    for count, share in ((2600, 0.35), (420, 0.45)):
        near, second, index = _cells(rng, n, count)
        kept = rng.random(count) < share
        shrink = rng.uniform(0.12, 0.4, count)[index]
        inside = kept[index] & ((second - near) > shrink * 0.5 / np.sqrt(count)) & (near < 0.62 / np.sqrt(count))
        colour = np.array(chips)[rng.integers(len(chips), size=count)] * rng.uniform(0.85, 1.1, (count, 1))
        edge = np.clip(gaussian_filter(inside.astype(float), 0.8, mode="wrap"), 0, 1)[..., None]
        albedo = albedo * (1 - edge) + colour[index] * edge
    return np.clip(albedo, 0, 1), np.zeros((n, n))


def weave(rng: Rng, n: int, *, across: Colour, along: Colour, threads: int) -> tuple[Array, Array]:
    """Weave a plain linen of two thread colours; `threads` (even) a tile."""
    v, u = axes(n)
    wander = 0.10 * threads / 32
    v = v + wander / threads * noise(rng, n, scale=(2, 12), rough=1.0)
    u = u + wander / threads * noise(rng, n, scale=(12, 2), rough=1.0)
    row, column = v * threads, u * threads
    over = (np.floor(row) + np.floor(column)) % 2
    bulge_row, bulge_column = np.sin(np.pi * (row % 1)), np.sin(np.pi * (column % 1))
    weft, warp_ = bulge_row * (0.6 + 0.4 * bulge_column), bulge_column * (0.6 + 0.4 * bulge_row)
    top = np.where(over == 0, weft, warp_)
    hue_row = 1 + 0.10 * rng.standard_normal(threads)[np.floor(row).astype(int) % threads]
    hue_column = 1 + 0.10 * rng.standard_normal(threads)[np.floor(column).astype(int) % threads]
    colour = np.where(
        (over == 0)[..., None], np.array(across) * hue_row[..., None], np.array(along) * hue_column[..., None]
    )
    fuzz = 0.05 * noise(rng, n, scale=(threads * 3, threads * 3), rough=0.3)
    return np.clip(colour * (0.45 + 0.55 * top + fuzz)[..., None], 0, 1), 2.5e-4 * top


def tiles(rng: Rng, n: int, *, colours: tuple[Colour, ...], grout: Colour, count: int) -> tuple[Array, Array]:
    """Lay square glazed tiles, `count` a side; several colours alternate as a chequerboard."""
    v, u = axes(n)
    row, column = np.floor(v * count).astype(int), np.floor(u * count).astype(int)
    inset = np.minimum(np.minimum(v * count % 1, 1 - v * count % 1), np.minimum(u * count % 1, 1 - u * count % 1))
    inset = inset + 0.0015 * noise(rng, n, scale=(40, 40), rough=1.0)
    body = _step(inset, 0.010, 0.018)
    tone = 1 + 0.035 * rng.standard_normal((count, count))[row, column]
    cloud = 1 + 0.025 * noise(rng, n, scale=(10, 10), rough=1.0)
    glaze = np.array(colours)[(row + column) % len(colours)] * (tone * cloud)[..., None]
    dirt = np.array(grout) * (1 + 0.06 * noise(rng, n, scale=(80, 80), rough=0.5))[..., None]
    albedo = glaze * body[..., None] + dirt * (1 - body[..., None])
    return np.clip(albedo, 0, 1), 1.2e-3 * _step(inset, 0.006, 0.035) + 1e-5 * noise(rng, n, scale=(8, 8))


def plaster(rng: Rng, n: int, *, colour: Colour, grain: float, stains: float) -> tuple[Array, Array]:
    """Trowel plaster or pour concrete: clouds, grit, and pits where `stains` is large."""
    cloud = noise(rng, n, scale=(3, 3), rough=0.9)
    grit = noise(rng, n, scale=(90, 90), rough=0.4)
    pits = _step(noise(rng, n, scale=(60, 60), rough=1.6), 2.2, 2.8) * min(1.0, 12 * stains)
    shade = 1 + stains * cloud + 0.35 * stains * grit - 0.35 * pits
    tint = np.stack([1 + 0.15 * stains * cloud, np.ones_like(cloud), 1 - 0.15 * stains * cloud], -1)
    trowel = noise(rng, n, scale=(8, 5), rough=1.2)
    return np.clip(np.array(colour) * shade[..., None] * tint, 0, 1), grain * (trowel + 0.12 * grit) - 8e-4 * pits


def brushed(rng: Rng, n: int, *, colour: Colour) -> tuple[Array, Array]:
    """Brush metal along the columns."""
    lines = noise(rng, n, scale=(300, 0.8), rough=0.2) + 0.5 * noise(rng, n, scale=(40, 0.6), rough=0.5)
    return np.clip(np.array(colour) * (1 + 0.035 * lines)[..., None], 0, 1), 4e-6 * lines


def speckled(rng: Rng, n: int, *, colour: Colour, speck: Colour) -> tuple[Array, Array]:
    """Glaze a stoneware with iron specks of several sizes."""
    albedo = np.array(colour) * (1 + 0.03 * noise(rng, n, scale=(4, 4)))[..., None]
    for count, radius in ((60, 0.010), (420, 0.004), (1500, 0.0018)):
        near, _, index = _cells(rng, n, count)
        size = radius * rng.uniform(0.3, 1.0, count)[index]
        dot = (1 - _step(near / size, 0.7, 1.15)) * rng.uniform(0.4, 0.95, count)[index]
        albedo += dot[..., None] * (np.array(speck) - albedo)
    return np.clip(albedo, 0, 1), 6e-6 * noise(rng, n, scale=(6, 6))


@dataclass(frozen=True)
class Recipe:
    """How to make a texture: its category, the metres that one repeat covers, and the function."""

    category: str
    metres: float
    make: Callable[[Rng, int], tuple[Array, Array]]


_OAK = ((0.50, 0.35, 0.21), (0.66, 0.50, 0.33), (0.76, 0.62, 0.45))
_WALNUT = ((0.19, 0.11, 0.07), (0.36, 0.24, 0.16), (0.50, 0.36, 0.25))
_PINE = ((0.72, 0.54, 0.34), (0.85, 0.70, 0.49), (0.92, 0.81, 0.62))
_CHERRY = ((0.38, 0.17, 0.10), (0.57, 0.30, 0.18), (0.69, 0.42, 0.27))
_ASH = ((0.55, 0.50, 0.44), (0.70, 0.66, 0.60), (0.80, 0.77, 0.72))
_CHIPS = ((0.35, 0.33, 0.31), (0.72, 0.60, 0.48), (0.90, 0.88, 0.84), (0.55, 0.36, 0.28), (0.18, 0.18, 0.19))

TEXTURES: dict[str, Recipe] = {
    "wood-oak": Recipe("wood", 0.8, partial(wood, colours=_OAK, rings=16)),
    "wood-walnut": Recipe("wood", 0.8, partial(wood, colours=_WALNUT, rings=14)),
    "wood-pine": Recipe("wood", 0.8, partial(wood, colours=_PINE, rings=10)),
    "wood-cherry": Recipe("wood", 0.8, partial(wood, colours=_CHERRY, rings=18)),
    "wood-ash": Recipe("wood", 0.8, partial(wood, colours=_ASH, rings=15)),
    "planks-oak": Recipe("wood", 1.0, partial(planks, colours=_OAK, rows=8)),
    "planks-dark": Recipe("wood", 1.0, partial(planks, colours=_WALNUT, rows=7)),
    "planks-pine": Recipe("wood", 1.2, partial(planks, colours=_PINE, rows=9)),
    "marble-white": Recipe(
        "stone", 0.9, partial(marble, colours=((0.82, 0.82, 0.82), (0.93, 0.92, 0.91)), vein=(0.42, 0.42, 0.44))
    ),
    "marble-dark": Recipe(
        "stone", 0.9, partial(marble, colours=((0.05, 0.05, 0.055), (0.14, 0.13, 0.13)), vein=(0.78, 0.74, 0.68))
    ),
    "marble-green": Recipe(
        "stone", 0.9, partial(marble, colours=((0.10, 0.20, 0.16), (0.22, 0.34, 0.27)), vein=(0.70, 0.76, 0.68))
    ),
    "terrazzo-light": Recipe("stone", 0.6, partial(terrazzo, base=(0.86, 0.84, 0.80), chips=_CHIPS)),
    "terrazzo-dark": Recipe("stone", 0.6, partial(terrazzo, base=(0.22, 0.22, 0.23), chips=_CHIPS)),
    "weave-linen-natural": Recipe(
        "fabric", 0.12, partial(weave, across=(0.80, 0.74, 0.63), along=(0.74, 0.68, 0.57), threads=64)
    ),
    "weave-linen-blue": Recipe(
        "fabric", 0.12, partial(weave, across=(0.28, 0.38, 0.52), along=(0.22, 0.30, 0.44), threads=64)
    ),
    "weave-basket": Recipe(
        "fabric", 0.2, partial(weave, across=(0.62, 0.48, 0.32), along=(0.52, 0.39, 0.25), threads=24)
    ),
    "tiles-white": Recipe(
        "tiles", 0.6, partial(tiles, colours=((0.90, 0.90, 0.88),), grout=(0.55, 0.54, 0.52), count=4)
    ),
    "tiles-teal": Recipe(
        "tiles", 0.5, partial(tiles, colours=((0.20, 0.43, 0.45),), grout=(0.75, 0.74, 0.70), count=5)
    ),
    "tiles-chequer": Recipe(
        "tiles", 0.8,
        partial(tiles, colours=((0.86, 0.84, 0.79), (0.16, 0.16, 0.17)), grout=(0.42, 0.41, 0.40), count=4),
    ),
    "plaster-white": Recipe("plaster", 1.5, partial(plaster, colour=(0.88, 0.87, 0.84), grain=4e-4, stains=0.012)),
    "plaster-sand": Recipe("plaster", 1.5, partial(plaster, colour=(0.78, 0.68, 0.55), grain=6e-4, stains=0.025)),
    "plaster-sage": Recipe("plaster", 1.5, partial(plaster, colour=(0.58, 0.64, 0.56), grain=4e-4, stains=0.02)),
    "concrete-grey": Recipe("concrete", 1.5, partial(plaster, colour=(0.55, 0.54, 0.52), grain=3e-4, stains=0.06)),
    "metal-brushed": Recipe("metal", 0.3, partial(brushed, colour=(0.78, 0.78, 0.79))),
    "ceramic-speckled-cream": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.86, 0.81, 0.72), speck=(0.28, 0.19, 0.13))
    ),
    "ceramic-speckled-blue": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.36, 0.49, 0.58), speck=(0.12, 0.15, 0.20))
    ),
    "ceramic-speckled-stone": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.58, 0.56, 0.53), speck=(0.20, 0.18, 0.17))
    ),
}  # fmt: skip


def make_texture(name: str, *, resolution: int = RESOLUTION) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Make a texture by name: sRGB albedo and normal map, (N, N, 3) uint8 each, the same for the same name."""
    recipe = TEXTURES[name]
    rng = np.random.Generator(np.random.PCG64(zlib.crc32(name.encode())))
    albedo, height = recipe.make(rng, resolution)
    return np.round(albedo * 255).astype(np.uint8), normal_map(height, metres=recipe.metres)


def normal_map(height: Array, *, metres: float) -> NDArray[np.uint8]:
    """Encode the normals of a periodic height field (N, M) [m], `metres` wide, as (N, M, 3) uint8, +Y up."""
    pixel = metres / height.shape[1]
    right = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / (2 * pixel)
    down = (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) / (2 * pixel)
    normals = np.stack([-right, down, np.ones_like(height)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.round((normals * 0.5 + 0.5) * 255).astype(np.uint8)


def height_from_albedo(albedo: NDArray[np.uint8], *, depth: float) -> Array:
    """Guess a height field [m] from an (N, M, 3) picture: fine brightness detail, `depth` a deviation."""
    grey = albedo[..., :3].astype(np.float64).mean(axis=-1) / 255
    detail = gaussian_filter(grey, 0.7, mode="wrap") - gaussian_filter(grey, 24, mode="wrap")
    return np.clip(detail / max(float(detail.std()), 0.02), -2.5, 2.5) * depth
