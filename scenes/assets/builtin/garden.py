"""Built-in things of gardens and yards: pots, buckets, crates, stones, and furniture, in real-world sizes."""

from dataclasses import replace

import numpy as np

from multilight.scenes.assets.builtin.parts import PAINTS, Part, paint, patterned
from multilight.scenes.assets.builtin.primitives import (
    Surface,
    lathe,
    merge,
    rotation,
    rounded,
    rounded_box,
    sphere,
    tube,
)
from multilight.scenes.assets.builtin.tableware import beaker, vessel
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

_SOIL = Material(name="soil", base_color=(0.06, 0.04, 0.028), roughness=0.95)
_CLAYS: tuple[Rgb, ...] = ((0.50, 0.20, 0.10), (0.42, 0.24, 0.15), (0.55, 0.50, 0.44), (0.10, 0.10, 0.11))
_LEAVES: tuple[Rgb, ...] = ((0.06, 0.15, 0.04), (0.12, 0.22, 0.05), (0.10, 0.16, 0.10))
_STONES: tuple[Rgb, ...] = ((0.30, 0.29, 0.27), (0.45, 0.41, 0.36), (0.12, 0.12, 0.13), (0.36, 0.27, 0.22))


def timber(rng: Rng) -> Material:
    """Draw weathered, oiled or painted outdoor wood."""
    if rng.random() < 0.3:
        return paint(rng, "timber")
    return patterned("timber", pick(rng, ("wood-ash", "wood-oak", "wood-pine", "wood-cherry")), 0.6, 0.68)


def zinc(rng: Rng) -> Material:
    """Draw galvanized sheet metal, or paint on it."""
    if rng.random() < 0.35:
        return paint(rng, "enamel")
    return Material(name="zinc", base_color=(0.60, 0.61, 0.62), metallic=1.0, roughness=float(rng.uniform(0.3, 0.5)))


def _pot(r: float, h: float, wall: float) -> tuple[Surface, Surface]:
    """Make a tapered pot with a rim, and the soil in it."""
    outer = [(0, 0), (0.68 * r, 0), (0.9 * r, 0.78 * h), (r, 0.78 * h), (r, h)]
    body = lathe(vessel(rounded(outer, [0, 0.006, 0.002, 0.004, 0], steps=5), wall), segments=72)
    inner = (0.68 + 0.22 * 0.86 / 0.78) * r - wall * 1.6
    return body, lathe([(0, 0.84 * h), (inner, 0.84 * h), (inner, 0.86 * h), (0, 0.87 * h)], segments=48)


def _tuft(rng: Rng, r: float, h: float) -> Surface:
    """Grow upright, slightly bent, pointed leaves about the axis."""
    leaves = []
    for _ in range(int(rng.integers(9, 18))):
        angle, start = rng.uniform(0, 2 * np.pi), r * 0.5 * np.sqrt(rng.random())
        lean, length = rng.uniform(0.05, 0.55), h * rng.uniform(0.6, 1.0)
        t = np.linspace(0, 1, 10)
        out = start + length * lean * t**2
        path = np.stack([out * np.cos(angle), out * np.sin(angle), length * t * (1 - 0.3 * lean * t)], -1)
        leaves.append(tube(path, 0.004 + 0.02 * h, segments=10, flatten=0.25))
    return merge(leaves)


def plant_pot(rng: Rng) -> list[Part]:
    """Make a flower pot 12 to 24 cm wide, with earth, most with an upright plant."""
    r = float(rng.uniform(0.06, 0.12))
    h = r * float(rng.uniform(1.6, 2.0))
    body, soil = _pot(r, h, 0.006)
    clay = Material(name="clay", base_color=pick(rng, _CLAYS), roughness=float(rng.uniform(0.6, 0.85)))
    parts: list[Part] = [(body, clay), (soil, _SOIL)]
    if rng.random() < 0.75:
        green = Material(name="leaf", base_color=pick(rng, _LEAVES), roughness=0.45)
        parts.append((_tuft(rng, 0.8 * r, float(rng.uniform(0.8, 1.4)) * h).moved((0, 0, 0.84 * h)), green))
    return parts


