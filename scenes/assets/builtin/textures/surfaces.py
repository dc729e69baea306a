"""The procedural surface textures by name: colour, normal and roughness as bitmaps that both renderers read.

Row 0 is the image's top; all of them wrap around at their borders.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from multilight.scenes.arrays import Float64, UInt8
from multilight.scenes.assets.builtin.textures.grounds import asphalt, gravel, lawn, paving, sand, setts
from multilight.scenes.assets.builtin.textures.patterns import (
    brushed,
    checked,
    cork,
    leather,
    marble,
    noise,
    planks,
    plaster,
    speckled,
    terrazzo,
    tiles,
    weave,
    wood,
)
from multilight.scenes.assets.derived_maps import roughness_map
from multilight.scenes.random_streams import Rng, generator_of

RESOLUTION = 1024


@dataclass(frozen=True)
class Recipe:
    """How to make a texture: its category, the metres that one repeat covers, and the function."""

    category: str
    metres: float
    make: Callable[[Rng, int], tuple[Float64, Float64]]


_OAK = ((0.50, 0.35, 0.21), (0.66, 0.50, 0.33), (0.76, 0.62, 0.45))
_WALNUT = ((0.19, 0.11, 0.07), (0.36, 0.24, 0.16), (0.50, 0.36, 0.25))
_PINE = ((0.72, 0.54, 0.34), (0.85, 0.70, 0.49), (0.92, 0.81, 0.62))
_CHERRY = ((0.38, 0.17, 0.10), (0.57, 0.30, 0.18), (0.69, 0.42, 0.27))
_ASH = ((0.55, 0.50, 0.44), (0.70, 0.66, 0.60), (0.80, 0.77, 0.72))
_CHIPS = ((0.35, 0.33, 0.31), (0.72, 0.60, 0.48), (0.90, 0.88, 0.84), (0.55, 0.36, 0.28), (0.18, 0.18, 0.19))
_FRESH = ((0.20, 0.28, 0.10), (0.34, 0.46, 0.17), (0.54, 0.62, 0.30))
_DRY = ((0.32, 0.32, 0.17), (0.50, 0.48, 0.27), (0.72, 0.67, 0.44))
_PEBBLES = ((0.34, 0.33, 0.32), (0.58, 0.57, 0.55), (0.80, 0.78, 0.74))
_WARM_PEBBLES = ((0.45, 0.36, 0.27), (0.68, 0.57, 0.44), (0.86, 0.80, 0.70))
_SANDSTONE = ((0.58, 0.52, 0.44), (0.76, 0.70, 0.60))
_CONCRETE = ((0.48, 0.48, 0.47), (0.62, 0.62, 0.60))
_GRANITE = ((0.34, 0.34, 0.35), (0.56, 0.54, 0.52), (0.66, 0.62, 0.57))

TEXTURES: dict[str, Recipe] = {
    "wood-oak": Recipe("wood", 0.8, partial(wood, colours=_OAK, rings=16)),
    "wood-walnut": Recipe("wood", 0.8, partial(wood, colours=_WALNUT, rings=14)),
    "wood-pine": Recipe("wood", 0.8, partial(wood, colours=_PINE, rings=10)),
    "wood-cherry": Recipe("wood", 0.8, partial(wood, colours=_CHERRY, rings=18)),
    "wood-ash": Recipe("wood", 0.8, partial(wood, colours=_ASH, rings=15)),
    "planks-oak": Recipe("wood", 1.0, partial(planks, colours=_OAK, rows=8)),
    "planks-dark": Recipe("wood", 1.0, partial(planks, colours=_WALNUT, rows=7)),
    "planks-pine": Recipe("wood", 1.2, partial(planks, colours=_PINE, rows=9)),
    "marble-white": Recipe(
        "stone", 0.9, partial(marble, colours=((0.82, 0.82, 0.82), (0.93, 0.92, 0.91)), vein=(0.42, 0.42, 0.44))
    ),
    "marble-dark": Recipe(
        "stone", 0.9, partial(marble, colours=((0.05, 0.05, 0.055), (0.14, 0.13, 0.13)), vein=(0.78, 0.74, 0.68))
    ),
    "marble-green": Recipe(
        "stone", 0.9, partial(marble, colours=((0.10, 0.20, 0.16), (0.22, 0.34, 0.27)), vein=(0.70, 0.76, 0.68))
    ),
    "terrazzo-light": Recipe("stone", 0.6, partial(terrazzo, base=(0.86, 0.84, 0.80), chips=_CHIPS)),
    "terrazzo-dark": Recipe("stone", 0.6, partial(terrazzo, base=(0.22, 0.22, 0.23), chips=_CHIPS)),
    "weave-linen-natural": Recipe(
        "fabric", 0.12, partial(weave, across=(0.80, 0.74, 0.63), along=(0.74, 0.68, 0.57), threads=64)
    ),
    "weave-linen-blue": Recipe(
        "fabric", 0.12, partial(weave, across=(0.28, 0.38, 0.52), along=(0.22, 0.30, 0.44), threads=64)
    ),
    "weave-basket": Recipe(
        "fabric", 0.2, partial(weave, across=(0.62, 0.48, 0.32), along=(0.52, 0.39, 0.25), threads=24)
    ),
    "tiles-white": Recipe(
        "tiles", 0.6, partial(tiles, colours=((0.90, 0.90, 0.88),), grout=(0.55, 0.54, 0.52), count=4)
    ),
    "tiles-teal": Recipe(
        "tiles", 0.5, partial(tiles, colours=((0.20, 0.43, 0.45),), grout=(0.75, 0.74, 0.70), count=5)
    ),
    "tiles-chequer": Recipe(
        "tiles", 0.8,
        partial(tiles, colours=((0.86, 0.84, 0.79), (0.16, 0.16, 0.17)), grout=(0.42, 0.41, 0.40), count=4),
    ),
    "plaster-white": Recipe("plaster", 1.5, partial(plaster, colour=(0.88, 0.87, 0.84), grain=4e-4, stains=0.012)),
    "plaster-sand": Recipe("plaster", 1.5, partial(plaster, colour=(0.78, 0.68, 0.55), grain=6e-4, stains=0.025)),
    "plaster-sage": Recipe("plaster", 1.5, partial(plaster, colour=(0.58, 0.64, 0.56), grain=4e-4, stains=0.02)),
    "concrete-grey": Recipe("concrete", 1.5, partial(plaster, colour=(0.55, 0.54, 0.52), grain=3e-4, stains=0.06)),
    "metal-brushed": Recipe("metal", 0.3, partial(brushed, colour=(0.78, 0.78, 0.79))),
    "ceramic-speckled-cream": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.86, 0.81, 0.72), speck=(0.28, 0.19, 0.13))
    ),
    "ceramic-speckled-blue": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.36, 0.49, 0.58), speck=(0.12, 0.15, 0.20))
    ),
    "ceramic-speckled-stone": Recipe(
        "ceramic", 0.1, partial(speckled, colour=(0.58, 0.56, 0.53), speck=(0.20, 0.18, 0.17))
    ),
    "leather-brown": Recipe("leather", 0.25, partial(leather, colour=(0.47, 0.31, 0.20))),
    "leather-black": Recipe("leather", 0.25, partial(leather, colour=(0.22, 0.21, 0.21))),
    "cork-light": Recipe("cork", 0.3, partial(cork, colours=((0.60, 0.44, 0.28), (0.78, 0.62, 0.44)))),
    "check-red": Recipe(
        "fabric", 0.24,
        partial(checked, colours=((0.90, 0.87, 0.81), (0.70, 0.16, 0.14), (0.20, 0.22, 0.30)), threads=64),
    ),
    "check-green": Recipe(
        "fabric", 0.24,
        partial(checked, colours=((0.34, 0.42, 0.34), (0.14, 0.22, 0.26), (0.80, 0.66, 0.34)), threads=64),
    ),
    "lawn-fresh": Recipe("grass", 1.2, partial(lawn, colours=_FRESH)),
    "lawn-dry": Recipe("grass", 1.2, partial(lawn, colours=_DRY)),
    "gravel-grey": Recipe("gravel", 0.8, partial(gravel, colours=_PEBBLES, count=2600)),
    "gravel-warm": Recipe("gravel", 0.8, partial(gravel, colours=_WARM_PEBBLES, count=1800)),
    "paving-sandstone": Recipe("paving", 1.8, partial(paving, colours=_SANDSTONE, rows=4, joint=0.006)),
    "paving-concrete": Recipe("paving", 1.6, partial(paving, colours=_CONCRETE, rows=4, joint=0.004)),
    "setts-granite": Recipe("paving", 1.0, partial(setts, colours=_GRANITE, rows=10)),
    "asphalt-worn": Recipe("asphalt", 0.8, partial(asphalt, colour=(0.33, 0.33, 0.34))),
    "asphalt-dark": Recipe("asphalt", 0.8, partial(asphalt, colour=(0.24, 0.24, 0.25))),
    "sand-beach": Recipe("sand", 1.5, partial(sand, colours=((0.66, 0.55, 0.40), (0.88, 0.79, 0.63)), ripples=9)),
    "deck-larch": Recipe("deck", 1.1, partial(planks, colours=_OAK, rows=8, joint=0.006)),
    "deck-grey": Recipe("deck", 1.1, partial(planks, colours=_ASH, rows=8, joint=0.006)),
}  # fmt: skip


def make_texture(name: str, *, resolution: int = RESOLUTION) -> tuple[UInt8, UInt8, UInt8]:
    """Make a texture by name, the same for the same name, as uint8.

    Returns sRGB albedo (N, N, 3), normal map (N, N, 3), and roughness map (N, N) of mean `MEAN_ROUGHNESS`: hollows
    are rougher than what sticks out and is worn, and hands and feet leave broad traces.
    """
    recipe = TEXTURES[name]
    rng = generator_of(name)
    albedo, height = recipe.make(rng, resolution)
    relief = height - gaussian_filter(height, resolution / 30, mode="wrap")
    relief = np.clip(relief / max(float(relief.std()), 1e-12), -2.5, 2.5)
    rough = roughness_map(relief + 0.7 * noise(rng, resolution, scale=(3, 3), rough=1.4))
    return np.round(albedo * 255).astype(np.uint8), normal_map(height, metres=recipe.metres), rough


def normal_map(height: Float64, *, metres: float) -> UInt8:
    """Encode the normals of a periodic height field (N, M) [m], `metres` wide, as (N, M, 3) uint8, +Y up."""
    pixel = metres / height.shape[1]
    right = (np.roll(height, -1, axis=1) - np.roll(height, 1, axis=1)) / (2 * pixel)
    down = (np.roll(height, -1, axis=0) - np.roll(height, 1, axis=0)) / (2 * pixel)
    normals = np.stack([-right, down, np.ones_like(height)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.round((normals * 0.5 + 0.5) * 255).astype(np.uint8)


def height_from_albedo(albedo: UInt8, *, depth: float) -> Float64:
    """Guess a height field [m] from an (N, M, 3) picture: fine brightness detail, `depth` a deviation."""
    grey = albedo[..., :3].astype(np.float64).mean(axis=-1) / 255
    detail = gaussian_filter(grey, 0.7, mode="wrap") - gaussian_filter(grey, 24, mode="wrap")
    return np.clip(detail / max(float(detail.std()), 0.02), -2.5, 2.5) * depth
