"""Lighting made on the fly: gains and colours of a condition, metered on what they light."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from multilight.datagen.storage.packed import TILE, PackedView
from multilight.lights.conditions import EXPOSURE, GAIN
from multilight.lights.display.tonemap import meter_ev
from multilight.lights.photometry.colour import GELS, gel_rgb, temperature_to_rgb
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import luminance

ONE, TWO = 0.2, 0.15
"""Probability of a single light, and of two; in all other conditions each is on with a probability of three in four."""
DARKEST = 1e-3
"""A condition whose mean is below this fraction of all lights' together would show noise."""
STEP = 8  # every eighth pixel of every eighth row is metered


@lru_cache(maxsize=1)
def tints() -> tuple[Float32, Float32]:
    """Return whites from 3000 to 8000 K in even steps of reciprocal temperature, (32, 3), and pale gels, (N, 3).

    Both linear Rec.709 of unit luminance; computed once, since each takes milliseconds.
    """
    whites = [temperature_to_rgb(float(1e6 / mired)) for mired in np.linspace(1e6 / 8000, 1e6 / 3000, 32)]
    gels = [gel_rgb(name, density) for name in sorted(GELS) for density in (0.3, 0.55, 0.8)]
    return np.array(whites, np.float32), np.array(gels, np.float32)


def draw_gains(rng: np.random.Generator, lights: int) -> Float32:
    """Draw a condition: (L, 3) float32 linear gains, zero where a light is off; at least one is on.

    Gains and colours are distributed as in `lights.conditions` where those are wild, whatever the dataset is, with more
    conditions of one and two lights.
    """
    drawn = rng.random()
    if drawn < ONE + TWO:
        lit = np.zeros(lights, bool)
        lit[rng.permutation(lights)[: 1 if drawn < ONE else 2]] = True
    else:
        lit = rng.random(lights) < 0.75
        lit[int(rng.integers(lights))] = True
    gains = np.exp(rng.uniform(-np.log(GAIN), np.log(GAIN), lights))[:, None] * _tints(rng, lights)
    return np.where(lit[:, None], gains, 0.0).astype(np.float32)


def _tints(rng: np.random.Generator, count: int) -> Float32:
    """Draw changes of colour of unit luminance, (count, 3): none, another colour temperature, or a pale gel."""
    whites, gels = tints()
    new, old = whites[rng.integers(len(whites), size=(2, count))]
    ratio = np.clip(new / np.maximum(old, 1e-3), 0.1, 10.0)
    ratio /= luminance(ratio)[:, None]
    kind = rng.random(count)[:, None]
    gel = gels[rng.integers(len(gels), size=count)]
    return np.where(kind < 0.45, 1.0, np.where(kind < 0.92, ratio, gel)).astype(np.float32)


def lit_conditions(rng: np.random.Generator, views: Sequence[PackedView], count: int) -> list[Float32]:
    """Draw conditions of a group of views and expose each as a camera would: (L, 3) float32 linear gains.

    One exposure for the group, metered on all its views, plus an offset. Lights that do not reach what the views show
    are joined by all others.
    """
    thin = [_thinned(view) for view in views]
    return [_exposed(rng, draw_gains(rng, len(views[0].lights)), thin) for _ in range(count)]


def _exposed(rng: np.random.Generator, gains: Float32, thin: Sequence[Float32]) -> Float32:
    offset = float(rng.uniform(-EXPOSURE, EXPOSURE))
    picture = _mixed(thin, gains)
    if picture.mean() < DARKEST * _mixed(thin, np.ones_like(gains)).mean():
        gains = np.maximum(gains, 1.0)
        picture = _mixed(thin, gains)
    return (gains * 2.0 ** (offset + meter_ev(picture))).astype(np.float32)


def _mixed(thin: Sequence[Float32], gains: Float32) -> Float32:
    """Mix thinned-out layers of all views, each (L, 3, N), into one picture of pixels, (1, N, 3)."""
    return np.concatenate([np.einsum("lcp,lc->pc", layers, gains) for layers in thin])[None]


def _thinned(view: PackedView) -> Float32:
    """Return every eighth pixel of every eighth row of the layers of `all`: (L, 3, N) float32."""
    height, width = view.z_depth.shape
    layers = view.all[..., STEP // 2 :: STEP, STEP // 2 :: STEP]  # (L, T, 3, 2, 2)
    y, x = (
        np.arange(STEP // 2, TILE * -(-length // TILE), STEP).reshape(-1, TILE // STEP) for length in (height, width)
    )
    inside = (y < height)[:, None, :, None] & (x < width)[None, :, None, :]
    return layers.astype(np.float32).transpose(0, 2, 1, 3, 4)[:, :, inside.reshape(-1, *inside.shape[2:])]
