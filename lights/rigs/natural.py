"""Lighting as people photograph it: white light, from a warm bulb's to an overcast sky's."""

import numpy as np

from multilight.lights.photometry.colour import temperature_to_rgb
from multilight.lights.photometry.radiometry import rgb_from_scalar
from multilight.lights.spec import EmissiveLight, Light, LightRig

WHITES = (2500.0, 8000.0)
"""Colour temperatures [K] of light that passes for white."""


def natural_rig(rig: LightRig) -> LightRig:
    """Return a rig whose lights are white, as bright as before; what glows in the scene keeps its own colour.

    Gels go, and colour temperatures are held within `WHITES`.
    """
    return LightRig(lights=tuple(map(_white, rig.lights)))


def _white(light: Light) -> Light:
    if isinstance(light, EmissiveLight) or light.colour_temperature is None:
        return light
    kelvin = float(np.clip(light.colour_temperature, *WHITES))
    if light.gel is None and kelvin == light.colour_temperature:
        return light
    colour = rgb_from_scalar(light.grey, temperature_to_rgb(kelvin))
    return light.model_copy(update={light.quantity: colour, "gel": None, "colour_temperature": kelvin})
