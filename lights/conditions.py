"""Named lighting conditions of a rig: which lights are on, how strong, in which colour, and an exposure offset."""

from itertools import combinations

import numpy as np

from multilight.lights.photometry.colour import gel_rgb, random_gel, temperature_to_rgb
from multilight.lights.photometry.radiometry import rgb_from_scalar
from multilight.lights.spec import LightingCondition, LightRig
from multilight.scenes.frozen import Rgb, triple
from multilight.scenes.streams import Rng

GAIN = 3.0
"""Gains are drawn between `1 / GAIN` and `GAIN`, evenly in their logarithm."""
EXPOSURE = 0.7
"""Exposure offsets are drawn within plus or minus this [EV]."""
WHITE: Rgb = (1.0, 1.0, 1.0)


def sample_conditions(rng: Rng, rig: LightRig, count: int = 12) -> tuple[LightingCondition, ...]:
    """Draw `count` different conditions: `all` with unit gains, each light alone, pairs, then random mixtures.

    Names say what is on: `all`, `key_only`, `key_and_fill`, `mix_1`. Gains, tints and exposure offsets vary in all
    but `all`; a metered exposure is added later, from the rendered layers.
    """
    names = rig.names
    conditions = [LightingCondition.unchanged(names)]
    if len(names) > 1:
        conditions += [_condition(rng, f"{name}_only", (name,)) for name in names]
    pairs = list(combinations(names, 2)) if len(names) > 2 else []
    order = rng.permutation(len(pairs))
    # Half of what is left goes to pairs, the other half to mixtures of everything.
    room = max(0, count - len(conditions))
    for i in order[: (room + 1) // 2]:
        first, second = pairs[int(i)]
        conditions.append(_condition(rng, f"{first}_and_{second}"[:40], pairs[int(i)]))
    for number in range(1, max(0, count - len(conditions)) + 1):
        conditions.append(random_condition(rng, rig, f"mix_{number}"))
    return tuple(conditions[:count])


def random_condition(rng: Rng, rig: LightRig, name: str) -> LightingCondition:
    """Draw one condition: every light is on with a chance of three in four, at least one is."""
    on = rng.random(len(rig.names)) < 0.75
    on[int(rng.integers(len(on)))] = True
    return _condition(rng, name, tuple(n for n, lit in zip(rig.names, on, strict=True) if lit))


def _condition(rng: Rng, name: str, lit: tuple[str, ...]) -> LightingCondition:
    """Draw gains for the lights that are on."""
    gains = {}
    for light in lit:
        gain = float(np.exp(rng.uniform(-np.log(GAIN), np.log(GAIN))))
        gains[light] = triple(gain * channel for channel in _tint(rng))
    return LightingCondition(name=name, gains=gains, exposure_ev=round(float(rng.uniform(-EXPOSURE, EXPOSURE)), 3))


def _tint(rng: Rng) -> Rgb:
    """Draw a change of colour at constant luminance of white: none, another colour temperature, or a pale gel."""
    kind = rng.random()
    if kind < 0.45:
        return WHITE
    if kind < 0.92:
        new, old = (temperature_to_rgb(1.0 / float(rng.uniform(1 / 8000, 1 / 3000))) for _ in range(2))
        return rgb_from_scalar(1.0, triple(np.clip(np.divide(new, np.maximum(old, 1e-3)), 0.1, 10.0)))
    return gel_rgb(random_gel(rng), float(rng.uniform(0.3, 0.8)))
