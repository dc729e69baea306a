"""Rigs: one to eight lights for a scene of any kind, in physical units and in balance with each other."""

from typing import get_args

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.rigs.custom import custom_rig
from multilight.lights.rigs.design import rig_design
from multilight.lights.rigs.outdoor import outdoor_rig
from multilight.lights.rigs.rooms import room_rig
from multilight.lights.rigs.studio import studio_rig
from multilight.lights.rigs.tabletop import LightKind, tabletop_rig
from multilight.lights.spec import LightRig
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import SceneSpec
from multilight.scenes.streams import Streams

ALL_KINDS: tuple[LightKind, ...] = get_args(LightKind)
SPHERES_KINDS: tuple[LightKind, ...] = ("environment", "sun", "point", "spot")
"""What the closed-form renderer draws; the environment of a scene of spheres is uniform."""


def sample_rig(
    streams: Streams,
    scene: SceneSpec,
    library: AssetLibrary,
    *,
    kinds: tuple[LightKind, ...] = ALL_KINDS,
    lights: tuple[int, int] = (1, 8),
) -> LightRig:
    """Draw the rig of a scene: `lights` (fewest, most) lights, the key first; the same streams give the same rig.

    The scene's kind says which preset: a room's own fixtures, a background's lights, a studio, sun and sky, or lamps
    about a table. Only the last keeps to `kinds`, and raises `ValueError` where those hold no lamp (point, spot, area).
    """
    if scene.kind == "room":
        return room_rig(streams, scene, library, lights=lights)
    rng, meter, design = streams("rig"), LightMeter.of(scene, library), rig_design(streams)
    match scene.kind:
        case "studio":
            return studio_rig(rng, meter, design, lights=lights)
        case "custom":
            return custom_rig(rng, meter, design, lights=lights)
        case "outdoor":
            return outdoor_rig(rng, meter, design, lights=lights)
        case _:
            return tabletop_rig(rng, meter, design, kinds=kinds, lights=lights)
