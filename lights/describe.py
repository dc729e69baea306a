"""What a light is, in a few words: its kind, where it is, its colour."""

import math

from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.frozen import Vector3


def describe(light: Light) -> str:
    """Return a light's kind, place (world axes, metres) and colour: `spot at (0.31, -0.44, 1.20) m, 3200 K`."""
    return f"{_place(light)}, {_colour(light)}"


def _place(light: Light) -> str:
    match light:
        case EnvironmentLight():
            return f"environment {light.map or 'of one colour'}, all round"
        case SunLight():
            x, y, z = light.direction
            elevation = math.degrees(math.atan2(-z, math.hypot(x, y)))
            return f"sun {elevation:.0f} deg high, azimuth {math.degrees(math.atan2(-y, -x)):.0f} deg"
        case PointLight() | SpotLight():
            return f"{light.kind} at {_point(light.position)}"
        case AreaLight():
            return f"area {light.width:.2f} x {light.height:.2f} m at {_point(light.position)}"
        case EmissiveLight():
            return f"emissive, part {light.part} of body {light.body}"


def _point(position: Vector3) -> str:
    return f"({', '.join(f'{value:.2f}' for value in position)}) m"


def _colour(light: Light) -> str:
    if light.gel is not None:
        return f"gel {light.gel}"
    if light.colour_temperature is not None:
        return f"{light.colour_temperature:.0f} K"
    peak = max(light.amount)
    if min(light.amount) == peak:
        return "of its map's colour" if isinstance(light, EnvironmentLight) and light.map else "white"
    return "red {:.2f} green {:.2f} blue {:.2f}".format(*(value / peak for value in light.amount))
