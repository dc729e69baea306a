"""The layout of the project's own stages: what is where, shared by the writer and the reader."""

from typing import Any

from multilight.scenes.assets.formats.usd.names import OWN
from multilight.scenes.cameras.pinhole import SENSOR_MM

WORLD = "/world"
BODIES, LIGHTS, CAMERAS, MATERIALS = (f"{WORLD}/{name}" for name in ("bodies", "lights", "cameras", "materials"))
RENDER = "/render"
SCHEMA = 1
"""Version of this layout."""
SENSOR = SENSOR_MM / 100
"""Width of the sensor in tenths of a metre, USD's unit for apertures: 36 mm."""


def own(name: str) -> str:
    """Return the name of an attribute of the project's own."""
    return f"{OWN}:{name}"


def get_own(prim: Any, name: str) -> Any:
    """Return the value of an attribute of the project's own; None where the prim has none."""
    return prim.GetAttribute(own(name)).Get() if prim.HasAttribute(own(name)) else None


def set_own(prim: Any, name: str, kind: Any, value: Any) -> None:
    """Write an attribute of the project's own, of a type of `Sdf.ValueTypeNames`."""
    prim.CreateAttribute(own(name), kind, custom=True).Set(value)
