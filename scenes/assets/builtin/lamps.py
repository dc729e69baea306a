"""Built-in objects that glow: candles, bulbs, lamps and night lights; the part `glow` or `flame` may shine."""

import numpy as np

from multilight.scenes.assets.builtin.parts import CLEAR_TINTS, METALS, Part, ceramic, metal, patterned
from multilight.scenes.assets.builtin.primitives import (
    circle,
    cylinder,
    lathe,
    merge,
    prism,
    rotation,
    rounded,
    rounded_box,
    sphere,
    tube,
)
from multilight.scenes.assets.builtin.tableware import beaker
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb

GLOW = Material(name="glow", base_color=(0.92, 0.90, 0.86), roughness=0.4)
_PLASTICS: tuple[Rgb, ...] = ((0.8, 0.79, 0.76), (0.03, 0.03, 0.035), (0.35, 0.36, 0.38), (0.55, 0.16, 0.12))


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
    profile = [(0, 0.0), (0.005, 0.0), (0.0065, 0.003), (0.0125, 0.006), *thread, (0.014, 0.0265), (0.014, 0.029)]
    brass = Material(name="screw", base_color=pick(rng, METALS), metallic=1.0, roughness=0.3)
    return [(shade, GLOW), (lathe(rounded(profile, 0.0006, steps=3)), brass)]


def orb(rng: Rng) -> list[Part]:
    """Make a glowing globe on a turned foot, 10 to 22 cm high; the part `glow` may shine."""
    r = float(rng.uniform(0.04, 0.085))
    foot = [(0, 0), (0.75 * r, 0), (0.75 * r, 0.012), (0.32 * r, 0.026), (0.36 * r, 0.04), (0, 0.04)]
    base = lathe(rounded(foot, [0, 0.003, 0.004, 0.02, 0.003, 0]))
    globe = sphere(r, segments=64).moved((0, 0, 0.036 - 0.06 * r))
    wood = patterned("foot", "wood-walnut", 0.3, 0.4)
    return [(globe, GLOW), (base, wood if rng.random() < 0.5 else metal(rng))]


def votive(rng: Rng) -> list[Part]:
    """Make a candle in a glass; the part `flame` may glow."""
    r, h = float(rng.uniform(0.03, 0.042)), float(rng.uniform(0.075, 0.11))
    cup = lathe(beaker(r * 0.92, r, h, bevel=0.005, wall=0.004))
    # A hair's breadth of air keeps wax and glass from sharing a surface.
    inside = lathe(rounded([(0, 0), (r * 0.72, 0), (r * 0.76, 0.3 * h), (0, 0.3 * h)], [0, 0.002, 0.002, 0]))
    level = 0.005 + 0.3 * h
    stick = candle(rng)[1:]
    foot = min(float(surface.vertices[:, 2].min()) for surface, _ in stick)
    lowered = [(surface.moved((0, 0, level - foot - 0.002)), material) for surface, material in stick]
    wax = Material(name="wax", base_color=(0.85, 0.80, 0.68), roughness=0.45)
    tint = pick(rng, (*CLEAR_TINTS, (0.80, 0.35, 0.30), (0.85, 0.62, 0.30)))
    shell = Material(name="glass", base_color=tint, roughness=0.01, transmission=1.0, ior=1.5)
    return [(cup, shell), (inside.moved((0, 0, 0.0052)), wax), *lowered]


def lamp(rng: Rng) -> list[Part]:
    """Make a table lamp 26 to 44 cm high: a turned foot below a cloth shade; the shade `glow` may shine."""
    h = float(rng.uniform(0.26, 0.44))
    low, high = h * float(rng.uniform(0.26, 0.34)), h * float(rng.uniform(0.16, 0.25))
    base, waist = h * float(rng.uniform(0.16, 0.2)), h * float(rng.uniform(0.03, 0.12))
    stem = [(0, 0), (base, 0), (base, 0.015), (waist + 0.01, 0.04), (waist, 0.3 * h), (0.012, 0.52 * h)]
    stem += [(0.008, 0.62 * h), (0.008, 0.8 * h), (0, 0.8 * h)]
    foot = lathe(rounded(stem, [0, 0.004, 0.01, 0.03, 0.05, 0.02, 0.01, 0.002, 0]))
    wall = np.linspace((low, 0.55 * h), (high, h), 12)
    shade = lathe(np.concatenate([wall, (wall - [0.002, 0.0])[::-1], wall[:1]]), segments=96)
    # Three spokes meet the shade a little over half its height.
    ends = circle(3, low + (high - low) * 0.53 - 0.002, start=float(rng.uniform(0, 2 * np.pi)))
    spokes = [tube([(0, 0, 0.79 * h), (x, y, 0.79 * h)], 0.0015, segments=8) for x, y in ends]
    return [(shade, GLOW), (foot, pick(rng, (ceramic, metal))(rng)), (merge(spokes), metal(rng))]


