"""The lights of a background scene, as its file has them."""

import math
from typing import Any, get_args

import numpy as np

from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.photometry.radiometry import watts_from_photometric
from multilight.lights.rigs.design import RigDesign
from multilight.lights.rigs.tabletop import LightKind, glow_of, tabletop_rig
from multilight.lights.spec import (
    SUN_ANGLE,
    WIDEST_SUN,
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.formats.imported import FoundLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import triple
from multilight.scenes.names import free_name
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import SceneSpec

PHOTOMETRIC = ("cd", "lx", "nit")
WIDEST_CONE = 1.49
"""Half angle [rad] that wider cones of a file are cut to: just within what a spot may have."""
MOST = 16
"""Layers that a background's lights may take: of more, those that give most at the still life."""
DARK = 5.0
"""Illuminance [lx] at the still life below which a background counts as unlit there."""


def custom_rig(rng: Rng, meter: LightMeter, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Make a rig of the background's own lights, and of the object that is meant to glow.

    Where the file has no light, or none that reaches the objects, lamps are hung as about a table.
    """
    own = list(custom_lights(meter.scene, meter.library))
    level = np.array([meter.dome_irradiance(light) for light in own])
    if not len(own) or level.sum() < watts_from_photometric(DARK):
        return tabletop_rig(rng, meter, design, kinds=get_args(LightKind), lights=lights)
    kept = sorted(np.argsort(-level, kind="stable")[:MOST])
    rig = [own[int(i)] for i in kept]
    glow = glow_of(rng, meter)
    if glow is not None and glow.unit:
        strength = float(level.max()) * glow.strength / glow.unit
        name = free_name("glow", {light.name for light in rig}, otherwise="light")
        rig.append(glow.light.scaled(strength).model_copy(update={"name": name}))
    return LightRig(lights=tuple(rig))


def custom_lights(scene: SceneSpec, library: AssetLibrary) -> tuple[Light, ...]:
    """Return the lights of the library's background in the scene's world; empty where the file has none.

    Photometric amounts become radiometric by the project's one luminous efficacy. Lights without power are left out.
    """
    if library.background is None:
        return ()
    world_from_file = _world_from_file(scene, library)
    names: set[str] = set()
    lights = []
    for found in library.background.lights:
        if max(found.amount) > 0:
            lights.append(light_from_found(found, world_from_file, free_name(found.name, names, otherwise="light")))
            names.add(lights[-1].name)
    return tuple(lights)


def _world_from_file(scene: SceneSpec, library: AssetLibrary) -> Float64:
    """Return the pose (4, 4) that takes the file to the scene: all of the background is moved as one."""
    assert library.background is not None
    piece = library.background.pieces[0]
    placed = np.array(scene.body(piece.name).world_from_body)
    return np.asarray(placed @ np.linalg.inv(np.array(piece.world_from_body)))


def light_from_found(found: FoundLight, world_from_file: Float64, name: str) -> Light:
    """Translate one light into the scene's world; `world_from_file` (4, 4) is rigid."""
    pose = world_from_file @ np.array(found.pose)
    position, direction = triple(pose[:3, 3]), triple(-pose[:3, 2])
    amount = triple(map(watts_from_photometric, found.amount)) if found.unit in PHOTOMETRIC else found.amount
    about: dict[str, Any] = {"name": name}
    match found.kind:
        case "point":
            shape = {} if found.profile is None else {"profile": found.profile, "direction": direction}
            return PointLight(**about, position=position, intensity=amount, radius=found.radius, **shape)
        case "spot":
            return SpotLight(
                **about,
                position=position,
                direction=direction,
                intensity=amount,
                half_angle=min(found.half_angle, WIDEST_CONE),
                blend=found.blend,
                radius=found.radius,
            )
        case "sun":
            angle = min(found.angle, WIDEST_SUN) if found.angle > 0 else SUN_ANGLE
            return SunLight(**about, direction=direction, irradiance=amount, angle=angle)
        case "area":
            return AreaLight(
                **about,
                shape="disk" if found.ellipse else "rectangle",
                width=found.width,
                height=found.height,
                world_from_light=matrix4(pose),
                radiance=amount,
            )
        case "environment":
            rotation = found.rotation + math.atan2(world_from_file[1, 0], world_from_file[0, 0])
            asset = None if found.map is None else f"background/{found.map}"
            return EnvironmentLight(**about, map=asset, radiance=amount, rotation=rotation % (2 * math.pi))
        case "emissive":
            assert found.node is not None
            return EmissiveLight(**about, body=found.node, part=found.part, radiance=amount, texture=found.texture)
