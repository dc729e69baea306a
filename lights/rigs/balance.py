"""The strengths of a rig's lights against each other: a key-to-fill ratio in a plausible light level."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.photometry.radiometry import photometric_from_watts, watts_from_photometric
from multilight.lights.spec import AreaLight, Light, PointLight, SpotLight

LUMENS = (15.0, 40_000.0)
"""Luminous flux of a key lamp [lm]: from a candle to a large studio head."""
FAINTEST = 1 / 60
"""No light gives less of the key's illuminance than this: its layer would be dead."""
NOTHING = 1e-9
"""Irradiance [W/m²] of a light of any strength that does not reach the scene."""

SHOWN, DIMMEST = 0.1, 15.0
"""A thing that glows gives at least this part of the key's illuminance about itself: who lights a candle dims the
room. But the key aims at no less than `DIMMEST` [lx]."""


@dataclass(frozen=True)
class LightRole:
    """A light of any strength and the part it should play.

    `strength` is its weight among the fill lights, or, where `unit` is given, its level against the key's. `unit` is
    then what it gives [W/m²] where it counts, such as on the backdrop. A `fixed` light keeps its own power: `unit` is
    what it gives about itself, and the key is dimmed until that counts for `SHOWN` of it.
    """

    light: Light
    strength: float = 1.0
    unit: float | None = None
    fixed: bool = False


def balance(
    key: Light, others: Sequence[LightRole], meter: LightMeter, *, key_to_fill: float, lux: float
) -> list[Light]:
    """Give all lights of a rig their strengths; a lamp comes in with 1 lm.

    At the scene's centre, as a dome meter reads it, the key gives `lux` (a lamp only what `LUMENS` allow) and the
    fill lights together `1 / key_to_fill` of that. What does not reach the centre is left out.
    """
    unit = meter.dome_irradiance(key)
    about = [photometric_from_watts(role.unit) for role in others if role.fixed and role.unit is not None]
    lux = min([lux, *(max(glow / SHOWN, DIMMEST) for glow in about)])
    factor = watts_from_photometric(lux) / max(unit, NOTHING)
    if isinstance(key, PointLight | SpotLight | AreaLight):
        factor = float(np.clip(factor, *LUMENS))
    level = factor * unit
    fills = {i: meter.dome_irradiance(role.light) for i, role in enumerate(others) if role.unit is None}
    total = sum(others[i].strength for i, given in fills.items() if given > NOTHING)
    result = [key.scaled(factor)]
    for i, role in enumerate(others):
        if role.fixed:
            result.append(role.light)
        elif role.unit is not None:
            result.append(role.light.scaled(level * role.strength / max(role.unit, NOTHING)))
        elif fills[i] > NOTHING:
            wanted = max(role.strength / total / key_to_fill, FAINTEST)
            result.append(role.light.scaled(level * wanted / fills[i]))
    return result
