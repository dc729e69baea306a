"""Built-in objects that glow: neon signs, screens and dot-matrix signs; the part `glow` or `screen` may shine."""

from itertools import pairwise

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.lamps import GLOW
from multilight.scenes.assets.builtin.parts import Part, metal
from multilight.scenes.assets.builtin.primitives import Surface, from_grid, merge, rotation, rounded, rounded_box, tube
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

_CASES: tuple[Rgb, ...] = ((0.02, 0.02, 0.022), (0.55, 0.56, 0.58), (0.75, 0.74, 0.72), (0.16, 0.2, 0.28))
_DISPLAY = Material(name="screen", base_color=(0.03, 0.03, 0.032), roughness=0.08, coat=0.0)
Line = list[tuple[float, float]]
_LETTERS: dict[str, list[Line]] = {
    "A": [[(0, 0), (0.4, 1), (0.8, 0)], [(0.17, 0.38), (0.63, 0.38)]],
    "B": [
        [(0, 0), (0, 1), (0.5, 0.98), (0.56, 0.76), (0.4, 0.53), (0, 0.53)],
        [(0.4, 0.5), (0.68, 0.26), (0.5, 0), (0.04, 0)],
    ],
    "E": [[(0.6, 1), (0, 1), (0, 0), (0.6, 0)], [(0.05, 0.5), (0.5, 0.5)]],
    "G": [[(0.75, 0.85), (0.4, 1), (0, 0.8), (0, 0.2), (0.4, 0), (0.75, 0.15), (0.75, 0.45), (0.45, 0.45)]],
    "H": [[(0, 0), (0, 1)], [(0.65, 0), (0.65, 1)], [(0.05, 0.5), (0.6, 0.5)]],
    "I": [[(0.05, 0), (0.05, 1)]],
    "L": [[(0, 1), (0, 0), (0.55, 0)]],
    "O": [[(0.4, 0), (0, 0.15), (0, 0.85), (0.4, 1), (0.8, 0.85), (0.8, 0.15), (0.45, 0)]],
    "R": [[(0, 0), (0, 1), (0.55, 1), (0.6, 0.7), (0.5, 0.48), (0.05, 0.48)], [(0.3, 0.44), (0.65, 0)]],
    "S": [[(0.6, 0.85), (0.35, 1), (0.03, 0.85), (0.1, 0.58), (0.5, 0.45), (0.62, 0.15), (0.3, 0), (0, 0.15)]],
    "V": [[(0, 1), (0.36, 0), (0.72, 1)]],
    "Y": [[(0, 1), (0.33, 0.48), (0.33, 0)], [(0.66, 1), (0.36, 0.54)]],
}
"""Strokes of letters one unit high, each bent from one tube."""
_WORDS = ("HI", "LOVE", "BAR", "YES", "GO", "OH")


def _shape(rng: Rng) -> list[Float64]:
    """Draw the outline of a sign, about 2 units high, as lines of (x, z): a drawing or a word."""
    t = np.linspace(0.02, 2 * np.pi - 0.02, 120)
    match int(rng.integers(9)):
        case 0:
            z = (13 * np.cos(t) - 5 * np.cos(2 * t) - 2 * np.cos(3 * t) - np.cos(4 * t)) / 17
            return [np.stack([np.sin(t) ** 3, z], -1)]
        case 1:
            return [_bent([(0.35, 1), (-0.35, 0.05), (0.15, 0.05), (-0.35, -1)], 0.12)]
        case 2:
            return [np.stack([np.linspace(-1, 1, 120), 0.45 * np.sin(1.5 * t)], -1)]
        case 3:
            return [np.stack([np.sin(t), np.cos(t)], -1)]
        case 4:
            angle = np.pi / 2 + np.pi / 5 * np.arange(11)
            radius = np.where(np.arange(11) % 2 == 0, 1.0, 0.45)
            star = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1)
            star[-1] += (0.04, -0.04)
            return [_bent(star, 0.06)]
        case 5:
            out, back = np.linspace(0.75, 2 * np.pi - 0.75, 80), np.linspace(2 * np.pi - 1.25, 1.25, 60)
            moon = np.stack([np.cos(out), np.sin(out)], -1)
            return [np.concatenate([moon, np.stack([0.42 + 0.72 * np.cos(back), 0.72 * np.sin(back)], -1)])]
    lines, left = [], 0.0
    for letter in pick(rng, _WORDS):
        strokes = [2 * np.array(line) + (left, -1.0) for line in _LETTERS[letter]]
        lines += [_bent(stroke, 0.16) for stroke in strokes]
        left = max(float(stroke[:, 0].max()) for stroke in strokes) + 0.5
    return lines


def _bent(corners: Float64 | Line, radius: float) -> Float64:
    """Bend a tube's line round its corners, with points close together."""
    flat = rounded(corners, radius, steps=8)
    return np.concatenate([np.linspace(a, b, 6)[:-1] for a, b in pairwise(flat)] + [flat[-1:]])


