"""The lights of a background scene, as its file has them."""

import math
import re
from typing import Any, get_args

import numpy as np

from multilight.lights.photometry.irradiance import StillLife
from multilight.lights.photometry.radiometry import watts_from_photometric
from multilight.lights.rigs.design import RigDesign
from multilight.lights.rigs.tabletop import LightKind, glow_share, tabletop_rig
from multilight.lights.spec import (
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
from multilight.scenes.assets.formats.scene_file import FoundLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import matrix4
from multilight.scenes.frozen import Rgb, Vector3
from multilight.scenes.spec import SceneSpec

PHOTOMETRIC = ("cd", "lx", "nit")
SUN_ANGLE = 0.00918
"""Diameter of the sun's disc [rad], for files that give none."""
MOST_ANGLE = 0.5

MOST = 16
"""Layers that a background's lights may take: of more, those that give most at the still life."""
DARK = 5.0
"""Illuminance [lx] at the still life below which a background counts as unlit there."""


def custom_rig(rng: np.random.Generator, place: StillLife, design: RigDesign, *, lights: tuple[int, int]) -> LightRig:
    """Make a rig of the background's own lights, and of the object that is meant to glow.

    Where the file has no light, or none that reaches the objects, lamps are hung as about a table.
    """
    own = list(custom_lights(place.scene, place.library))
    level = np.array([place.dome_irradiance(light) for light in own])
    if not len(own) or level.sum() < watts_from_photometric(DARK):
        return tabletop_rig(rng, place, design, kinds=get_args(LightKind), lights=lights)
    kept = sorted(np.argsort(-level, kind="stable")[:MOST])
    rig = [own[int(i)] for i in kept]
    glow = glow_share(rng, place)
    if glow is not None and glow.unit:
        strength = float(level.max()) * glow.strength / glow.unit
        rig.append(glow.light.scaled(strength).model_copy(update={"name": _name("glow", {r.name for r in rig})}))
    return LightRig(lights=tuple(rig))


def custom_lights(scene: SceneSpec, library: AssetLibrary) -> tuple[Light, ...]:
    """Return the lights of the library's background in the scene's world; empty where the file has none.

    Photometric amounts become radiometric by the project's one luminous efficacy. Lights without power are left out.
    """
    if library.background is None:
        return ()
    turn = _world_from_file(scene, library)
    names: set[str] = set()
    lights = []
    for found in library.background.lights:
        if max(found.amount) > 0:
            lights.append(light_from_found(found, turn, _name(found.name, names)))
            names.add(lights[-1].name)
    return tuple(lights)


def _world_from_file(scene: SceneSpec, library: AssetLibrary) -> Float64:
    """Return where the scene was turned to, (4, 4): all of the background is moved as one."""
    assert library.background is not None
    piece = library.background.pieces[0]
    placed = np.array(scene.body(piece.name).world_from_body)
    return np.asarray(placed @ np.linalg.inv(np.array(piece.world_from_body)))


def _name(text: str, taken: set[str]) -> str:
    plain = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")[:30]
    plain = plain if plain[:1].isalpha() else f"light_{plain}".rstrip("_")
    name, number = plain, 2
    while name in taken:
        name, number = f"{plain}_{number}", number + 1
    return name


def _radiometric(found: FoundLight) -> Rgb:
    if found.unit not in PHOTOMETRIC:
        return found.amount
    red, green, blue = (watts_from_photometric(value) for value in found.amount)
    return red, green, blue


def light_from_found(found: FoundLight, turn: Float64, name: str) -> Light:
    """Translate one light into the scene's world."""
    pose = turn @ np.array(found.pose)
    position, direction = _vector(pose[:3, 3]), _vector(-pose[:3, 2])
    amount = _radiometric(found)
    about: dict[str, Any] = {"name": name}
    match found.kind:
        case "point":
            return PointLight(**about, position=position, intensity=amount, radius=found.radius)
        case "spot":
            return SpotLight(
                **about,
                position=position,
                direction=direction,
                intensity=amount,
                half_angle=min(found.half_angle, 1.49),
                blend=found.blend,
                radius=found.radius,
            )
        case "sun":
            angle = min(found.angle, MOST_ANGLE) if found.angle > 0 else SUN_ANGLE
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
            rotation = found.rotation + math.atan2(turn[1, 0], turn[0, 0])
            asset = None if found.map is None else f"background/{found.map}"
            return EnvironmentLight(**about, map=asset, radiance=amount, rotation=rotation % (2 * math.pi))
        case "emissive":
            assert found.node is not None
            return EmissiveLight(**about, body=found.node, part=found.part, radiance=amount, texture=found.texture)


def _vector(values: Float64) -> Vector3:
    return float(values[0]), float(values[1]), float(values[2])
