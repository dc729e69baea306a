"""Built-in furnishings of rooms: curtains, pictures, mirrors, rugs, rows of books and wall shelves.

What hangs on a wall faces -Y, its back at +Y.
"""

from itertools import pairwise

import numpy as np

from multilight.scenes.assets.builtin.joinery import painted
from multilight.scenes.assets.builtin.parts import METALS, PAPER, Part, tiled
from multilight.scenes.assets.builtin.primitives import Surface, bar, bar_pair, from_grid, merge, prism, rotation, tube
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

CURTAIN_HEIGHT = 2.38
_CLOTHS: tuple[Rgb, ...] = (
    (0.72, 0.68, 0.60), (0.80, 0.78, 0.74), (0.30, 0.36, 0.42), (0.42, 0.20, 0.14), (0.24, 0.30, 0.22),
    (0.55, 0.42, 0.22), (0.16, 0.17, 0.20), (0.50, 0.34, 0.32), (0.36, 0.38, 0.40),
)  # fmt: skip
_INKS: tuple[Rgb, ...] = (
    (0.70, 0.16, 0.08), (0.80, 0.48, 0.08), (0.06, 0.16, 0.34), (0.04, 0.05, 0.06), (0.18, 0.34, 0.28),
    (0.62, 0.40, 0.30), (0.30, 0.52, 0.60), (0.76, 0.66, 0.48), (0.45, 0.10, 0.16), (0.82, 0.78, 0.68),
)  # fmt: skip
_BINDINGS: tuple[Rgb, ...] = (
    (0.35, 0.07, 0.05), (0.05, 0.12, 0.25), (0.08, 0.18, 0.10), (0.62, 0.55, 0.42), (0.05, 0.05, 0.06),
    (0.70, 0.68, 0.62), (0.60, 0.30, 0.06), (0.22, 0.10, 0.20), (0.30, 0.42, 0.46), (0.45, 0.30, 0.18),
)  # fmt: skip


def _drape(rng: Rng, width: float, height: float) -> Surface:
    """Make one curtain in even folds, 3 mm thick, about the y axis."""
    folds, depth = max(3, round(width / 0.085)), float(rng.uniform(0.022, 0.032))
    s = np.linspace(0.0, 1.0, 12 * folds + 1)
    path = np.stack([width * (s - 0.5), depth * np.sin(2 * np.pi * folds * s)], -1)
    slope = np.gradient(path, axis=0)
    sides = np.stack([slope[:, 1], -slope[:, 0]], -1) / np.linalg.norm(slope, axis=1, keepdims=True)
    ring = np.concatenate([path + 0.0015 * sides, (path - 0.0015 * sides)[::-1], path[:1] + 0.0015 * sides[:1]])
    normals = np.concatenate([sides, -sides[::-1], sides[:1]])
    z = np.array([0.0, height])
    points = np.stack(np.broadcast_arrays(ring[:, None, 0], ring[:, None, 1], z), -1)
    shading = np.stack(np.broadcast_arrays(normals[:, None, 0], normals[:, None, 1], np.zeros(2)), -1)
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))]
    return from_grid(points, shading, np.stack(np.broadcast_arrays(along[:, None], z), -1))


def curtains(rng: Rng, *, width: float) -> list[Part]:
    """Make a pair of curtains on a rod for a window of that width, from the floor up; brackets touch the wall."""
    weave = tiled("weave-linen-natural", 0.12)
    cloth = Material(name="cloth", base_color=pick(rng, _CLOTHS), base_color_texture=weave, roughness=0.9)
    bunch, out = float(rng.uniform(0.24, 0.38)), -0.115
    aside = width / 2 + bunch / 2 - 0.06
    drapes = [_drape(rng, bunch, CURTAIN_HEIGHT - 0.03).moved((s * aside, out, 0.0)) for s in (-1, 1)]
    end, top = width / 2 + bunch + 0.04, CURTAIN_HEIGHT - 0.02
    rod = [tube([(x, out, top) for x in np.linspace(-end, end, 3)], 0.012, segments=12)]
    rod += bar_pair((end - 0.03 - 0.008, end - 0.03 + 0.008), (out, 0.0), (top - 0.02, top - 0.004))
    metal = Material(name="rod", base_color=pick(rng, METALS), metallic=1.0, roughness=0.35)
    return [(merge(drapes), cloth), (merge(rod), metal)]