def planter(rng: Rng) -> list[Part]:
    """Make a large planter 35 to 60 cm wide, with a tall tuft of leaves."""
    r = float(rng.uniform(0.18, 0.3))
    h = r * float(rng.uniform(1.4, 2.0))
    body, soil = _pot(r, h, 0.014)
    clay = Material(name="clay", base_color=pick(rng, _CLAYS), roughness=float(rng.uniform(0.5, 0.85)))
    green = Material(name="leaf", base_color=pick(rng, _LEAVES), roughness=0.45)
    leaves = merge([_tuft(rng, 0.8 * r, float(rng.uniform(0.9, 1.3)) * h) for _ in range(2)])
    return [(body, clay), (soil, _SOIL), (leaves.moved((0, 0, 0.84 * h)), green)]


def bucket(rng: Rng) -> list[Part]:
    """Make a bucket 20 to 28 cm wide with a wire handle that hangs over its side."""
    r = float(rng.uniform(0.10, 0.14))
    h = r * float(rng.uniform(1.6, 2.0))
    body = lathe(beaker(0.72 * r, r, h, bevel=0.006, wall=0.002, lip=2.0), segments=72)
    angle = np.linspace(-0.02, np.pi + 0.02, 40)
    droop = 0.32
    arc = np.stack([1.02 * r * np.cos(angle), 1.06 * r * np.sin(angle) * np.cos(droop), 0 * angle], -1)
    arc[:, 2] = h - 0.012 - 1.06 * r * np.sin(angle) * np.sin(droop)
    handle = tube(arc, 0.0025, segments=10)
    wire = Material(name="wire", base_color=(0.55, 0.55, 0.56), metallic=1.0, roughness=0.35)
    return [(body, zinc(rng)), (handle, wire)]


def watering_can(rng: Rng) -> list[Part]:
    """Make a watering can 20 to 30 cm long: a drum, a spout with a rose, a hooped handle."""
    r = float(rng.uniform(0.065, 0.09))
    h = r * float(rng.uniform(1.7, 2.2))
    outer = rounded([(0, 0), (r, 0), (r, 0.8 * h), (0.72 * r, h)], [0, 0.004, 0.02, 0])
    drum = lathe(vessel(outer, 0.002), segments=64)
    spout = tube([(0.9 * r, 0, 0.22 * h), (1.5 * r, 0, 0.55 * h), (2.2 * r, 0, 1.05 * h)], 0.011)
    rose = lathe(rounded([(0, 0), (0.012, 0), (0.026, 0.03), (0, 0.034)], 0.002), segments=32)
    rose = rose.moved((2.17 * r, 0, 1.02 * h), rotation("y", 0.86))
    angle = np.linspace(0.35, np.pi - 0.1, 24)
    hoop = np.stack([-0.55 * r - 0.85 * r * np.sin(angle), 0 * angle, 0.6 * h - 0.42 * h * np.cos(angle)], -1)
    return [(merge([drum, spout, rose, tube(hoop, 0.006)]), zinc(rng))]


def pebble(rng: Rng) -> list[Part]:
    """Make a stone worn by water, 6 to 20 cm long."""
    size = float(rng.uniform(0.03, 0.10))
    axes = np.array([1.0, rng.uniform(0.65, 0.9), rng.uniform(0.4, 0.65)])
    angle = np.linspace(-np.pi / 2, np.pi / 2, 33)
    round_ = size * np.stack([np.cos(angle) ** 0.85, np.sin(angle) + 1], -1)
    ball = lathe(round_, lobes=int(rng.integers(2, 4)), depth=float(rng.uniform(0.03, 0.08)))
    normals = ball.normals / axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    stone = replace(ball, vertices=ball.vertices * axes, normals=normals)
    return [(stone, Material(name="stone", base_color=pick(rng, _STONES), roughness=float(rng.uniform(0.45, 0.85))))]


