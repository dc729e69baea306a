"""Built-in objects: books, boxes and toys, made by formula, in real-world sizes."""

import numpy as np

from multilight.scenes.assets.builtin.parts import PAINTS, PAPER, Part, ceramic, metal, paint, patterned, tiled
from multilight.scenes.assets.builtin.primitives import (
    circle,
    lathe,
    merge,
    prism,
    rotation,
    rounded,
    rounded_box,
    torus,
)
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material


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
    rough = float(rng.uniform(0.35, 0.8))
    binding = Material(name="cover", base_color=tint, base_color_texture=texture, roughness=rough)
    return [(merge(cover), binding), (block, PAPER)]


def box(rng: Rng) -> list[Part]:
    """Make a wooden, painted or metal box with rounded edges."""
    size = rng.uniform((0.06, 0.06, 0.03), (0.20, 0.14, 0.12))
    timber = patterned("wood", pick(rng, ("wood-oak", "wood-walnut", "wood-cherry")), 0.4, 0.45, coat=0.3)
    materials = (timber, paint(rng), metal(rng))
    return [(rounded_box(size, float(rng.uniform(0.002, 0.012))), pick(rng, materials))]


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
        surface = prism(rounded(circle(sides, 0.6 * edge), 0.003, closed=True, steps=4), edge, 0.0015)
    return [(surface, paint(rng))]


PIPS = {1: [4], 2: [0, 8], 3: [0, 4, 8], 4: [0, 2, 6, 8], 5: [0, 2, 4, 6, 8], 6: [0, 2, 3, 5, 6, 8]}


def die(rng: Rng) -> list[Part]:
    """Make a die 16 to 40 mm wide; opposite faces add up to seven."""
    edge = float(rng.uniform(0.016, 0.04))
    pip = lathe(rounded([(0, -0.02), (0.09, -0.02), (0.085, 0.004), (0, 0.006)], [0, 0, 0.01, 0]) * edge, segments=24)
    sides = [
        (1, np.eye(3)),
        (6, rotation("x", np.pi)),
        (2, rotation("x", np.pi / 2)),
        (5, rotation("x", -np.pi / 2)),
        (3, rotation("y", np.pi / 2)),
        (4, rotation("y", -np.pi / 2)),
    ]
    spots = []
    for value, upwards in sides:
        for place in PIPS[value]:
            offset = np.array([0.26 * (place % 3 - 1), 0.26 * (place // 3 - 1), 0.5]) * edge
            spots.append(pip.moved(offset).moved((0, 0, edge / 2), upwards))
    dark = rng.random() < 0.4
    colour = pick(rng, PAINTS[:4]) if dark else (0.8, 0.79, 0.75)
    body = Material(name="body", base_color=colour, roughness=0.25, coat=0.5)
    ink = Material(name="pips", base_color=(0.85, 0.85, 0.82) if dark else (0.02, 0.02, 0.02), roughness=0.4)
    return [(rounded_box((edge, edge, edge), 0.16 * edge, steps=6), body), (merge(spots), ink)]


def coins(rng: Rng) -> list[Part]:
    """Make a stack of coins, each a little off."""
    radius, thickness = float(rng.uniform(0.010, 0.016)), 0.0022
    rim = [(0, 0.0003), (0.86, 0.0003), (0.88, 0), (1, 0), (1, 0.0022), (0.88, 0.0022), (0.86, 0.0019), (0, 0.0019)]
    profile = rounded([(r * radius, z) for r, z in rim], [0, 0.0002, 0.0002, 0.0005, 0.0005, 0.0002, 0.0002, 0])
    one = lathe(profile, segments=32, planar_uv=True)
    stack = [one.moved((*rng.normal(0, 0.0006, 2), i * thickness)) for i in range(int(rng.integers(3, 12)))]
    return [(merge(stack), metal(rng))]


def ring(rng: Rng) -> list[Part]:
    """Make a lying ring, 4 to 14 cm wide."""
    major = float(rng.uniform(0.02, 0.06))
    makers = (metal, paint, ceramic)
    return [(torus(major, major * float(rng.uniform(0.15, 0.35)), segments=96), pick(rng, makers)(rng))]
