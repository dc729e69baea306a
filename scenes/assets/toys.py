"""Built-in objects: books, toys and things that glow, made by formula, in real-world sizes."""

from itertools import pairwise

import numpy as np

from scenes.assets.tableware import METALS, PAINTS, Part, Rng, ceramic, metal, paint, pick, tiled
from scenes.primitives import lathe, merge, prism, rotation, rounded, rounded_box, sphere, torus, tube
from scenes.spec import Material

PAPER = Material(name="paper", base_color=(0.78, 0.72, 0.60), roughness=0.9)
GLOW = Material(name="glow", base_color=(0.92, 0.90, 0.86), roughness=0.4)


def book(rng: Rng) -> list[Part]:
    """Make a bound book lying flat."""
    x, y, z = (float(v) for v in rng.uniform((0.12, 0.17, 0.012), (0.18, 0.25, 0.045)))
    board = 0.0025
    cover = [
        rounded_box((x, y, board), 0.001),
        rounded_box((x, y, board), 0.001).moved((0, 0, z - board)),
        rounded_box((board, y, z), 0.0012).moved((-x / 2 + board / 2 - 0.0004, 0, 0)),
    ]
    block = rounded_box((x - 0.006, y - 0.008, z - 2 * board + 0.0004), 0.0006).moved((-0.001, 0, board - 0.0002))
    base = pick(rng, PAINTS)
    texture = tiled("weave-linen-natural", 0.12) if rng.random() < 0.5 else None
    tint = (0.25 + 0.75 * base[0], 0.25 + 0.75 * base[1], 0.25 + 0.75 * base[2]) if texture else base
    binding = Material(
        name="cover", base_color=tint, base_color_texture=texture, roughness=float(rng.uniform(0.35, 0.8))
    )
    return [(merge(cover), binding), (block, PAPER)]


def box(rng: Rng) -> list[Part]:
    """Make a wooden, painted or metal box with rounded edges."""
    size = rng.uniform((0.06, 0.06, 0.03), (0.20, 0.14, 0.12))
    wood = ("wood-oak", "wood-walnut", "wood-cherry")[int(rng.integers(3))]
    materials = (
        Material(name="wood", base_color=(1, 1, 1), base_color_texture=tiled(wood, 0.4), roughness=0.45, coat=0.3),
        paint(rng),
        metal(rng),
    )
    return [(rounded_box(size, float(rng.uniform(0.002, 0.012))), materials[int(rng.integers(3))])]


def block(rng: Rng) -> list[Part]:
    """Make a toy block: a cube, a triangle, a hexagon, a cylinder or a bar."""
    edge = float(rng.uniform(0.03, 0.05))
    kind = int(rng.integers(5))
    if kind == 0:
        surface = rounded_box((edge, edge, edge), 0.002)
    elif kind == 4:
        surface = rounded_box((2.5 * edge, edge, edge), 0.002)
    else:
        sides = {1: 3, 2: 6, 3: 48}[kind]
        angle = 2 * np.pi * np.arange(sides) / sides
        outline = 0.6 * edge * np.stack([np.cos(angle), np.sin(angle)], -1)
        surface = prism(rounded(outline, 0.003, closed=True, steps=4), edge, 0.0015)
    return [(surface, paint(rng))]


PIPS = {1: [4], 2: [0, 8], 3: [0, 4, 8], 4: [0, 2, 6, 8], 5: [0, 2, 4, 6, 8], 6: [0, 2, 3, 5, 6, 8]}


