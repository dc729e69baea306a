"""The layout of the project's own stages: what is where, shared by the writer and the reader."""

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
