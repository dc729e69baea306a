"""Patterns of indoor surfaces as tileable fields: wood, stone, cloth, tiles, plaster, metal, glaze, leather, cork.

A pattern returns albedo (N, N, 3) in [0, 1], sRGB-encoded, and height (N, N) in metres; both wrap around at
their borders. Row 0 is the image's top.
"""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import cKDTree

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.numbers import smoothstep
from multilight.scenes.random_streams import Rng

Colour = tuple[float, float, float]


def noise(rng: Rng, n: int, *, scale: tuple[float, float], rough: float = 1.0) -> Float64:
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


def axes(n: int) -> tuple[Float64, Float64]:
    """Return the tile coordinates (v down, u right) of pixel centres in [0, 1), each (n, n)."""
    line = (np.arange(n) + 0.5) / n
    v, u = np.meshgrid(line, line, indexing="ij")
    return v, u


def warp(field: Float64, down: Float64, right: Float64) -> Float64:
    """Look a periodic field up at pixels shifted by (down, right) pixels."""
    rows, columns = np.indices(field.shape)
    return map_coordinates(field, [rows + down, columns + right], order=1, mode="grid-wrap")


def ramp(t: Float64, colours: tuple[Colour, ...]) -> Float64:
    """Map t in [0, 1] through evenly spaced colours, (..., 3)."""
    stops = np.linspace(0, 1, len(colours))
    return np.stack([np.interp(t, stops, [c[i] for c in colours]) for i in range(3)], -1)


def step(x: Float64, low: float, high: float) -> Float64:
    """Rise smoothly from 0 at `low` to 1 at `high`."""
    return smoothstep(np.clip((x - low) / (high - low), 0, 1))


def wood(rng: Rng, n: int, *, colours: tuple[Colour, ...], rings: int) -> tuple[Float64, Float64]:
    """Grow wood grain along the columns: rings bent by slow noise, fibres and pores."""
    v, _ = axes(n)
    bend = noise(rng, n, scale=(2.0, 0.7), rough=1.6)
    phase = v * rings + 0.75 * bend * rings / 6 + 0.04 * noise(rng, n, scale=(12, 2))
    saw = phase - np.floor(phase)
    late = np.where(saw < 0.82, step(saw, 0.1, 0.82), 1 - step(saw, 0.82, 1.0))
    fibre = noise(rng, n, scale=(180, 2.5), rough=0.6)
    cloud = noise(rng, n, scale=(3, 1), rough=1.2)
    pores = step(noise(rng, n, scale=(220, 9), rough=0.8), 1.6, 2.6)
    tone = np.clip(0.42 + 0.26 * (late - 0.5) + 0.085 * fibre + 0.07 * cloud, 0, 1)
    albedo = ramp(tone, colours) * (1 - 0.3 * pores[..., None])
    return albedo, 3e-5 * fibre - 1.2e-4 * pores


