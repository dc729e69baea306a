"""The strengths of a rig's lights against each other: a key-to-fill ratio in a plausible light level."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.lights.photometry.irradiance import StillLife
from multilight.lights.photometry.radiometry import photometric_from_watts, watts_from_photometric
from multilight.lights.spec import AreaLight, Light, PointLight, SpotLight

LUMENS = (15.0, 40_000.0)
"""Luminous flux of a key lamp [lm]: from a candle to a large studio head."""
FAINTEST = 1 / 60
"""No light gives less of the key's illuminance than this: its layer would be dead."""

SHOWN, DIMMEST = 0.1, 15.0
"""A thing that glows gives at least this part of the key's illuminance about itself: who lights a candle dims the
room. But the key aims at no less than `DIMMEST` [lx]."""


@dataclass(frozen=True)
class Share:
    """A light of any strength and the part it should play.

    `strength` is its weight among the fill lights, or, where `unit` is given, its level against the key's. `unit` is
    then what it gives [W/m²] where it counts, such as on the backdrop. A `fixed` light keeps its own power: `unit` is
    what it gives about itself, and the key is dimmed until that counts for `SHOWN` of it.
    """

    light: Light
    strength: float = 1.0
    unit: float | None = None
    fixed: bool = False


def balance(key: Light, others: Sequence[Share], place: StillLife, *, key_to_fill: float, lux: float) -> list[Light]:
    """Give all lights of a rig their strengths; a lamp comes in with 1 lm.

    At the scene's centre, as a dome meter reads it, the key gives `lux` (a lamp only what `LUMENS` allow) and the
    fill lights together `1 / key_to_fill` of that. What does not reach the centre is left out.
    """
    unit = place.dome_irradiance(key)
    about = [photometric_from_watts(share.unit) for share in others if share.fixed and share.unit is not None]
    lux = min([lux, *(max(glow / SHOWN, DIMMEST) for glow in about)])
    factor = watts_from_photometric(lux) / max(unit, 1e-9)
    if isinstance(key, PointLight | SpotLight | AreaLight):
        factor = float(np.clip(factor, *LUMENS))
    level = factor * unit
    fills = [(share, place.dome_irradiance(share.light)) for share in others if share.unit is None]
    fills = [(share, unit) for share, unit in fills if unit > 1e-9]
    total = sum(share.strength for share, _ in fills)
    result = [key.scaled(factor)]
    for share in others:
        if share.fixed:
            result.append(share.light)
            continue
        if share.unit is not None:
            result.append(share.light.scaled(level * share.strength / max(share.unit, 1e-9)))
            continue
        for fill, unit in fills:
            if fill is share:
                wanted = max(share.strength / total / key_to_fill, FAINTEST)
                result.append(share.light.scaled(level * wanted / unit))
    return result