def desk_lamp(rng: Rng) -> list[Part]:
    """Make a desk lamp 28 to 40 cm high: a metal reflector on a bent arm; the bulb `glow` may shine."""
    h, reach = float(rng.uniform(0.28, 0.40)), float(rng.uniform(0.10, 0.18))
    base = lathe(rounded([(0, 0), (0.07, 0), (0.07, 0.014), (0, 0.018)], [0, 0.003, 0.005, 0]))
    bend = rounded([(0, 0.015), (-0.03, 0.75 * h), (0.0, h), (reach, h - 0.02)], 0.06, steps=12)
    arm = tube(np.stack([bend[:, 0], 0 * bend[:, 0], bend[:, 1]], -1), 0.006)
    t = np.linspace(0, 1, 16)
    cone = np.stack([0.014 + 0.05 * t**0.7, -0.085 * t], -1)
    reflector = lathe(np.concatenate([[(0, 0)], cone, (cone - [0.0015, 0.0015])[::-1], [(0, -0.0015)]])[::-1])
    tilt = rotation("y", float(rng.uniform(-0.5, 0.1)))
    head = (reach, 0.0, h - 0.02)
    globe = sphere(0.022, segments=32).moved((0, 0, -0.072))
    colour = Material(name="paint", base_color=pick(rng, _PLASTICS), roughness=0.3, coat=0.4)
    finish = colour if rng.random() < 0.6 else metal(rng)
    frame = merge([base, arm, reflector.moved(head, tilt)])
    return [(globe.moved(head, tilt), GLOW), (frame, finish)]


def lantern(rng: Rng) -> list[Part]:
    """Make a paper lantern 14 to 30 cm high on a thin base: round, drum or long; the paper `glow` may shine."""
    h, kind = float(rng.uniform(0.14, 0.30)), int(rng.integers(3))
    t = np.linspace(0, 1, 60)
    swell = {0: np.sqrt(np.clip(1 - (1.8 * t - 0.9) ** 2, 0, 1)), 1: 0.5 + 0 * t, 2: 0.36 + 0.1 * np.sin(np.pi * t)}
    ribs = 1 + 0.012 * np.cos(2 * np.pi * 14 * t)
    outer = np.stack([0.5 * h * swell[kind] * ribs, 0.02 + (h - 0.02) * t], -1)
    profile = np.concatenate([[(0, outer[0, 1])], outer, [(0, outer[-1, 1])]])
    paper = lathe(profile, segments=72)
    foot = float(outer[0, 0])
    base = cylinder(0.9 * foot, 0.0195, 0.002)
    wood = patterned("foot", "wood-walnut", 0.3, 0.5)
    return [(paper, GLOW), (base, wood)]


def night_light(rng: Rng) -> list[Part]:
    """Make a night light 7 to 16 cm high: a mushroom, a ghost, a star or an egg; `glow` may shine."""
    s, kind = float(rng.uniform(0.07, 0.16)), int(rng.integers(4))
    stand = Material(name="stand", base_color=pick(rng, _PLASTICS), roughness=0.35, coat=0.2)
    if kind == 0:
        cap = [(0, 0.5), (0.36, 0.5), (0.5, 0.56), (0.44, 0.78), (0.2, 0.97), (0, 1.0)]
        stalk = [(0, 0), (0.24, 0), (0.2, 0.2), (0.17, 0.498), (0, 0.498)]
        top = lathe(rounded(np.array(cap) * s, np.array([0, 0.05, 0.1, 0.2, 0.2, 0]) * s, steps=12))
        return [(top, GLOW), (lathe(rounded(np.array(stalk) * s, np.array([0, 0.05, 0.2, 0.02, 0]) * s)), stand)]
    if kind == 1:
        ghost = [(0, 0.03), (0.42, 0.03), (0.37, 0.35), (0.36, 0.75), (0.18, 1.0), (0, 1.0)]
        sheet = lathe(rounded(np.array(ghost) * s, np.array([0, 0.05, 0.3, 0.25, 0.18, 0]) * s, steps=12), lobes=9)
        eyes = [sphere(0.05 * s, segments=20).moved((x * s, -0.335 * s, 0.62 * s)) for x in (-0.13, 0.13)]
        plate = cylinder(0.3 * s, 0.028 * s, 0.005 * s)
        dark = Material(name="eyes", base_color=(0.03, 0.03, 0.03), roughness=0.3)
        return [(sheet, GLOW), (merge(eyes), dark), (plate, stand)]
    if kind == 2:
        points = circle(10, np.tile([0.52, 0.27], 5) * s, start=np.pi / 2)
        outline = rounded(points, 0.05 * s, closed=True)
        star = prism(outline, 0.22 * s, 0.02 * s).moved(rotation=rotation("x", np.pi / 2))
        star = star.moved((0, 0.11 * s, 0.40 * s + 0.03 * s))
        plate = rounded_box((0.7 * s, 0.4 * s, 0.06 * s), 0.012 * s)
        return [(star, GLOW), (plate, stand)]
    t = np.linspace(-np.pi / 2, np.pi / 2, 40)
    egg = np.stack([0.36 * s * np.cos(t) * (1 - 0.12 * np.sin(t)), 0.47 * s * (1 + np.sin(t))], -1)
    plate = lathe(rounded([(0, 0), (0.25 * s, 0), (0.22 * s, 0.06 * s), (0, 0.06 * s)], [0, 0.01 * s, 0.01 * s, 0]))
    return [(lathe(egg).moved((0, 0, 0.05 * s)), GLOW), (plate, stand)]
