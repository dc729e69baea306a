"""Built-in lamps of rooms: pendants, ceiling, floor and table lamps. The part that shines is called `glow`."""

import numpy as np

from multilight.scenes.assets.builtin.parts import METALS, Part, tiled
from multilight.scenes.assets.builtin.primitives import Surface, cylinder, lathe, merge, rounded, sphere, tube
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

GLASS = Material(name="glow", base_color=(0.9, 0.89, 0.86), roughness=0.35)
_SHADES: tuple[Rgb, ...] = (
    (0.80, 0.76, 0.66), (0.06, 0.06, 0.065), (0.55, 0.16, 0.08), (0.10, 0.18, 0.26), (0.20, 0.28, 0.20),
    (0.70, 0.50, 0.16),
)  # fmt: skip
_GLAZES: tuple[Rgb, ...] = (
    (0.78, 0.76, 0.70), (0.08, 0.16, 0.24), (0.10, 0.20, 0.14), (0.04, 0.04, 0.045), (0.45, 0.22, 0.12),
)  # fmt: skip
_INSIDE = Material(name="lining", base_color=(0.85, 0.83, 0.78), roughness=0.6)


def _metal(rng: Rng) -> Material:
    """Draw the metal or black paint of a stand."""
    if rng.random() < 0.4:
        return Material(name="stand", base_color=(0.03, 0.03, 0.032), roughness=0.4)
    return Material(name="stand", base_color=pick(rng, METALS), metallic=1.0, roughness=float(rng.uniform(0.15, 0.4)))


def _bulb(radius: float = 0.032) -> Surface:
    """Make a bulb that stands on its cap, about 9 cm high."""
    neck = [(0, 0), (0.013, 0), (0.013, 0.02), (radius, 0.02 + 1.1 * radius), (radius, 0.02 + 1.5 * radius)]
    return lathe(rounded([*neck, (0, 0.02 + 2.6 * radius)], [0, 0.002, 0.01, 0.02, 0.03, 0]), segments=24)


def _drum(low: float, high: float, height: float, lift: float) -> tuple[Surface, Surface]:
    """Make a shade open above and below, from `lift` up: its outside and its lining."""
    t = 0.002
    outside = lathe([(low - t / 2, 0), (low, 0), (high, height), (high - t / 2, height)], segments=48)
    inside = lathe([(high - t / 2, height), (high - t, height), (low - t, 0), (low - t / 2, 0)], segments=48)
    return outside.moved((0, 0, lift)), inside.moved((0, 0, lift))


def _cloth(rng: Rng) -> Material:
    """Draw the outside of a shade."""
    texture = tiled("weave-linen-natural", 0.12) if rng.random() < 0.5 else None
    return Material(name="shade", base_color=pick(rng, _SHADES), base_color_texture=texture, roughness=0.85)


def _shaded(rng: Rng, shade: tuple[Surface, Surface], bulb: Surface) -> list[Part]:
    """Put a drum shade round a bulb: thin cloth that glows with it, or dense cloth that lets light out up and down."""
    outside, inside = shade
    if rng.random() < 0.5:
        return [(merge([outside, inside, bulb]), GLASS)]
    return [(outside, _cloth(rng)), (inside, _INSIDE), (bulb, GLASS)]


def _dome(radius: float, height: float) -> tuple[Surface, Surface]:
    """Make a bell-shaped shade open below, its rim at z = 0: outside and lining."""
    angle = np.linspace(0.0, np.pi / 2 - 0.08, 14)
    r, z = radius * np.cos(angle) ** 0.8, height * np.sin(angle)
    outer = np.stack([r, z], -1)
    inner = outer * [(radius - 0.004) / radius, (height - 0.004) / height]
    outside = np.concatenate([[(radius - 0.002, 0)], outer, [(0.0, height)]])
    inside = np.concatenate([[(0.0, height - 0.004)], inner[::-1], [(radius - 0.002, 0)]])
    return lathe(outside, segments=48), lathe(inside)


