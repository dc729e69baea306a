"""Built-in tableware and small things made by formula, in real-world sizes, several variants of each."""

from collections.abc import Callable

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.parts import BOTTLE_TINTS, Part, ceramic, glass, metal, paint, patterned
from multilight.scenes.assets.builtin.primitives import lathe, merge, rounded, sphere, tube
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb


def vessel(outer: Float64, wall: float, *, lip: float = 0.5) -> Float64:
    """Close an outer profile (radius, z), bottom axis to rim, into a hollow shape of the given wall."""
    edges = np.gradient(outer, axis=0)
    normals = np.stack([edges[:, 1], -edges[:, 0]], -1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inner = (outer - wall * normals)[::-1]
    floor = outer[0, 1] + wall
    inner = inner[(inner[:, 0] > 1e-4) & (inner[:, 1] > floor + 1e-4)]
    inner[:, 0] = np.maximum(inner[:, 0], 1e-3)
    rim = outer[-1] - wall * normals[-1] / 2
    angle = np.linspace(0, np.pi, 9)[1:-1, None]
    along = np.array([-normals[-1, 1], normals[-1, 0]])
    arc = rim + wall / 2 * (np.cos(angle) * normals[-1] + 2 * lip * np.sin(angle) * along)
    end = np.array([[inner[-1, 0], floor], [0.0, floor]])
    return np.concatenate([outer, arc, inner, end])


def beaker(foot: float, rim: float, height: float, *, bevel: float, wall: float, lip: float = 0.5) -> Float64:
    """Return the profile of a hollow vessel with a straight side from a radius at its foot to one at its rim [m]."""
    outer = rounded([(0, 0), (foot, 0), (rim, height)], [0, bevel, 0])
    levels = np.linspace(outer[-2], outer[-1], 12)
    return vessel(np.concatenate([outer[:-2], levels]), wall, lip=lip)


def curve(points: list[tuple[float, float]], *, smooth: int = 48) -> Float64:
    """Run a monotone spline of height through (radius, z) points."""
    from scipy.interpolate import PchipInterpolator

    radius, z = np.array(points).T
    levels = np.linspace(z[0], z[-1], smooth)
    return np.stack([PchipInterpolator(z, radius)(levels), levels], -1)


def footed(wall: Float64, bevel: float = 0.003) -> Float64:
    """Add a flat foot with a rounded edge below an outer wall that starts at z = 0."""
    corner = rounded([(0, 0), (wall[0, 0], 0), tuple(wall[min(6, len(wall) - 1)])], bevel)
    return np.concatenate([corner, wall[7:]])


def mug(rng: Rng) -> list[Part]:
    """Make a mug with a handle, 8 to 11 cm high."""
    r, h = float(rng.uniform(0.036, 0.045)), float(rng.uniform(0.08, 0.11))
    belly = float(rng.uniform(0.94, 1.06))
    body = lathe(vessel(footed(curve([(r * 0.94, 0), (r * belly, h * 0.45), (r, h)]), 0.004), 0.0035))
    angle = np.linspace(-np.pi / 2, np.pi / 2, 24)
    reach, rise = float(rng.uniform(0.026, 0.034)), h * 0.30
    x = r * min(belly, 1.0) - 0.003 + reach * np.cos(angle) ** 0.75
    path = np.stack([x, np.zeros_like(x), h * 0.52 + rise * np.sin(angle)], -1)
    handle = tube(path, 0.0045, flatten=1.5)
    return [(merge([body, handle]), ceramic(rng))]


def bowl(rng: Rng) -> list[Part]:
    """Make a bowl 12 to 24 cm wide."""
    r = float(rng.uniform(0.06, 0.12))
    h = r * float(rng.uniform(0.5, 0.95))
    shape = float(rng.uniform(1.7, 3.0))
    t = np.linspace(0, 1, 40)
    wall = np.stack([r * (0.42 + 0.58 * t ** (1 / shape)), h * t], -1)
    profile = vessel(footed(wall), 0.004)
    return [(lathe(profile, planar_uv=True), ceramic(rng) if rng.random() < 0.75 else metal(rng))]


def plate(rng: Rng) -> list[Part]:
    """Make a plate 16 to 27 cm wide."""
    r, h = float(rng.uniform(0.08, 0.135)), float(rng.uniform(0.012, 0.024))
    foot = float(rng.uniform(0.55, 0.68)) * r
    outer = [(0, 0.0), (foot, 0.0), (foot + 0.006, 0.004), (r, h), (r - 0.001, h + 0.0035), (foot, 0.0065), (0, 0.0055)]
    profile = rounded(outer, [0, 0.002, 0.012, 0.0016, 0.0016, 0.02, 0])
    return [(lathe(profile, segments=96, planar_uv=True), ceramic(rng))]


def vase(rng: Rng) -> list[Part]:
    """Make a vase 12 to 34 cm high; the profile, and fluting on some, come from the generator."""
    h = float(rng.uniform(0.12, 0.34))
    belly, neck, lip = (float(v) for v in rng.uniform((0.22, 0.10, 1.0), (0.34, 0.18, 1.5)))
    where = float(rng.uniform(0.25, 0.6))
    points = [(belly * rng.uniform(0.5, 0.8) * h, 0), (belly * h, where * h), (neck * h, 0.85 * h), (neck * lip * h, h)]
    fluted = rng.random() < 0.35
    surface = lathe(
        vessel(footed(curve([(float(r), float(z)) for r, z in points], smooth=48)), 0.004),
        segments=144 if fluted else 80,
        lobes=int(rng.integers(10, 21)) if fluted else 0,
        depth=0.025 if fluted else 0.0,
    )
    return [(surface, ceramic(rng) if rng.random() < 0.7 else glass(rng))]


def bottle(rng: Rng) -> list[Part]:
    """Make a glass bottle 16 to 31 cm high with a stopper."""
    h = float(rng.uniform(0.16, 0.31))
    r, neck = h * float(rng.uniform(0.13, 0.19)), float(rng.uniform(0.011, 0.014))
    shoulder = float(rng.uniform(0.5, 0.68)) * h
    corners = [(0, 0), (r, 0), (r, shoulder), (neck, shoulder + 1.1 * (r - neck)), (neck, h)]
    body = vessel(rounded(corners, [0, 0.006, 0.03, 0.03, 0], steps=10), 0.0028)
    plug = [(0, 0), (neck * 0.72, 0), (neck * 0.76, 0.02), (neck * 1.1, 0.02), (neck * 1.1, 0.032), (0, 0.032)]
    cork = Material(name="cork", base_color=(0.45, 0.27, 0.14), roughness=0.9)
    stopper = lathe(rounded(plug, 0.0015)).moved((0, 0, h - 0.0195))
    return [(lathe(body), glass(rng, BOTTLE_TINTS)), (stopper, cork if rng.random() < 0.6 else metal(rng))]


def jar(rng: Rng) -> list[Part]:
    """Make a storage jar with a lid, 9 to 20 cm high."""
    r, h = float(rng.uniform(0.035, 0.055)), float(rng.uniform(0.08, 0.17))
    corners = [(0, 0), (r, 0), (r, h - 0.018), (r * 0.86, h - 0.008), (r * 0.86, h)]
    body = lathe(vessel(rounded(corners, [0, 0.006, 0.008, 0.004, 0]), 0.003))
    lid = [(0, 0), (r * 0.93, 0), (r * 0.93, 0.016), (0.008, 0.018), (0.007, 0.024), (0.013, 0.034), (0, 0.038)]
    top = lathe(rounded(lid, [0, 0.002, 0.004, 0.003, 0.004, 0.007, 0])).moved((0, 0, h - 0.001))
    wood = patterned("lid", "wood-oak", 0.4, 0.5)
    return [(body, glass(rng) if rng.random() < 0.5 else ceramic(rng)), (top, wood)]


def tumbler(rng: Rng) -> list[Part]:
    """Make a drinking glass 8 to 15 cm high."""
    h = float(rng.uniform(0.08, 0.15))
    r = float(rng.uniform(0.03, 0.042))
    foot = r * float(rng.uniform(0.75, 1.0))
    return [(lathe(beaker(foot, r, h, bevel=0.004, wall=0.0024)), glass(rng))]


def can(rng: Rng) -> list[Part]:
    """Make a tin 8 to 12 cm high."""
    r, h = float(rng.uniform(0.032, 0.05)), float(rng.uniform(0.08, 0.12))
    rim = [(0, 0.003), (r - 0.003, 0.003), (r - 0.002, 0), (r, 0), (r, 0.004), (r - 0.0012, 0.005)]
    mirror = [(x, h - z) for x, z in reversed(rim)]
    return [(lathe(rounded([*rim, *mirror], 0.0007)), metal(rng))]


def pawn(rng: Rng) -> list[Part]:
    """Make a turned figure like a chess pawn, 7 to 14 cm high."""
    s = float(rng.uniform(0.07, 0.14))
    ball, waist = float(rng.uniform(0.13, 0.18)), float(rng.uniform(0.08, 0.11))
    stem = [(0, 0), (0.25, 0), (0.25, 0.09), (0.19, 0.16), (waist, 0.55), (0.18, 0.6), (0.18, 0.63), (0.09, 0.66)]
    angle = np.linspace(-0.9, np.pi / 2, 20)
    head = np.stack([ball * np.cos(angle), 1 - ball + ball * np.sin(angle)], -1)
    profile = np.concatenate([rounded(stem, [0, 0.03, 0.05, 0.1, 0.2, 0.02, 0.02, 0]), head]) * s
    wood = patterned("wood", "wood-walnut", 0.3, 0.35, coat=0.5)
    return [(lathe(profile), wood if rng.random() < 0.5 else paint(rng))]


def ball(rng: Rng) -> list[Part]:
    """Make a plain ball 4 to 12 cm wide."""
    makers: tuple[Callable[[Rng], Material], ...] = (paint, metal, ceramic, glass)
    return [(sphere(float(rng.uniform(0.02, 0.06))), pick(rng, makers)(rng))]


def fruit(rng: Rng) -> list[Part]:
    """Make an apple-like fruit with a stalk, 6 to 9 cm wide."""
    r = float(rng.uniform(0.03, 0.045))
    dip, tall = float(rng.uniform(0.15, 0.4)), float(rng.uniform(0.85, 1.1))
    t = np.linspace(-np.pi / 2, np.pi / 2, 41)
    radius = np.cos(t) ** 0.8
    z = tall * np.sin(t) - dip * np.sign(np.sin(t)) * np.exp(-((radius / 0.35) ** 2)) * (0.6 + 0.4 * np.sin(t))
    body = lathe(r * np.stack([radius, z - z.min()], -1), lobes=5, depth=0.02)
    top = r * float(z[-1] - z.min())
    lean = np.linspace(0, 1, 8)
    path = np.stack([0.25 * r * lean**2, 0 * lean, top - 0.004 + 0.55 * r * lean], -1)
    skins: tuple[Rgb, ...] = ((0.45, 0.03, 0.03), (0.35, 0.42, 0.04), (0.75, 0.30, 0.02), (0.65, 0.50, 0.05))
    skin = Material(name="skin", base_color=pick(rng, skins), roughness=0.38, coat=0.3, coat_roughness=0.25)
    stalk = Material(name="stalk", base_color=(0.12, 0.07, 0.03), roughness=0.8)
    return [(body, skin), (tube(path, 0.0016, segments=10), stalk)]