def _board(x: float, y: float, z: float) -> Surface:
    return rounded_box((x, y, z), 0.1 * min(x, y, z) + 0.0005)


def crate(rng: Rng) -> list[Part]:
    """Make a slatted fruit crate 26 to 40 cm long, open at the top."""
    x = float(rng.uniform(0.26, 0.40))
    y, z, t = 0.68 * x, float(rng.uniform(0.12, 0.2)), 0.007
    pieces = [_board(x, y - 2 * t, t).moved((0, 0, 0.004))]
    pieces += _board(0.022, 0.022, z).at_corners(x / 2 - 0.012, y / 2 - t - 0.012)
    slats = 3
    height = z / slats - 0.012
    for i in range(slats):
        level = i * z / slats + 0.004
        for sign in (-1, 1):
            pieces.append(_board(x, t, height).moved((0, sign * (y / 2 - t / 2), level)))
            pieces.append(_board(t, y - 2 * t, height).moved((sign * (x / 2 - t / 2), 0, level)))
    return [(merge(pieces), timber(rng))]


def bench(rng: Rng) -> list[Part]:
    """Make a garden bench without a back, 0.9 to 1.4 m long."""
    x, y, h = float(rng.uniform(0.9, 1.4)), float(rng.uniform(0.34, 0.42)), float(rng.uniform(0.42, 0.47))
    slats = [_board(x, y / 4 - 0.008, 0.026).moved((0, (i - 1.5) * y / 4, h - 0.026)) for i in range(4)]
    legs = _board(0.06, 0.06, h - 0.026).at_corners(x / 2 - 0.12, y / 2 - 0.05)
    rails = [_board(0.03, y - 0.16, 0.05).moved((sx * (x / 2 - 0.12), 0, h - 0.1)) for sx in (-1, 1)]
    wood = timber(rng)
    return [(merge(slats), wood), (merge(legs + rails), wood)]


def garden_chair(rng: Rng) -> list[Part]:
    """Make a slatted garden chair, 0.78 to 0.9 m high."""
    w, d, seat, h = 0.44, 0.42, 0.44, float(rng.uniform(0.78, 0.9))
    slats = [_board(w - 0.01, d / 6 - 0.01, 0.018).moved((0, (i - 2.5) * d / 6, seat - 0.018)) for i in range(6)]
    rest = _board(w - 0.06, 0.016, 0.05)
    back = [rest.moved((0, d / 2 + 0.02 * i, seat + 0.1 + i * (h - seat - 0.16) / 3)) for i in range(4)]
    legs = [_board(0.03, 0.03, seat - 0.018).moved((sx * (w / 2 - 0.02), -d / 2 + 0.03, 0)) for sx in (-1, 1)]
    lean = rotation("x", -0.12)
    for sx in (-1, 1):
        legs.append(_board(0.03, 0.03, seat - 0.018).moved((sx * (w / 2 - 0.02), d / 2 - 0.03, 0)))
        legs.append(_board(0.03, 0.026, h - seat + 0.02).moved((sx * (w / 2 - 0.02), d / 2 - 0.005, seat - 0.02), lean))
    rails = [_board(w - 0.06, 0.02, 0.045).moved((0, sy * (d / 2 - 0.03), seat - 0.07)) for sy in (-1, 1)]
    frame = timber(rng)
    return [(merge(slats + back), frame), (merge(legs + rails), frame)]


def beach_ball(rng: Rng) -> list[Part]:
    """Make a large plain ball, 20 to 32 cm wide."""
    rubber = Material(name="rubber", base_color=pick(rng, PAINTS), roughness=float(rng.uniform(0.3, 0.6)))
    return [(sphere(float(rng.uniform(0.10, 0.16)), segments=64), rubber)]
