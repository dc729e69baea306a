"""Lighting made on the fly: gains and colours of a condition, metered on what they light."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from multilight.datagen.storage.packed import TILE, PackedView
from multilight.lights.display.tonemap import meter_ev
from multilight.lights.photometry.colour import GELS, gel_rgb, temperature_to_rgb
from multilight.lights.rigs.natural import WHITES
from multilight.lights.sample_conditions import EXPOSURE, GAIN, GELLED, MIRED
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.colour import luminance

ONE, TWO = 0.2, 0.15
"""Probability of a single light, and of two; in all other conditions each is on with a probability of three in four."""
DARKEST = 1e-3
"""A condition whose mean is below this fraction of all lights' together would show noise."""
STEP = 8  # every eighth pixel of every eighth row is metered


@lru_cache(maxsize=1)
def tints() -> tuple[Float32, Float32, Float32]:
    """Return white light's temperatures [K] from 2500 to 8000, even in their reciprocals, (T,), their colours (T, 3),
    and pale gels, (G, 3).

    Colours are linear Rec.709 of unit luminance; computed once, since each takes milliseconds.
    """
    kelvin = 1e6 / np.linspace(1e6 / WHITES[1], 1e6 / WHITES[0], 48)
    whites = [temperature_to_rgb(float(each)) for each in kelvin]
    gels = [gel_rgb(name, density) for name in sorted(GELS) for density in (0.3, 0.55, 0.8)]
    return kelvin.astype(np.float32), np.array(whites, np.float32), np.array(gels, np.float32)


def draw_gains(rng: np.random.Generator, temperature: Float32, *, wild: bool) -> Float32:
    """Draw a condition: (L, 3) float32 linear gains, zero where a light is off; at least one is on.

    `temperature` (L,) is that of each light's own colour [K], 0 where it shines in a colour that is no white. Gains and
    colours are distributed as in `lights.conditions`, with more conditions of one and two lights.
    """
    lights, drawn = len(temperature), rng.random()
    if drawn < ONE + TWO:
        lit = np.zeros(lights, bool)
        lit[rng.permutation(lights)[: 1 if drawn < ONE else 2]] = True
    else:
        lit = rng.random(lights) < 0.75
        lit[int(rng.integers(lights))] = True
    white = np.flatnonzero(temperature > 0.0)
    if not wild and len(white) and not lit[white].any():  # light in a colour of its own would flood the picture
        lit[rng.choice(white)] = True
    colours = _wild_tints(rng, lights) if wild else _white_tints(rng, temperature, lit)
    gains = np.exp(rng.uniform(-np.log(GAIN), np.log(GAIN), lights))[:, None] * colours
    return np.where(lit[:, None], gains, 0.0).astype(np.float32)


def _white_tints(rng: np.random.Generator, temperature: Float32, lit: Mask) -> Float32:
    """Draw changes of colour as people photograph them, (L, 3): none, another white, now and then a gel on one lamp."""
    kelvin, whites, gels = tints()
    new = np.clip(1e6 / np.maximum(rng.normal(*MIRED, len(temperature)), 1.0), *WHITES)
    new_white, old_white = (whites[np.abs(kelvin - each[:, None]).argmin(axis=1)] for each in (new, temperature))
    kept = (rng.random(len(temperature)) < 0.5) | (temperature == 0.0)
    found = np.where(kept[:, None], 1.0, _ratio(new_white, old_white))
    if lit.sum() > 1 and rng.random() < GELLED:
        found[rng.choice(np.flatnonzero(lit))] *= gels[rng.integers(len(gels))]
    return found.astype(np.float32)


def _wild_tints(rng: np.random.Generator, count: int) -> Float32:
    """Draw changes of colour of unit luminance, (count, 3): none, another colour temperature, or a pale gel."""
    _, whites, gels = tints()
    new, old = whites[rng.integers(len(whites), size=(2, count))]
    kind = rng.random(count)[:, None]
    gel = gels[rng.integers(len(gels), size=count)]
    return np.where(kind < 0.45, 1.0, np.where(kind < 0.92, _ratio(new, old), gel)).astype(np.float32)


def _ratio(new: Float32, old: Float32) -> Float32:
    ratio = np.clip(new / np.maximum(old, 1e-3), 0.1, 10.0)
    return np.asarray(ratio / luminance(ratio)[:, None])


def lit_conditions(
    rng: np.random.Generator, views: Sequence[PackedView], count: int, temperature: Float32, *, wild: bool
) -> list[Float32]:
    """Draw conditions of a group of views and expose each as a camera would: (L, 3) float32 linear gains.

    One exposure for the group, metered on all its views, plus an offset. Lights that do not reach what the views show
    are joined by all others. `temperature` (L,) and `wild` are as in `draw_gains`.
    """
    thin = [_thinned(view) for view in views]
    return [_exposed(rng, draw_gains(rng, temperature, wild=wild), thin) for _ in range(count)]


def light_fractions(views: Sequence[PackedView], gains: Float32) -> Float32:
    """Return the fraction of the views' mean luminance that comes from each light under gains (L, 3): (L,) float32."""
    layers = np.concatenate([_thinned(view) for view in views], axis=2).mean(axis=2, dtype=np.float64)
    found = luminance(layers * gains)
    return (found / max(found.sum(), 1e-12)).astype(np.float32)


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
