"""Built-in joinery: windows and doors.

They face -Y and reach into the wall: their plane of y = 0 is the wall's inner face, and `WINDOW_PROUD` and
`DOOR_PROUD` say how far they stand out of it.
"""

import numpy as np

from multilight.scenes.assets.builtin.parts import METALS, Part, tiled
from multilight.scenes.assets.builtin.primitives import Surface, bar, bar_pair, cylinder, merge, rotation, tube
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

CASING = 0.07
"""Width [m] of the boards round an opening; a window's sill reaches `EAR` to each side instead."""
EAR = 0.10
SILL = 0.03
"""Thickness [m] of a window's sill, which lies below the opening."""
WINDOW_PROUD, WINDOW_DEPTH = 0.06, 0.22
DOOR_PROUD, DOOR_DEPTH = 0.04, 0.12
LINING = 0.02

# Clear width and height [m], panes across and up.
WINDOWS: dict[str, tuple[float, float, int, int]] = {
    "a": (1.0, 1.3, 2, 1),
    "b": (1.3, 1.3, 2, 2),
    "c": (1.7, 1.35, 3, 1),
    "d": (2.2, 1.4, 2, 1),
    "e": (0.8, 1.45, 1, 2),
    "f": (1.5, 1.95, 2, 3),
    "g": (2.0, 1.95, 4, 2),
    "h": (1.8, 1.1, 2, 1),
}
_PAINTS: tuple[Rgb, ...] = (
    (0.86, 0.85, 0.82), (0.86, 0.85, 0.82), (0.74, 0.70, 0.62), (0.42, 0.43, 0.43), (0.10, 0.11, 0.12),
    (0.20, 0.27, 0.25),
)  # fmt: skip


def painted(rng: Rng, name: str) -> Material:
    """Draw the paint or the wood of joinery."""
    if rng.random() < 0.3:
        texture = tiled(pick(rng, ("wood-oak", "wood-walnut", "wood-pine")), 0.8)
        return Material(name=name, base_color=(1, 1, 1), base_color_texture=texture, roughness=0.45, coat=0.2)
    return Material(name=name, base_color=pick(rng, _PAINTS), roughness=float(rng.uniform(0.25, 0.5)))


def _casing(width: float, height: float) -> list[Surface]:
    """Frame an opening on the wall's face with three boards."""
    half, deep = width / 2, (-0.018, 0.004)
    sides = bar_pair((half, half + CASING), deep, (0.0, height))
    return [*sides, bar((-half - CASING, half + CASING), deep, (height, height + CASING))]


def _lining(width: float, height: float, depth: float) -> list[Surface]:
    """Line the cut through the wall, sides and top."""
    half = width / 2
    sides = bar_pair((half, half + LINING), (0.0, depth), (-0.01, height))
    return [*sides, bar((-half - LINING, half + LINING), (0.0, depth), (height, height + LINING))]


def window(rng: Rng, *, size: tuple[float, float, int, int]) -> list[Part]:
    """Make a window as in `WINDOWS`, without glass: casing, sill, lining, a frame with bars between its panes."""
    width, height, across, up = size
    half, deep = width / 2, (0.12, 0.165)
    wood = painted(rng, "joinery")
    parts = [*_casing(width, height), *_lining(width, height, WINDOW_DEPTH)]
    parts.append(bar((-half - EAR, half + EAR), (-WINDOW_PROUD, 0.0), (-SILL, 0.0), 0.006))
    parts.append(bar((-half - LINING, half + LINING), (0.0, WINDOW_DEPTH), (-SILL, 0.0)))
    edge, thin = 0.055, 0.034 if up == 1 else 0.026
    parts += bar_pair((half - edge, half), deep, (0.0, height))
    parts += [bar((-half, half), deep, z) for z in ((0.0, edge), (height - edge, height))]
    for i in range(1, across):
        x, wide = -half + width * i / across, 0.04 if across == 2 else thin / 2
        parts.append(bar((x - wide, x + wide), (deep[0] + 0.004, deep[1] - 0.004), (edge, height - edge)))
    for i in range(1, up):
        z = height * i / up
        parts.append(bar((-half + edge, half - edge), (deep[0] + 0.008, deep[1] - 0.008), (z - thin / 2, z + thin / 2)))
    return [(merge(parts), wood)]


def door(rng: Rng) -> list[Part]:
    """Make a shut door: casing, lining, a leaf with panels, and a handle."""
    width, height = float(rng.uniform(0.80, 0.92)), float(rng.uniform(2.0, 2.1))
    half = width / 2
    frame, leaf = painted(rng, "joinery"), [bar((-half - 0.004, half + 0.004), (0.03, 0.07), (0.0, height + 0.004))]
    rows = pick(rng, (((0.14, 0.85), (0.98, height - 0.14)), ((0.14, 0.6), (0.7, 1.3), (1.4, height - 0.14)), ()))
    columns = 2 if rng.random() < 0.5 else 1
    for z in rows:
        for i in range(columns):
            x = -half + 0.11 + i * (width - 0.11) / columns
            leaf.append(bar((x, x + (width - 0.11) / columns - 0.11), (0.022, 0.04), z, 0.006))
    side = float(rng.choice([-1.0, 1.0]))
    x = side * (half - 0.065)
    metal = Material(name="handle", base_color=pick(rng, METALS), metallic=1.0, roughness=float(rng.uniform(0.15, 0.4)))
    rose = cylinder(0.026, 0.008, segments=24).moved((x, 0.03, 1.03), rotation("x", np.pi / 2))
    bend = [(x, 0.03), (x, 0.0), (x, -0.024), (x - side * 0.02, -0.031), (x - side * 0.12, -0.031)]
    lever = merge([rose, tube([(*point, 1.03) for point in bend], 0.009, segments=12)])
    parts = merge([*_casing(width, height), *_lining(width, height, DOOR_DEPTH)])
    return [(parts, frame), (merge(leaf), frame.model_copy(update={"name": "leaf"})), (lever, metal)]
