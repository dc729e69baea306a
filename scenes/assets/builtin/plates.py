"""Built-in things that other things stand on or before: plates, trays, plinths and mirrors. uv is in metres."""

from multilight.scenes.assets.builtin.parts import Part, metal, paint, patterned
from multilight.scenes.assets.builtin.primitives import (
    circle,
    cylinder,
    lathe,
    merge,
    prism,
    rotation,
    rounded,
    rounded_box,
)
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material

_PLAIN = Material(name="plate", base_color=(0.7, 0.7, 0.7), roughness=0.3)
MIRROR = Material(name="mirror", base_color=(0.92, 0.93, 0.93), metallic=1.0, roughness=0.0)


def slab(rng: Rng) -> list[Part]:
    """Make a plate 0.5 to 0.8 m wide and 6 to 14 mm thick, rectangular or round; its material is the scene's."""
    thick = float(rng.uniform(0.006, 0.014))
    if rng.random() < 0.65:
        x, y = float(rng.uniform(0.55, 0.8)), float(rng.uniform(0.45, 0.6))
        return [(rounded_box((x, y, thick), 0.0015), _PLAIN)]
    radius = float(rng.uniform(0.26, 0.36))
    return [(cylinder(radius, thick, 0.0015, segments=128, planar_uv=True), _PLAIN)]


def tray(rng: Rng) -> list[Part]:
    """Make a tray 0.46 to 0.6 m wide with a raised rim, round or rectangular."""
    if rng.random() < 0.5:
        r, rim = float(rng.uniform(0.23, 0.29)), float(rng.uniform(0.008, 0.016))
        outer = [(0, 0), (r - 0.012, 0), (r, rim), (r - 0.0025, rim + 0.0015), (r - 0.0135, 0.0022), (0, 0.0022)]
        return [(lathe(rounded(outer, [0, 0.003, 0.001, 0.001, 0.003, 0]), segments=128, planar_uv=True), metal(rng))]
    x, y, rim = float(rng.uniform(0.5, 0.6)), float(rng.uniform(0.42, 0.48)), float(rng.uniform(0.008, 0.018))
    long, short = rounded_box((x, 0.006, rim), 0.002), rounded_box((0.006, y - 0.012, rim), 0.002)
    edges = [long.moved((0, s * (y / 2 - 0.003), 0)) for s in (-1, 1)]
    edges += [short.moved((s * (x / 2 - 0.003), 0, 0)) for s in (-1, 1)]
    return [(merge([rounded_box((x - 0.012, y - 0.012, 0.003), 0.0005), *edges]), metal(rng))]


def plinth(rng: Rng) -> list[Part]:
    """Make a plinth for a studio, 10 to 36 cm wide and 3 to 25 cm high: a cylinder, a box or a prism."""
    half, h = float(rng.uniform(0.05, 0.18)), float(rng.uniform(0.03, 0.25))
    kind = int(rng.integers(3))
    if kind == 0:
        surface = cylinder(half, h, 0.0015, segments=96)
    elif kind == 1:
        surface = rounded_box((2 * half, 2 * half, h), 0.0015)
    else:
        surface = prism(rounded(circle(6, half), 0.002, closed=True, steps=3), h, 0.001)
    return [(surface, _PLAIN)]


def standing_mirror(rng: Rng) -> list[Part]:
    """Make a mirror in a frame, 0.4 to 0.6 m wide and 0.4 to 0.7 m high, that leans back on a strut."""
    w, h, lean = float(rng.uniform(0.4, 0.6)), float(rng.uniform(0.4, 0.7)), float(rng.uniform(0.06, 0.16))
    frame = float(rng.uniform(0.012, 0.035))
    tilt = rotation("x", -lean)
    glass = rounded_box((w - 2 * frame + 0.004, 0.004, h - 2 * frame + 0.004), 0.0005).moved((0, -0.001, frame - 0.002))
    sides = [rounded_box((frame, 0.016, h), 0.002).moved((s * (w - frame) / 2, 0, 0)) for s in (-1, 1)]
    sides += [rounded_box((w - 2 * frame, 0.016, frame), 0.002).moved((0, 0, z)) for z in (0.0, h - frame)]
    back = rounded_box((w - 2 * frame, 0.004, h - 2 * frame), 0.0005).moved((0, 0.006, frame))
    strut = rounded_box((0.04, 0.012, 0.72 * h), 0.002).moved(rotation=rotation("x", 0.38)).moved((0, 0.40 * h, 0))
    timber = patterned("frame", "wood-walnut", 0.4, 0.5)
    finish = pick(rng, (timber, metal(rng), paint(rng, "frame")))
    leaning = merge([part.moved(rotation=tilt) for part in (*sides, back)])
    # Leaning, frame and strut each stand on an edge: both on the ground.
    lift, strut_lift = (-float(part.vertices[:, 2].min()) for part in (leaning, strut))
    return [
        (glass.moved((0, 0, lift), tilt), MIRROR),
        (merge([leaning.moved((0, 0, lift)), strut.moved((0, 0, strut_lift))]), finish),
    ]
