"""Named lighting conditions of a rig: which lights are on, how strong, in which colour, and an exposure offset.

They are such as people photograph: white light of another temperature, a gel now and then on one lamp of several.
Where they are `wild`, any light may be behind a gel, alone too.
"""

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np

from multilight.lights.photometry.colour import gel_rgb, random_gel, temperature_to_rgb
from multilight.lights.photometry.radiometry import rgb_from_scalar
from multilight.lights.rigs.natural import WHITES
from multilight.lights.spec import Light, LightingCondition, LightRig
from multilight.scenes.frozen import Rgb, triple
from multilight.scenes.random_streams import Rng

GAIN = 3.0
"""Gains are drawn between `1 / GAIN` and `GAIN`, evenly in their logarithm."""
EXPOSURE = 0.7
"""Exposure offsets are drawn within plus or minus this [EV]."""
WHITE: Rgb = (1.0, 1.0, 1.0)
GELLED = 1 / 12
"""Probability that one lamp of several is behind a gel, where conditions are not wild."""
DAYLIGHT = 6504.0  # K, of light that states no temperature
MIRED = (190.0, 45.0)
"""Mean and standard deviation of the reciprocal temperatures [1/MK] that white light is changed to: about 5300 K."""


def sample_conditions(rng: Rng, rig: LightRig, count: int = 12, *, wild: bool = False) -> tuple[LightingCondition, ...]:
    """Draw `count` different conditions: `all` with unit gains, each light alone, pairs, then random mixtures.

    Names say what is on: `all`, `key_only`, `key_and_fill`, `mix_1`. Gains, tints and exposure offsets vary in all
    but `all`; a metered exposure is added later, from the rendered layers. A light behind a gel is alone only where
    conditions are `wild`.
    """
    lights = rig.lights
    conditions = [LightingCondition.unchanged(rig.names)]
    if len(lights) > 1:
        alone = [light for light in lights if wild or light.gel is None]
        conditions += [_condition(rng, f"{light.name}_only", (light,), wild=wild) for light in alone]
    pairs = list(combinations(lights, 2)) if len(lights) > 2 else []
    order = rng.permutation(len(pairs))
    # Half of what is left goes to pairs, the other half to mixtures of everything.
    room = max(0, count - len(conditions))
    for i in order[: (room + 1) // 2]:
        first, second = pairs[int(i)]
        conditions.append(_condition(rng, f"{first.name}_and_{second.name}"[:40], (first, second), wild=wild))
    for number in range(1, max(0, count - len(conditions)) + 1):
        conditions.append(random_condition(rng, rig, f"mix_{number}", wild=wild))
    return tuple(conditions[:count])


def random_condition(rng: Rng, rig: LightRig, name: str, *, wild: bool = False) -> LightingCondition:
    """Draw one condition: every light is on with a probability of three in four, at least one is."""
    on = rng.random(len(rig.names)) < 0.75
    on[int(rng.integers(len(on)))] = True
    return _condition(rng, name, [light for light, lit in zip(rig.lights, on, strict=True) if lit], wild=wild)


def _condition(rng: Rng, name: str, lit: Sequence[Light], *, wild: bool) -> LightingCondition:
    """Draw gains for the lights that are on."""
    gains = {}
    tint: Callable[[Rng, Light], Rgb] = _wild_tint if wild else _white_tint
    for light in lit:
        gain = float(np.exp(rng.uniform(-np.log(GAIN), np.log(GAIN))))
        gains[light.name] = triple(gain * channel for channel in tint(rng, light))
    if not wild and len(lit) > 1 and rng.random() < GELLED:
        name_of_one = lit[int(rng.integers(len(lit)))].name
        gains[name_of_one] = triple(np.multiply(gains[name_of_one], _pale_gel(rng)))
    return LightingCondition(name=name, gains=gains, exposure_ev=round(float(rng.uniform(-EXPOSURE, EXPOSURE)), 3))


def _white_tint(rng: Rng, light: Light) -> Rgb:
    """Draw a change of colour at constant luminance of white: none, or to another temperature that white light has.

    What shines in a colour of its own keeps it.
    """
    if light.gel is not None or rng.random() < 0.5:
        return WHITE
    new = float(np.clip(1e6 / max(rng.normal(*MIRED), 1.0), *WHITES))
    own = light.colour_temperature or DAYLIGHT
    return _ratio(temperature_to_rgb(new), temperature_to_rgb(own))


def _wild_tint(rng: Rng, light: Light) -> Rgb:
    """Draw a change of colour at constant luminance of white: none, another colour temperature, or a pale gel."""
    kind = rng.random()
    if kind < 0.45:
        return WHITE
    if kind < 0.92:
        new, old = (temperature_to_rgb(1.0 / float(rng.uniform(1 / 8000, 1 / 3000))) for _ in range(2))
        return _ratio(new, old)
    return _pale_gel(rng)


def _ratio(new: Rgb, old: Rgb) -> Rgb:
    return rgb_from_scalar(1.0, triple(np.clip(np.divide(new, np.maximum(old, 1e-3)), 0.1, 10.0)))


def _pale_gel(rng: Rng) -> Rgb:
    return gel_rgb(random_gel(rng), float(rng.uniform(0.3, 0.8)))