def _framed(width: float, height: float, section: float, depth: float) -> Surface:
    """Frame a rectangle that stands on z = 0, its back at y = 0."""
    half, deep = width / 2, (-depth, 0.0)
    sides = bar_pair((half - section, half), deep, (0.0, height))
    flats = [bar((-half + section, half - section), deep, z) for z in ((0.0, section), (height - section, height))]
    return merge([*sides, *flats])


def _frame_material(rng: Rng) -> Material:
    """Draw what picture frames are made of."""
    if rng.random() < 0.4:
        return Material(name="frame", base_color=(1, 1, 1), base_color_texture=tiled("wood-oak", 0.5), roughness=0.5)
    colour = pick(rng, ((0.04, 0.04, 0.045), (0.85, 0.84, 0.80), (0.30, 0.18, 0.10), (0.75, 0.58, 0.30)))
    return Material(name="frame", base_color=colour, roughness=0.35)


def picture(rng: Rng) -> list[Part]:
    """Make a framed abstract print, 0.3 to 1.0 m a side."""
    width, height = (float(v) for v in np.exp(rng.uniform(np.log(0.34), np.log(0.95), 2)))
    section, mat = float(rng.uniform(0.015, 0.035)), float(rng.uniform(0.0, 0.09)) * min(width, height)
    inner = (width / 2 - section - mat, height - 2 * (section + mat))
    paper = Material(name="mat", base_color=(0.82, 0.81, 0.77), roughness=0.8)
    half = width / 2 - section / 2
    back = bar((-half, half), (-0.008, -0.001), (section / 2, height - section / 2))
    ground = Material(name="ground", base_color=pick(rng, _INKS), roughness=0.6)
    base = (section + mat, section + mat + inner[1])
    parts = [(_framed(width, height, section, 0.024), _frame_material(rng)), (back, paper)]
    parts.append((bar((-inner[0], inner[0]), (-0.0095, -0.007), base, 0.0002), ground))
    for i in range(int(rng.integers(3, 8))):
        ink = Material(name=f"ink{i}", base_color=pick(rng, _INKS), roughness=0.6)
        parts.append((_shape(rng, inner, base, -0.0095 - 0.0004 * (i + 1)), ink))
    return parts


def _shape(rng: Rng, inner: tuple[float, float], base: tuple[float, float], y: float) -> Surface:
    """Draw one shape of a print: a disc, a band or a rectangle, all within the paper."""
    kind, half, tall = rng.random(), inner[0], inner[1]
    if kind < 0.4:
        radius = float(rng.uniform(0.08, 0.4)) * min(half, tall / 2)
        angle = np.linspace(0, 2 * np.pi, 49)[:-1]
        disc = prism(radius * np.stack([np.cos(angle), np.sin(angle)], -1), 0.0006, 0.0001)
        x, z = float(rng.uniform(radius - half, half - radius)), float(rng.uniform(base[0] + radius, base[1] - radius))
        return disc.moved((x, y + 0.0006, z), rotation("x", np.pi / 2))
    wide = half if kind < 0.7 else float(rng.uniform(0.15, 0.7)) * half
    high = float(rng.uniform(0.05, 0.35)) * tall
    x, z = float(rng.uniform(wide - half, half - wide)), float(rng.uniform(base[0], base[1] - high))
    return bar((x - wide, x + wide), (y, y + 0.0006), (z, z + high), 0.0001)


def mirror(rng: Rng) -> list[Part]:
    """Make a framed mirror, upright or lying."""
    width, height = float(rng.uniform(0.45, 0.8)), float(rng.uniform(0.7, 1.3))
    section = float(rng.uniform(0.02, 0.05))
    half = width / 2 - section / 2
    plate = bar((-half, half), (-0.012, -0.001), (section / 2, height - section / 2))
    silver = Material(name="mirror", base_color=(0.95, 0.95, 0.94), metallic=1.0, roughness=0.01)
    return [(_framed(width, height, section, 0.028), _frame_material(rng)), (plate, silver)]


