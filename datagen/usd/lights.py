"""`lights.spec` lights as UsdLux: luminances [cd/m²], illuminances [lx]."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, UsdGeom, UsdLux

from multilight.datagen.usd.files import Files
from multilight.datagen.usd.gains import Strength, lamp_strength, photometric
from multilight.datagen.usd.layout import own, set_own
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.assets.formats.usd.names import IMAGE
from multilight.scenes.frozen import Vector3
from multilight.scenes.poses import pose_of

_TYPES = Sdf.ValueTypeNames
POINT_RADIUS = 0.001
"""Radius [m] that a light without size has for renderers that know no points; its power does not depend on it."""


def add_light(stage: Any, path: str, light: Light, files: Files) -> Strength:
    """Write a light other than an emissive one, its strength left to the variants; return what they set."""
    match light:
        case EnvironmentLight():
            made = _dome(stage, path, light, files)
        case SunLight():
            made = UsdLux.DistantLight.Define(stage, path)
            made.CreateAngleAttr(math.degrees(light.angle))
            made.CreateNormalizeAttr(True)
            _place(made, (0.0, 0.0, 0.0), spot_frame(light.direction))
        case AreaLight():
            made = _area(stage, path, light)
        case PointLight():
            made = _sphere(stage, path, light)
            _place(made, light.position, spot_frame(light.direction))
            if light.profile is not None:
                _profile(made, light.profile, files)
        case SpotLight():
            made = _sphere(stage, path, light)
            _place(made, light.position, spot_frame(light.direction, light.roll))
            _cone(made, light, files)
        case EmissiveLight():
            raise TypeError(f"light {light.name!r} is a material, not a UsdLux light")
    _describe(made.GetPrim(), light)
    return lamp_strength(light.name, made, photometric(light.amount) * _per_luminance(light))


def add_glow(stage: Any, path: str, light: EmissiveLight, part: str) -> None:
    """Write the place of an emissive light among the others: it points to the part whose material shines."""
    prim = UsdGeom.Scope.Define(stage, path).GetPrim()
    prim.CreateRelationship(own("part"), custom=True).SetTargets([part])
    _describe(prim, light)


def _per_luminance(light: Light) -> float:
    """Return what takes a sphere light's intensity [cd] to UsdLux: its luminance, or with `normalize` its flux / pi."""
    if not isinstance(light, PointLight | SpotLight):
        return 1.0
    return 4.0 if light.radius == 0 else 1.0 / (math.pi * light.radius**2)


def _describe(prim: Any, light: Light) -> None:
    if light.colour_temperature is not None:
        set_own(prim, "colourTemperature", _TYPES.Double, light.colour_temperature)
    if light.gel is not None:
        set_own(prim, "gel", _TYPES.String, light.gel)


def _dome(stage: Any, path: str, light: EnvironmentLight, files: Files) -> Any:
    """Write a dome: its pole (+Y) upright, its centre (+Z) where the map's centre column looks."""
    made = UsdLux.DomeLight.Define(stage, path)
    x, y = math.cos(light.rotation), math.sin(light.rotation)
    left, pole, centre = (-y, x, 0.0), (0.0, 0.0, 1.0), (x, y, 0.0)
    _place(made, (0.0, 0.0, 0.0), np.stack([left, pole, centre], axis=1))
    if light.map is not None:
        made.CreateTextureFileAttr(files.environment(light.map))
        made.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
        made.GetPrim().CreateAttribute(IMAGE, _TYPES.String, custom=True).Set(light.map)
    return made


def _area(stage: Any, path: str, light: AreaLight) -> Any:
    pose = np.array(light.world_from_light)
    if light.shape == "rectangle":
        made = UsdLux.RectLight.Define(stage, path)
        made.CreateWidthAttr(light.width)
        made.CreateHeightAttr(light.height)
        stretch = 1.0
    else:
        made = UsdLux.DiskLight.Define(stage, path)
        made.CreateRadiusAttr(light.width / 2)
        stretch = light.height / light.width
    _place(made, pose[:3, 3], pose[:3, :3] * [1.0, stretch, 1.0])
    return made


def _sphere(stage: Any, path: str, light: PointLight | SpotLight) -> Any:
    made = UsdLux.SphereLight.Define(stage, path)
    made.CreateRadiusAttr(light.radius or POINT_RADIUS)
    if light.radius == 0:
        made.CreateTreatAsPointAttr(True)
        made.CreateNormalizeAttr(True)
    return made


def _cone(made: Any, light: SpotLight, files: Files) -> None:
    """Write the cone; a gobo, for which UsdLux has no word, stands beside it."""
    shaping = UsdLux.ShapingAPI.Apply(made.GetPrim())
    shaping.CreateShapingConeAngleAttr(math.degrees(light.half_angle))
    shaping.CreateShapingConeSoftnessAttr(light.blend)
    if light.gobo is not None:
        set_own(made.GetPrim(), "gobo", _TYPES.Asset, files.texture(light.gobo))
        made.GetPrim().CreateAttribute(IMAGE, _TYPES.String, custom=True).Set(light.gobo)


def _profile(made: Any, profile: tuple[float, ...], files: Files) -> None:
    shaping = UsdLux.ShapingAPI.Apply(made.GetPrim())
    shaping.CreateShapingIesFileAttr(files.luminaire(profile))
    set_own(made.GetPrim(), "profile", _TYPES.DoubleArray, list(profile))


def _place(made: Any, position: Vector3 | ArrayLike, axes: ArrayLike) -> None:
    """Place a prim by its axes (3, 3), columns in the world; USD's matrices act on rows."""
    made.AddTransformOp().Set(Gf.Matrix4d(*pose_of(axes, position).T.ravel().tolist()))