def die(rng: Rng) -> list[Part]:
    """Make a die 16 to 40 mm wide; opposite faces add up to seven."""
    edge = float(rng.uniform(0.016, 0.04))
    pip = lathe(rounded([(0, -0.02), (0.09, -0.02), (0.085, 0.004), (0, 0.006)], [0, 0, 0.01, 0]) * edge, segments=24)
    turns = [
        (1, np.eye(3)),
        (6, rotation("x", np.pi)),
        (2, rotation("x", np.pi / 2)),
        (5, rotation("x", -np.pi / 2)),
        (3, rotation("y", np.pi / 2)),
        (4, rotation("y", -np.pi / 2)),
    ]
    spots = []
    for value, turn in turns:
        for place in PIPS[value]:
            offset = np.array([0.26 * (place % 3 - 1), 0.26 * (place // 3 - 1), 0.5]) * edge
            spots.append(pip.moved(offset).moved((0, 0, edge / 2), turn))
    dark = rng.random() < 0.4
    colour = pick(rng, PAINTS[:4]) if dark else (0.8, 0.79, 0.75)
    body = Material(name="body", base_color=colour, roughness=0.25, coat=0.5)
    ink = Material(name="pips", base_color=(0.85, 0.85, 0.82) if dark else (0.02, 0.02, 0.02), roughness=0.4)
    return [(rounded_box((edge, edge, edge), 0.16 * edge, steps=6), body), (merge(spots), ink)]


def coins(rng: Rng) -> list[Part]:
    """Make a stack of coins, each a little off."""
    radius, thickness = float(rng.uniform(0.010, 0.016)), 0.0022
    rim = [
        (0, 0.0003),
        (0.86, 0.0003),
        (0.88, 0),
        (1, 0),
        (1, 0.0022),
        (0.88, 0.0022),
        (0.86, 0.0019),
        (0, 0.0019),
    ]
    profile = rounded([(r * radius, z) for r, z in rim], [0, 0.0002, 0.0002, 0.0005, 0.0005, 0.0002, 0.0002, 0])
    one = lathe(profile, segments=32, planar_uv=True)
    stack = [one.moved((*rng.normal(0, 0.0006, 2), i * thickness)) for i in range(int(rng.integers(3, 12)))]
    return [(merge(stack), metal(rng))]


def ring(rng: Rng) -> list[Part]:
    """Make a lying ring, 4 to 14 cm wide."""
    major = float(rng.uniform(0.02, 0.06))
    makers = (metal, paint, ceramic)
    return [(torus(major, major * float(rng.uniform(0.15, 0.35)), segments=96), makers[int(rng.integers(3))](rng))]


def candle(rng: Rng) -> list[Part]:
    """Make a candle with a wick and a flame; the part `flame` may glow."""
    r, h = float(rng.uniform(0.02, 0.038)), float(rng.uniform(0.05, 0.16))
    corners = [(0, 0), (r, 0), (r, h), (r - 0.004, h), (0.5 * r, h - 0.005), (0, h - 0.006)]
    body = lathe(rounded(corners, [0, 0.002, 0.002, 0.002, 0.008, 0]))
    wick = tube([(0, 0, h - 0.008), (0, 0, h), (0.0012, 0, h + 0.006)], 0.0008, segments=10)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 25)
    narrow = np.where(angle > 0, np.cos(angle) ** 1.7, np.cos(angle))
    drop = np.stack([0.0055 * narrow, 0.009 + np.where(angle > 0, 0.019, 0.009) * np.sin(angle)], -1)
    flame = lathe(drop, segments=32).moved((0.0006, 0, h + 0.001))
    waxes = ((0.85, 0.80, 0.68), (0.55, 0.06, 0.05), (0.20, 0.30, 0.25), (0.80, 0.62, 0.40))
    wax = Material(name="wax", base_color=pick(rng, waxes), roughness=0.45)
    black = Material(name="wick", base_color=(0.02, 0.02, 0.02), roughness=0.9)
    glow = GLOW.model_copy(update={"name": "flame", "base_color": (0.95, 0.75, 0.4)})
    return [(body, wax), (wick, black), (flame, glow)]


def bulb(rng: Rng) -> list[Part]:
    """Make a frosted light bulb standing on its screw; the part `glow` may shine."""
    r = float(rng.uniform(0.026, 0.034))
    neck = 0.0135
    angle = np.linspace(-0.75, np.pi / 2, 28)
    globe = np.stack([r * np.cos(angle), 0.055 + r + r * np.sin(angle)], -1)
    shade = lathe(np.concatenate([[(0, 0.026), (neck, 0.026), (neck, 0.031), (neck * 1.25, 0.042)], globe]))
    thread = [(0.0128 + 0.0011 * (i % 2), 0.0075 + 0.0022 * i) for i in range(9)]
    profile = [
        (0, 0.0),
        (0.005, 0.0),
        (0.0065, 0.003),
        (0.0125, 0.006),
        *thread,
        (0.014, 0.0265),
        (0.014, 0.029),
    ]
    brass = Material(name="screw", base_color=METALS[int(rng.integers(4))], metallic=1.0, roughness=0.3)
    return [(shade, GLOW), (lathe(rounded(profile, 0.0006, steps=3)), brass)]


def orb(rng: Rng) -> list[Part]:
    """Make a glowing globe on a turned foot, 10 to 22 cm high; the part `glow` may shine."""
    r = float(rng.uniform(0.04, 0.085))
    foot = [(0, 0), (0.75 * r, 0), (0.75 * r, 0.012), (0.32 * r, 0.026), (0.36 * r, 0.04), (0, 0.04)]
    base = lathe(rounded(foot, [0, 0.003, 0.004, 0.02, 0.003, 0]))
    globe = sphere(r, segments=64).moved((0, 0, 0.036 - 0.06 * r))
    wood = Material(name="foot", base_color=(1, 1, 1), base_color_texture=tiled("wood-walnut", 0.3), roughness=0.4)
    return [(globe, GLOW), (base, wood if rng.random() < 0.5 else metal(rng))]


def neon(rng: Rng) -> list[Part]:
    """Make a standing neon sign, a bent tube on a base: a heart, a bolt, a wave or a ring; `glow` may shine."""
    size, kind = float(rng.uniform(0.10, 0.2)), int(rng.integers(4))
    t = np.linspace(0.02, 2 * np.pi - 0.02, 120)
    if kind == 0:
        x = np.sin(t) ** 3
        z = (13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)) / 17
        flat = np.stack([x, z], -1)
    elif kind == 1:
        bolt = [(0.35, 1), (-0.35, 0.05), (0.15, 0.05), (-0.35, -1)]
        flat = rounded(bolt, 0.12, steps=8)
        flat = np.concatenate([np.linspace(a, b, 6)[:-1] for a, b in pairwise(flat)] + [flat[-1:]])
    elif kind == 2:
        flat = np.stack([np.linspace(-1, 1, 120), 0.45 * np.sin(1.5 * t)], -1)
    else:
        flat = np.stack([np.sin(t), np.cos(t)], -1)
    path = np.stack([flat[:, 0], 0 * flat[:, 0], flat[:, 1] - flat[:, 1].min()], -1) * size / 2
    tube_radius = 0.0045
    sign = tube(path + np.array([0, 0, 0.028 + tube_radius]), tube_radius)
    lowest = path[np.argmin(path[:, 2]), 0]
    post = tube([(lowest, 0, 0.01), (lowest, 0, 0.029)], 0.003, segments=12)
    base = rounded_box((size * 0.75, 0.05, 0.016), 0.004)
    stand = Material(name="stand", base_color=(0.03, 0.03, 0.03), roughness=0.35, coat=0.3)
    return [(sign, GLOW), (merge([base, post]), stand)]