def rug(rng: Rng) -> list[Part]:
    """Make a flat woven rug with a border or stripes, 8 mm thick."""
    width = float(rng.uniform(1.1, 2.6))
    depth, thick = width * float(rng.uniform(0.6, 0.75)), 0.008
    first, second = pick(rng, _CLOTHS), pick(rng, _CLOTHS)
    weave = tiled(pick(rng, ("weave-basket", "weave-linen-natural")), 0.3)
    plain = Material(base_color_texture=weave, roughness=0.95)
    cloth = [plain.model_copy(update={"name": n, "base_color": c}) for n, c in (("field", first), ("band", second))]
    field: list[Surface] = []
    band: list[Surface] = []
    if rng.random() < 0.5:
        edge, (x, y) = float(rng.uniform(0.08, 0.2)), (width / 2, depth / 2)
        field.append(bar((edge - x, x - edge), (edge - y, y - edge), (0.0, thick), 0.001))
        band += [bar((-x, x), side, (0.0, thick)) for side in ((-y, edge - y), (y - edge, y))]
        band += bar_pair((x - edge, x), (edge - y, y - edge), (0.0, thick))
    else:
        cuts = np.r_[0.0, np.sort(rng.uniform(0.05, 0.95, int(rng.integers(4, 9)) * 2)), 1.0] * width - width / 2
        for i, (low, high) in enumerate(pairwise(cuts)):
            (field, band)[i % 2].append(bar((float(low), float(high)), (-depth / 2, depth / 2), (0.0, thick), 0.001))
    return [(merge(field), cloth[0]), (merge(band), cloth[1])]


def books(rng: Rng) -> list[Part]:
    """Make a row of upright books, spines towards -Y, 15 to 45 cm long."""
    covers: dict[int, list[Surface]] = {}
    pages: list[Surface] = []
    x, end = 0.0, float(rng.uniform(0.15, 0.45))
    front = 0.0
    while x < end:
        wide, deep, high = (float(v) for v in rng.uniform((0.014, 0.13, 0.17), (0.048, 0.18, 0.26)))
        ink = int(rng.integers(len(_BINDINGS)))
        sides = ((x, x + 0.0025), (x + wide - 0.0025, x + wide))
        shell = [bar(side, (front, front + deep), (0.0, high), 0.0008) for side in sides]
        shell.append(bar((x + 0.0005, x + wide - 0.0005), (front, front + 0.003), (0.0, high), 0.001))
        covers.setdefault(ink, []).extend(shell)
        inner = (front + 0.002, front + deep - 0.004)
        pages.append(bar((x + 0.002, x + wide - 0.002), inner, (0.004, high - 0.004), 0.0005))
        x += wide + 0.0008
        front = float(rng.uniform(0.0, 0.012))
    parts: list[Part] = []
    for ink, surfaces in sorted(covers.items()):
        cover = Material(name=f"cover{ink}", base_color=_BINDINGS[ink], roughness=float(rng.uniform(0.35, 0.75)))
        parts.append((merge(surfaces), cover))
    return [*parts, (merge(pages), PAPER)]


def wall_shelf(rng: Rng) -> list[Part]:
    """Make a board on two brackets that hangs on a wall, 0.6 to 1.3 m long."""
    width, depth, thick = (float(v) for v in rng.uniform((0.6, 0.2, 0.018), (1.3, 0.26, 0.035)))
    board = bar((-width / 2, width / 2), (-depth, 0.0), (0.12, 0.12 + thick))
    brackets: list[Surface] = []
    for x in (-0.36 * width, 0.36 * width):
        brackets.append(bar((x - 0.012, x + 0.012), (-0.006, 0.0), (0.0, 0.12)))
        arm = [(x, -0.012, 0.012), (x, -0.4 * depth, 0.06), (x, -0.8 * depth, 0.114)]
        brackets.append(tube(arm, 0.006, segments=10))
    metal = Material(name="bracket", base_color=pick(rng, METALS), metallic=1.0, roughness=0.4)
    return [(board, painted(rng, "board")), (merge(brackets), metal)]
