"""Rigs: one to eight lights for a scene of any kind, in physical units and in balance with each other."""

from typing import get_args

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.photometry.radiometry import watts_from_photometric
from multilight.lights.rigs.custom import custom_rig
from multilight.lights.rigs.design import rig_design
from multilight.lights.rigs.outdoor import outdoor_rig
from multilight.lights.rigs.rooms import room_rig
from multilight.lights.rigs.studio import studio_rig
from multilight.lights.rigs.tabletop import LightKind, tabletop_rig
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.names import free_name
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec

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
    A model of a user's that gives off light is a light more.
    """
    return with_own_glow(_rig(streams, scene, library, kinds, lights), scene)


def with_own_glow(rig: LightRig, scene: SceneSpec) -> LightRig:
    """Add a light for each part whose maker lets it give off light, where the rig lets none of it shine."""
    lights, names = list(rig.lights), set(rig.names)
    lit = {(light.body, light.part) for light in lights if isinstance(light, EmissiveLight)}
    for body in scene.bodies:
        for part, material in enumerate(body.materials):
            if max(material.emission) > 0 and (body.name, part) not in lit:
                names.add(name := free_name(f"{body.name}_glow", names, otherwise="glow"))
                red, green, blue = (watts_from_photometric(value) for value in material.emission)
                lights.append(
                    EmissiveLight(
                        name=name, body=body.name, part=part, radiance=(red, green, blue),
                        texture=material.emission_texture,
                    )
                )  # fmt: skip
    return LightRig(lights=tuple(lights))


def _rig(
    streams: Streams, scene: SceneSpec, library: AssetLibrary, kinds: tuple[LightKind, ...], lights: tuple[int, int]
) -> LightRig:
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
