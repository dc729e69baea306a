"""Built-in tables; part 0 is the top, its uv in metres."""

import numpy as np

from multilight.scenes.assets.builtin.parts import Part, metal, paint, patterned
from multilight.scenes.assets.builtin.primitives import (
    Surface,
    cylinder,
    lathe,
    merge,
    rotation,
    rounded,
    rounded_box,
    tube,
)
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material

TOPS = (
    ("wood-oak", 0.8, 0.45, 0.25),
    ("wood-walnut", 0.8, 0.4, 0.3),
    ("planks-oak", 1.0, 0.5, 0.2),
    ("planks-dark", 1.0, 0.45, 0.25),
    ("marble-white", 0.9, 0.15, 0.6),
    ("marble-dark", 0.9, 0.15, 0.6),
    ("terrazzo-light", 0.6, 0.3, 0.3),
    ("wood-pine", 0.8, 0.55, 0.0),
)


def top_material(rng: Rng) -> Material:
    """Draw what a table top is made of."""
    name, size, roughness, coat = pick(rng, TOPS)
    return patterned("top", name, size, roughness, coat=coat)


def leg_material(rng: Rng) -> Material:
    """Draw what the legs are made of."""
    timber = patterned("legs", pick(rng, ("wood-oak", "wood-walnut", "wood-pine")), 0.5, 0.5, coat=0.2)
    other = pick(rng, (metal(rng), paint(rng))).model_copy(update={"name": "legs"})
    return timber if rng.random() < 0.6 else other


def _beam(start: tuple[float, float, float], end: tuple[float, float, float], section: float) -> Surface:
    """Run a square bar between two points [m]."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length
    x = np.cross([0.0, 1.0, 0.0], z) if abs(z[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    x /= np.linalg.norm(x)
    return rounded_box((section, section, length), 0.004).moved(a, np.stack([x, np.cross(z, x), z], -1))


def table_round(rng: Rng) -> list[Part]:
    """Make a round table on one turned pedestal, 0.8 to 1.2 m wide."""
    r, h, t = float(rng.uniform(0.40, 0.6)), float(rng.uniform(0.70, 0.76)), float(rng.uniform(0.02, 0.035))
    edge = float(rng.uniform(0.2, 0.48)) * t
    top = cylinder(r, t, edge, segments=128, planar_uv=True).moved((0, 0, h - t))
    foot = r * 0.6
    stem = [(0, 0), (foot, 0), (foot, 0.02), (0.06, 0.06), (0.045, 0.3 * h), (0.055, 0.7 * h)]
    stem += [(0.05, h - t - 0.06), (0.16, h - t - 0.012), (0.16, h - t), (0, h - t)]
    profile = rounded(stem, [0, 0.008, 0.008, 0.08, 0.2, 0.2, 0.05, 0.01, 0.001, 0])
    return [(top, top_material(rng)), (lathe(profile), leg_material(rng))]


def _with_legs(rng: Rng, x: float, y: float, h: float, *, section: float, t: float) -> list[Part]:
    top = rounded_box((x, y, t), float(rng.uniform(0.1, 0.45)) * t).moved((0, 0, h - t))
    apron = 0.07 if h > 0.6 else 0.04
    leg = rounded_box((section, section, h - t), 0.005)
    frame = leg.at_corners(x / 2 - section / 2 - 0.02, y / 2 - section / 2 - 0.02)
    for sign in (-1, 1):
        long = rounded_box((x - 0.04 - 2 * section, 0.02, apron), 0.003)
        short = rounded_box((0.02, y - 0.04 - 2 * section, apron), 0.003)
        frame.append(long.moved((0, sign * (y / 2 - 0.02 - section / 2), h - t - apron)))
        frame.append(short.moved((sign * (x / 2 - 0.02 - section / 2), 0, h - t - apron)))
    return [(top, top_material(rng)), (merge(frame), leg_material(rng))]


def table_rectangular(rng: Rng) -> list[Part]:
    """Make a dining table on four legs, 1.1 to 1.6 m long."""
    x, y, h = (float(v) for v in rng.uniform((1.1, 0.7, 0.70), (1.6, 0.9, 0.77)))
    return _with_legs(rng, x, y, h, section=float(rng.uniform(0.045, 0.075)), t=float(rng.uniform(0.022, 0.04)))


def table_coffee(rng: Rng) -> list[Part]:
    """Make a low table on four legs, 0.8 to 1.2 m long."""
    x, y, h = (float(v) for v in rng.uniform((0.8, 0.5, 0.36), (1.2, 0.7, 0.46)))
    return _with_legs(rng, x, y, h, section=float(rng.uniform(0.035, 0.055)), t=float(rng.uniform(0.02, 0.035)))


def table_trestle(rng: Rng) -> list[Part]:
    """Make a board on two trestles, 1.2 to 1.6 m long."""
    x, y, h = (float(v) for v in rng.uniform((1.2, 0.65, 0.70), (1.6, 0.8, 0.76)))
    t, section = 0.028, 0.035
    top = rounded_box((x, y, t), 0.004).moved((0, 0, h - t))
    frame = []
    for sx in (-1, 1):
        centre = sx * (x / 2 - 0.25)
        frame.append(rounded_box((0.06, y - 0.06, 0.05), 0.004).moved((centre, 0, h - t - 0.05)))
        for sy in (-1, 1):
            for lean in (-1, 1):
                foot = (centre + lean * 0.17, sy * (y / 2 - 0.06), 0.004)
                frame.append(_beam(foot, (centre + lean * 0.02, sy * (y / 2 - 0.09), h - t - 0.03), section))
    return [(top, top_material(rng)), (merge(frame), leg_material(rng))]


def table_workbench(rng: Rng) -> list[Part]:
    """Make a heavy workbench with a shelf, 1.2 to 1.6 m long, 0.85 to 0.92 m high."""
    x, y, h = (float(v) for v in rng.uniform((1.2, 0.6, 0.85), (1.6, 0.75, 0.92)))
    parts = _with_legs(rng, x, y, h, section=0.09, t=0.06)
    shelf = rounded_box((x - 0.1, y - 0.1, 0.022), 0.003).moved((0, 0, 0.18))
    return [parts[0], (merge([parts[1][0], shelf]), parts[1][1])]


def table_bistro(rng: Rng) -> list[Part]:
    """Make a small round table on three bent steel legs, 0.8 to 1.0 m wide."""
    r, h, t = float(rng.uniform(0.40, 0.5)), float(rng.uniform(0.70, 0.75)), 0.02
    top = cylinder(r, t, 0.006, segments=128, planar_uv=True).moved((0, 0, h - t))
    bend = rounded([(0.8 * r, 0.012), (0.1 * r, 0.5 * h), (0.7 * r, h - t - 0.008)], 0.35, steps=24)
    leg = tube(np.insert(bend, 1, 0.0, axis=1), 0.011)
    legs = [leg.moved(rotation=rotation("z", angle)) for angle in (0, 2 * np.pi / 3, 4 * np.pi / 3)]
    steel = metal(rng).model_copy(update={"name": "legs"})
    return [(top, top_material(rng)), (merge(legs), steel)]