def neon(rng: Rng) -> list[Part]:
    """Make a standing neon sign 10 to 20 cm high: tubes bent to a drawing or a word before a board."""
    lines = _shape(rng)
    points = np.concatenate(lines)
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    scale = min(float(rng.uniform(0.10, 0.2)) / span[1], 0.36 / span[0])
    width, height = span * scale
    radius = float(rng.uniform(0.0032, 0.0048))
    tubes, clips = [], []
    for line in lines:
        flat = (line - low - (span[0] / 2, 0)) * scale
        path = np.stack([flat[:, 0], np.full(len(flat), -0.012), flat[:, 1] + 0.035], -1)
        tubes.append(tube(path, radius, segments=14))
        for point in (path[len(path) // 8], path[-len(path) // 8]):
            clips.append(tube([point + (0, radius, 0), (point[0], 0.0005, point[2])], 0.0016, segments=8))
    board = rounded_box((width + 0.04, 0.005, height + 0.055), 0.002).moved((0, 0.003, 0.012))
    base = rounded_box((min(width + 0.05, 0.4), 0.09, 0.014), 0.004)
    stand = Material(name="stand", base_color=pick(rng, _CASES[:2]), roughness=0.35, coat=0.3)
    return [(merge(tubes), GLOW), (merge([board, base, *clips]), stand)]


def _display(width: float, height: float) -> Surface:
    """Make an upright display about the origin that faces -Y; uv from 0 to 1 across and up, as pictures lie."""
    x, z = np.array([-width / 2, width / 2]), np.array([-height / 2, height / 2])
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, z), -1)
    normals = np.broadcast_to(np.array([0.0, -1.0, 0.0]), points.shape).copy()
    uv = np.stack(np.broadcast_arrays(np.array([0.0, 1.0])[:, None], np.array([0.0, 1.0])), -1)
    return from_grid(points, normals, uv)


def _slab(rng: Rng, width: float, height: float, depth: float, bezel: float) -> tuple[Surface, Surface, Material]:
    """Make an upright device about the origin, its display 0.3 mm before its face at -Y; and its case's material."""
    body = rounded_box((width, depth, height), min(0.45 * depth, 0.008)).moved((0, 0, -height / 2))
    screen = _display(width - 2 * bezel, height - 2 * bezel).moved((0, -depth / 2 - 0.0003, 0))
    shiny = rng.random() < 0.5
    case = Material(name="case", base_color=pick(rng, _CASES), roughness=0.3 if shiny else 0.5, metallic=0.0)
    return body, screen, case


def phone(rng: Rng) -> list[Part]:
    """Make a phone 14 to 16 cm long: flat on its back, or leaning in a cradle; the part `screen` may shine."""
    height = float(rng.uniform(0.142, 0.162))
    width, depth = height * 6 / 13, float(rng.uniform(0.0074, 0.009))
    body, screen, case = _slab(rng, width, height, depth, 0.0022)
    if rng.random() < 0.35:
        flat = rotation("x", -np.pi / 2)
        return [(screen.moved(rotation=flat), _DISPLAY), (body.moved(rotation=flat), case)]
    lean = rotation("x", -float(rng.uniform(0.25, 0.5)))
    lift = (0.0, 0.0, height / 2 + 0.012)
    plate = rounded_box((0.07, 0.085, 0.008), 0.003).moved((0, 0.012, 0))
    prop = rounded_box((0.06, 0.006, 0.6 * height), 0.002).moved((0, depth / 2 + 0.0045, -0.42 * height))
    lip = rounded_box((0.05, 0.018, 0.004), 0.0015).moved((0, -0.002, -height / 2 - 0.0045))
    cradle = merge([plate, prop.moved(lift, lean), lip.moved(lift, lean)])
    return [(screen.moved(lift, lean), _DISPLAY), (body.moved(lift, lean), case), (cradle, metal(rng))]


def tablet(rng: Rng) -> list[Part]:
    """Make a tablet 21 to 28 cm wide that leans on a foot; the part `screen` may shine."""
    width = float(rng.uniform(0.21, 0.28))
    height, depth = width * 5 / 8, 0.0075
    body, screen, case = _slab(rng, width, height, depth, 0.007)
    lean, lift = rotation("x", -float(rng.uniform(0.2, 0.45))), (0.0, 0.0, height / 2 + 0.006)
    plate = rounded_box((0.5 * width, 0.11, 0.005), 0.002).moved((0, 0.035, 0))
    prop = rounded_box((0.45 * width, 0.004, 0.75 * height), 0.0015).moved((0, depth / 2 + 0.003, -0.5 * height))
    foot = merge([plate, prop.moved(lift, lean)])
    return [(screen.moved(lift, lean), _DISPLAY), (body.moved(lift, lean), case), (foot, case)]


def monitor(rng: Rng) -> list[Part]:
    """Make a small monitor 36 to 44 cm wide on a foot; the part `screen` may shine."""
    width = float(rng.uniform(0.36, 0.44))
    height, depth = width * 5 / 8, 0.022
    body, screen, case = _slab(rng, width, height, depth, 0.009)
    lift = (0.0, 0.0, height / 2 + 0.075)
    plate = rounded_box((0.2, 0.15, 0.008), 0.003).moved((0, 0.03, 0))
    post = rounded_box((0.05, 0.02, 0.075 + 0.4 * height), 0.004).moved((0, depth / 2 + 0.011, 0.004))
    foot = merge([plate, post])
    return [(screen.moved(lift), _DISPLAY), (body.moved(lift), case), (foot, case)]


def sign(rng: Rng) -> list[Part]:
    """Make a dot-matrix sign 20 to 34 cm wide on two feet; the part `screen` may shine."""
    width = float(rng.uniform(0.20, 0.34))
    height, depth = width * 0.4, 0.03
    body, screen, case = _slab(rng, width, height, depth, 0.006)
    lift = (0.0, 0.0, height / 2 + 0.008)
    feet = [rounded_box((0.012, 0.08, 0.009), 0.003).moved((sx * 0.35 * width, 0, 0)) for sx in (-1, 1)]
    return [(screen.moved(lift), _DISPLAY), (body.moved(lift), case), (merge(feet), case)]