def pendant(rng: Rng) -> list[Part]:
    """Make a lamp on a cord: a metal bell with a bulb in it, or an opal globe; 0.6 to 1.0 m with its cord."""
    drop, metal = float(rng.uniform(0.35, 0.65)), _metal(rng)
    parts: list[Part] = []
    if rng.random() < 0.6:
        radius = float(rng.uniform(0.14, 0.24))
        height = radius * float(rng.uniform(0.6, 1.0))
        outside, inside = _dome(radius, height)
        # The bulb hangs head down, its cap in the bell.
        bulb = _bulb(0.03).moved((0, 0, height - 0.004), np.diag([1.0, -1.0, -1.0]))
        shade = Material(name="shade", base_color=pick(rng, _SHADES), roughness=0.35, coat=0.3)
        parts = [(outside, shade), (inside, _INSIDE), (bulb, GLASS)]
    else:
        radius = float(rng.uniform(0.11, 0.19))
        height = 2 * radius
        parts = [(sphere(radius), GLASS)]
        parts.append((cylinder(0.03, 0.03, segments=24).moved((0, 0, height - 0.005)), metal))
    cord = tube([(0, 0, height), (0, 0, height + drop / 2), (0, 0, height + drop - 0.02)], 0.003, segments=8)
    rose = cylinder(0.05, 0.025, 0.004, segments=32)
    parts.append((merge([cord, rose.moved((0, 0, height + drop - 0.025))]), metal))
    return parts


def ceiling_lamp(rng: Rng) -> list[Part]:
    """Make a flat lamp of opal glass under a ceiling, 0.3 to 0.5 m wide."""
    radius, height = float(rng.uniform(0.15, 0.26)), float(rng.uniform(0.06, 0.1))
    angle = np.linspace(-np.pi / 2, 0.0, 12)
    bowl = np.stack([0.97 * radius * np.cos(angle), (height - 0.02) * (1 + np.sin(angle))], -1)
    glass = lathe(np.concatenate([bowl, [(0.0, height - 0.02)]]), segments=48)
    rim = rounded([(0, height - 0.02), (radius, height - 0.02), (radius, height), (0, height)], 0.003)
    return [(glass, GLASS), (lathe(rim, segments=48), _metal(rng))]


def floor_lamp(rng: Rng) -> list[Part]:
    """Make a standing lamp, 1.35 to 1.7 m high: a drum shade round a bulb, or an opal globe on a pole."""
    height, metal = float(rng.uniform(1.35, 1.7)), _metal(rng)
    plate = rounded([(0, 0), (0.14, 0), (0.14, 0.02), (0.02, 0.03), (0, 0.03)], [0, 0.003, 0.008, 0.01, 0])
    base = lathe(plate, segments=48)
    if rng.random() < 0.65:
        tall = float(rng.uniform(0.22, 0.32))
        lift = height - tall
        shade = _drum(float(rng.uniform(0.18, 0.24)), float(rng.uniform(0.13, 0.18)), tall, lift)
        stem = tube([(0, 0, 0.02), (0, 0, height / 2), (0, 0, lift + 0.06)], 0.009, segments=12)
        bulb = _bulb().moved((0, 0, lift + 0.065))
        z = lift + 0.05
        spokes = [[(r * c, r * s, z) for r in (0, 0.07, 0.16)] for c, s in ((1, 0), (-0.5, 0.866), (-0.5, -0.866))]
        ring = [tube(spoke, 0.002, segments=6) for spoke in spokes]
        return [(merge([base, stem, *ring]), metal), *_shaded(rng, shade, bulb)]
    radius = float(rng.uniform(0.1, 0.16))
    stem = tube([(0, 0, 0.02), (0, 0, height / 2), (0, 0, height - 2 * radius)], 0.011, segments=12)
    return [(merge([base, stem]), metal), (sphere(radius).moved((0, 0, height - 2 * radius - 0.004)), GLASS)]


def table_lamp(rng: Rng) -> list[Part]:
    """Make a lamp of 0.38 to 0.55 m for tables: a turned foot and a drum shade round a bulb."""
    foot, tall = float(rng.uniform(0.2, 0.3)), float(rng.uniform(0.16, 0.22))
    belly, waist = (float(v) for v in rng.uniform((0.05, 0.014), (0.085, 0.02)))
    top = foot + 0.03
    profile = [(0, 0), (belly * 0.8, 0), (belly, foot * 0.35), (waist, foot * 0.9), (waist, top), (0, top)]
    body = lathe(rounded(profile, [0, 0.006, 0.08, 0.08, 0.003, 0]), segments=48)
    glaze = Material(name="foot", base_color=pick(rng, _GLAZES), roughness=0.25, coat=0.6)
    lift = foot - 0.02
    shade = _drum(float(rng.uniform(0.12, 0.16)), float(rng.uniform(0.08, 0.11)), tall, lift)
    spokes = [[(s * r, 0, lift + 0.045) for r in (0, 0.04, 0.105)] for s in (-1, 1)]
    wire = [tube(spoke, 0.002, segments=6) for spoke in spokes]
    bulb = _bulb(0.026).moved((0, 0, top))
    return [(body, glaze), (merge(wire), _metal(rng)), *_shaded(rng, shade, bulb)]