def planks(
    rng: Rng, n: int, *, colours: tuple[Colour, ...], rows: int, joint: float = 0.0022
) -> tuple[Float64, Float64]:
    """Lay boards of wood grain along the columns; joints between them are about `joint` of the tile wide."""
    base, fine = wood(rng, n, colours=colours, rings=5 * rows)
    albedo, height = np.empty_like(base), np.empty_like(fine)
    line = (np.arange(n) + 0.5) / n
    for row in range(rows):
        band = slice(row * n // rows, (row + 1) * n // rows)
        inside = np.minimum(line[band] * rows - row, row + 1 - line[band] * rows) / rows
        joints = np.sort((rng.random() + np.array([0.0, 0.5]) + rng.uniform(-0.08, 0.08, 2)) % 1)
        board = np.searchsorted(joints, line) % 2
        near = np.abs((line[:, None] - joints + 0.5) % 1 - 0.5).min(axis=1)
        gap = np.minimum(step(inside, 0.27 * joint, joint)[:, None], step(near, 0.27 * joint, joint)[None])
        shifts, tones = rng.integers(n, size=(2, 2)), 1 + 0.13 * rng.standard_normal(2)
        grain = [np.roll(base, tuple(s), axis=(0, 1))[band] * tone for s, tone in zip(shifts, tones, strict=True)]
        relief = [np.roll(fine, tuple(s), axis=(0, 1))[band] for s in shifts]
        albedo[band] = np.where(board[None, :, None] == 0, *grain) * (0.25 + 0.75 * gap[..., None])
        height[band] = np.where(board[None] == 0, *relief) - 8e-4 * (1 - gap)
    return np.clip(albedo, 0, 1), height


def marble(rng: Rng, n: int, *, colours: tuple[Colour, ...], vein: Colour) -> tuple[Float64, Float64]:
    """Make polished marble: clouds, a few bold veins and many thin ones."""
    pixels = n / 16
    dx, dy = (pixels * noise(rng, n, scale=(3, 3), rough=1.5) for _ in range(2))
    clouds = warp(noise(rng, n, scale=(3, 3), rough=1.0), dx, dy)
    albedo = ramp(np.clip(0.5 + 0.22 * clouds, 0, 1), colours)
    for scale, width, strength in ((1.5, 0.035, 0.75), (3.0, 0.03, 0.45), (7.0, 0.03, 0.25)):
        field = warp(noise(rng, n, scale=(scale, scale), rough=2.0), 0.7 * dy, 0.7 * dx)
        presence = step(noise(rng, n, scale=(2, 2), rough=1.5), -0.4, 1.4)
        line = np.exp(-((field / width) ** 2)) + 0.35 * np.exp(-((field / (5 * width)) ** 2))
        albedo += (strength * np.clip(line, 0, 1) * presence)[..., None] * (np.array(vein) - albedo)
    return np.clip(albedo, 0, 1), 1e-6 * clouds


def cells(rng: Rng, n: int, count: int) -> tuple[Float64, Float64, Int64]:
    """Distances to the nearest and second nearest of `count` random points on the torus, and the nearest's index."""
    tree = cKDTree(rng.random((count, 2)), boxsize=1.0)
    v, u = axes(n)
    distance, index = tree.query(np.stack([v, u], -1).reshape(-1, 2), k=2)
    return distance[:, 0].reshape(n, n), distance[:, 1].reshape(n, n), index[:, 0].reshape(n, n)


def terrazzo(rng: Rng, n: int, *, base: Colour, chips: tuple[Colour, ...]) -> tuple[Float64, Float64]:
    """Strew angular stone chips of two sizes into a ground."""
    albedo = np.array(base) * (1 + 0.02 * noise(rng, n, scale=(60, 60), rough=0.3)[..., None])
    for count, fraction in ((2600, 0.35), (420, 0.45)):
        near, second, index = cells(rng, n, count)
        kept = rng.random(count) < fraction
        shrink = rng.uniform(0.12, 0.4, count)[index]
        inside = kept[index] & ((second - near) > shrink * 0.5 / np.sqrt(count)) & (near < 0.62 / np.sqrt(count))
        colour = np.array(chips)[rng.integers(len(chips), size=count)] * rng.uniform(0.85, 1.1, (count, 1))
        edge = np.clip(gaussian_filter(inside.astype(float), 0.8, mode="wrap"), 0, 1)[..., None]
        albedo = albedo * (1 - edge) + colour[index] * edge
    return np.clip(albedo, 0, 1), np.zeros((n, n))


def weave(rng: Rng, n: int, *, across: Colour, along: Colour, threads: int) -> tuple[Float64, Float64]:
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
    weft_colour, warp_colour = np.array(across) * hue_row[..., None], np.array(along) * hue_column[..., None]
    colour = np.where((over == 0)[..., None], weft_colour, warp_colour)
    fuzz = 0.05 * noise(rng, n, scale=(threads * 3, threads * 3), rough=0.3)
    return np.clip(colour * (0.45 + 0.55 * top + fuzz)[..., None], 0, 1), 2.5e-4 * top


def tiles(rng: Rng, n: int, *, colours: tuple[Colour, ...], grout: Colour, count: int) -> tuple[Float64, Float64]:
    """Lay square glazed tiles, `count` a side; several colours alternate as a chequerboard."""
    v, u = axes(n)
    row, column = np.floor(v * count).astype(int), np.floor(u * count).astype(int)
    inset = np.minimum(np.minimum(v * count % 1, 1 - v * count % 1), np.minimum(u * count % 1, 1 - u * count % 1))
    inset = inset + 0.0015 * noise(rng, n, scale=(40, 40), rough=1.0)
    body = step(inset, 0.010, 0.018)
    tone = 1 + 0.035 * rng.standard_normal((count, count))[row, column]
    cloud = 1 + 0.025 * noise(rng, n, scale=(10, 10), rough=1.0)
    glaze = np.array(colours)[(row + column) % len(colours)] * (tone * cloud)[..., None]
    dirt = np.array(grout) * (1 + 0.06 * noise(rng, n, scale=(80, 80), rough=0.5))[..., None]
    albedo = glaze * body[..., None] + dirt * (1 - body[..., None])
    return np.clip(albedo, 0, 1), 1.2e-3 * step(inset, 0.006, 0.035) + 1e-5 * noise(rng, n, scale=(8, 8))


def plaster(rng: Rng, n: int, *, colour: Colour, grain: float, stains: float) -> tuple[Float64, Float64]:
    """Trowel plaster or pour concrete: clouds, grit, and pits where `stains` is large."""
    cloud = noise(rng, n, scale=(3, 3), rough=0.9)
    grit = noise(rng, n, scale=(90, 90), rough=0.4)
    pits = step(noise(rng, n, scale=(60, 60), rough=1.6), 2.2, 2.8) * min(1.0, 12 * stains)
    shade = 1 + stains * cloud + 0.35 * stains * grit - 0.35 * pits
    tint = np.stack([1 + 0.15 * stains * cloud, np.ones_like(cloud), 1 - 0.15 * stains * cloud], -1)
    trowel = noise(rng, n, scale=(8, 5), rough=1.2)
    return np.clip(np.array(colour) * shade[..., None] * tint, 0, 1), grain * (trowel + 0.12 * grit) - 8e-4 * pits


def brushed(rng: Rng, n: int, *, colour: Colour) -> tuple[Float64, Float64]:
    """Brush metal along the columns."""
    lines = noise(rng, n, scale=(300, 0.8), rough=0.2) + 0.5 * noise(rng, n, scale=(40, 0.6), rough=0.5)
    return np.clip(np.array(colour) * (1 + 0.035 * lines)[..., None], 0, 1), 4e-6 * lines


def speckled(rng: Rng, n: int, *, colour: Colour, speck: Colour) -> tuple[Float64, Float64]:
    """Glaze a stoneware with iron specks of several sizes."""
    albedo = np.array(colour) * (1 + 0.03 * noise(rng, n, scale=(4, 4)))[..., None]
    for count, radius in ((60, 0.010), (420, 0.004), (1500, 0.0018)):
        near, _, index = cells(rng, n, count)
        size = radius * rng.uniform(0.3, 1.0, count)[index]
        dot = (1 - step(near / size, 0.7, 1.15)) * rng.uniform(0.4, 0.95, count)[index]
        albedo += dot[..., None] * (np.array(speck) - albedo)
    return np.clip(albedo, 0, 1), 6e-6 * noise(rng, n, scale=(6, 6))


def leather(rng: Rng, n: int, *, colour: Colour) -> tuple[Float64, Float64]:
    """Grain a hide: small pebbles between creases, and worn lighter patches."""
    pebbles = np.zeros((n, n))
    for count, weight in ((900, 0.6), (3200, 0.4)):
        near, second, _ = cells(rng, n, count)
        pebbles += weight * step((second - near) * np.sqrt(count), 0.02, 0.4)
    worn = noise(rng, n, scale=(3, 3), rough=1.2)
    tone = (0.8 + 0.2 * pebbles) * (1 + 0.05 * worn)
    return np.clip(np.array(colour) * tone[..., None], 0, 1), 1.2e-4 * pebbles


def cork(rng: Rng, n: int, *, colours: tuple[Colour, ...]) -> tuple[Float64, Float64]:
    """Press granules of cork together, with dark specks."""
    near, second, index = cells(rng, n, 1400)
    tone = rng.uniform(0, 1, 1400)[index] * 0.7 + 0.15 + 0.06 * noise(rng, n, scale=(80, 80), rough=0.4)
    dark = step(noise(rng, n, scale=(90, 90), rough=0.9), 1.5, 2.2)
    seam = 1 - step((second - near) * np.sqrt(1400), 0.0, 0.12)
    albedo = ramp(np.clip(tone, 0, 1), colours) * (1 - 0.5 * dark - 0.15 * seam * (1 - dark))[..., None]
    return np.clip(albedo, 0, 1), -1.5e-4 * np.maximum(dark, 0.4 * seam)


def checked(rng: Rng, n: int, *, colours: tuple[Colour, Colour, Colour], threads: int) -> tuple[Float64, Float64]:
    """Weave a check: broad bands of two colours in both directions, a thin line of the third, over twill."""
    v, u = axes(n)
    base, height = weave(rng, n, across=(0.94, 0.94, 0.94), along=(0.86, 0.86, 0.86), threads=threads)
    albedo = np.broadcast_to(np.array(colours[0]), (n, n, 3)).copy()
    for line in (u, v):
        phase = (4 * line) % 1
        band = (step(phase, 0.08, 0.1) * (1 - step(phase, 0.48, 0.5)))[..., None]
        thin = (step(phase, 0.72, 0.73) * (1 - step(phase, 0.76, 0.77)))[..., None]
        albedo += 0.5 * band * (np.array(colours[1]) - albedo)
        albedo += 0.6 * thin * (np.array(colours[2]) - albedo)
    return np.clip(albedo * base, 0, 1), height
