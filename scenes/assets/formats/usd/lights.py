"""UsdLux lights.

Intensity times two to the exposure is a luminance [cd/m²] (OpenUSD, Overview of UsdLux, "Quantities and units"); where
`normalize` is set it is divided by the light's area in m² (a distant light's: pi sin²(angle / 2)).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import UsdGeom, UsdLux
from scipy import ndimage

from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.environments import read_environment, read_hdr
from multilight.scenes.assets.formats.ies import parse_ies
from multilight.scenes.assets.formats.imported import Emission, FoundLight
from multilight.scenes.assets.formats.usd.materials import (
    Tell,
    by_blender,
    inputs_of,
    open_picture,
    read_resolved,
    resolved_file,
    rgb_of,
    title_of,
)
from multilight.scenes.assets.formats.usd.names import PROFILE
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import LUMINOUS_EFFICACY, srgb_decode
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import matrix4, pose_of

KINDS = (
    UsdLux.SphereLight, UsdLux.RectLight, UsdLux.DiskLight, UsdLux.DistantLight, UsdLux.DomeLight, UsdLux.DomeLight_1,
)  # fmt: skip
"""Lights that are read as such; a cylinder light becomes a glowing tube."""


@dataclass(frozen=True)
class LightReader:
    """Reads the lights of the stage at `path`.

    `keep_map` stores a dome's texture, turned upright by a rotation (3, 3) where one is given, and returns its name, or
    none where it is of one colour, which comes beside.
    """

    path: Path
    keep_map: Callable[[Any, Any, Float64 | None], tuple[str | None, Rgb]]
    note: Tell = lambda *_: None

    def glow(self, prim: Any, matrix: Float64) -> Emission:
        """Return what a shape placed by `matrix` (4, 4) that is a light gives off."""
        level, colour = _level(prim)
        if prim.IsA(UsdLux.CylinderLight) and inputs_of(UsdLux.LightAPI(prim))("normalize", False):
            length, radius = tube_of(prim)
            level /= 2 * math.pi * radius * length * abs(np.linalg.det(matrix[:3, :3])) ** (2 / 3)
        return Emission(amount=rgb_of(colour * level))

    def read(self, prim: Any, matrix: Float64) -> FoundLight:
        """Translate a light placed by `matrix` (4, 4), world from light; raises `AssetError` for other kinds."""
        stretch = np.linalg.norm(matrix[:3, :3], axis=0)
        pose = pose_of(matrix[:3, :3] / stretch, matrix[:3, 3])
        value = inputs_of(UsdLux.LightAPI(prim))
        level, colour = _level(prim)
        normalized = bool(value("normalize", False))

        def made(kind: Any, amount: float, unit: Any, **more: Any) -> FoundLight:
            return FoundLight(
                kind=kind, name=title_of(prim), amount=rgb_of(colour * amount), unit=unit, pose=matrix4(pose), **more
            )

        if prim.IsA(UsdLux.SphereLight):
            return self._sphere(made, prim, level, float(value("radius", 0.5)) * float(stretch.mean()), normalized)
        if prim.IsA(UsdLux.RectLight):
            if (file := prim.GetAttribute("inputs:texture:file").Get()) is not None and file.path:
                self.note(prim.GetPath(), f"its picture {file.path!r}", "it shines evenly", "make it a glowing mesh")
            size = float(value("width", 1.0)) * stretch[0], float(value("height", 1.0)) * stretch[1]
            area = size[0] * size[1]
            return made("area", level / area if normalized else level, "nit", width=size[0], height=size[1])
        if prim.IsA(UsdLux.DiskLight):
            size = 2 * float(value("radius", 0.5)) * stretch[0], 2 * float(value("radius", 0.5)) * stretch[1]
            area = math.pi / 4 * size[0] * size[1]
            amount = level / area if normalized else level
            return made("area", amount, "nit", width=size[0], height=size[1], ellipse=True)
        if prim.IsA(UsdLux.DistantLight):
            angle = math.radians(float(value("angle", 0.53))) * (2 if by_blender(prim.GetStage()) else 1)
            spread = math.pi * math.sin(angle / 2) ** 2
            return made("sun", level if normalized or spread == 0 else level * spread, "lx", angle=angle)
        if prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1):
            return self._dome(made, prim, level, matrix)
        raise AssetError(
            f"{self.path}: the light {prim.GetPath()} is a {prim.GetTypeName()}, which is not read; "
            "make it a sphere, rect, disk, distant or dome light"
        )

    def _dome(self, made: Any, prim: Any, level: float, matrix: Float64) -> FoundLight:
        """Translate a dome, whose map OpenEXR lays out: its pole on +Y, its centre on +Z, its left towards +X."""
        axes = matrix[:3, :3] / np.linalg.norm(matrix[:3, 0])
        pole, centre = axes[:, 1], axes[:, 2]
        if prim.IsA(UsdLux.DomeLight_1) and _pole_axis(prim) == UsdGeom.Tokens.z:
            pole, centre = axes[:, 2], -axes[:, 1]
        file = prim.GetAttribute("inputs:texture:file").Get()
        if file is None or not file.path:
            return made("environment", level, "nit")
        upright = pole[2] >= 0.999
        # Rows: where the map's centre, left and pole look in the world.
        name, tint = self.keep_map(file, prim, None if upright else np.stack([centre, np.cross(pole, centre), pole]))
        rotation = math.atan2(centre[1], centre[0]) if name and upright else 0.0
        light: FoundLight = made("environment", level, "nit", map=name, rotation=rotation)
        return light.model_copy(update={"amount": rgb_of(np.array(light.amount) * tint)})

    def _sphere(self, made: Any, prim: Any, level: float, radius: float, normalized: bool) -> FoundLight:
        """Translate a sphere light: its intensity is its luminance times the disc one sees; a cone makes it a spot."""
        seen = math.pi * radius**2
        intensity = level / 4 if normalized else level * seen
        size = 0.0 if prim.GetAttribute("treatAsPoint").Get() else radius
        if not prim.HasAPI(UsdLux.ShapingAPI):
            return made("point", intensity, "cd", radius=size)
        shaping = UsdLux.ShapingAPI(prim)
        half = math.radians(float(shaping.GetShapingConeAngleAttr().Get() or 90.0))
        if half >= 1.5:
            profile, factor = self._profile(prim, shaping)
            return made("point", intensity * factor, "cd", radius=size, profile=profile)
        soft = float(np.clip(shaping.GetShapingConeSoftnessAttr().Get() or 0.0, 0, 1))
        return made("spot", intensity, "cd", radius=size, half_angle=half, blend=soft)

    def _profile(self, prim: Any, shaping: Any) -> tuple[tuple[float, ...] | None, float]:
        """Return a light's profile, that of its IES file, and what its intensity is multiplied by.

        The file's candelas multiply the luminance as they are, or, where it is to be normalized, over their mean.
        """
        own = prim.GetAttribute(PROFILE).Get()
        file = shaping.GetShapingIesFileAttr().Get()
        if own is not None or file is None or not file.path:
            return None if own is None else tuple(own), 1.0
        text = read_resolved(self.path, file, prim.GetPath()).decode("latin-1")
        found = parse_ies(text, source=f"{self.path}: {file.path}")
        normalized = bool(shaping.GetShapingIesNormalizeAttr().Get())
        return found.profile, found.candela * (4 * math.pi / found.lumens if normalized else 1.0)


def tube_of(prim: Any) -> tuple[float, float]:
    """Return length and radius of a cylinder light."""
    value = inputs_of(UsdLux.LightAPI(prim))
    return float(value("length", 1.0)), float(value("radius", 0.5))


def _level(prim: Any) -> tuple[float, Float64]:
    """Return a light's luminance [cd/m²] and its colour (3,)."""
    value = inputs_of(UsdLux.LightAPI(prim))
    level = float(value("intensity", 1.0)) * 2.0 ** float(value("exposure", 0.0))
    colour = np.array(value("color", (1.0, 1.0, 1.0)), np.float64)
    kelvin = float(value("colorTemperature", 6500.0))
    white = kelvin == 6500.0 and by_blender(prim.GetStage())  # which has it on where it means white
    if value("enableColorTemperature", False) and not white:
        colour = colour * np.array(UsdLux.BlackbodyTemperatureAsRgb(kelvin))
    # Blender writes its own watts, those of a sun over four.
    watts = LUMINOUS_EFFICACY * (4.0 if prim.IsA(UsdLux.DistantLight) else 1.0)
    return level * (watts if by_blender(prim.GetStage()) else 1.0), colour


def read_map(path: Path, file: Any, where: Any) -> Float32:
    """Read a dome's texture, (H, W, 3) linear; raises `AssetError` for formats that are not read."""
    if file.resolvedPath.lower().endswith(".exr") and "[" not in file.resolvedPath:
        return read_environment(Path(resolved_file(path, file, where)))
    if file.path.lower().endswith(".hdr"):
        return read_hdr(read_resolved(path, file, where), f"{path}: {file.path!r}")
    if file.path.lower().endswith(".tx"):
        raise AssetError(f"{path}: {where} names {file.path!r}; convert it to EXR")
    pixels = np.asarray(open_picture(path, file, where).convert("RGB"), np.float32) / 255
    return srgb_decode(pixels).astype(np.float32)


def upright(image: Float32, axes: Float64) -> Float32:
    """Turn a map (H, W, 3) whose centre, left and top look along the rows of `axes` (3, 3) so that its top is +Z."""
    height, width = image.shape[:2]
    azimuth = np.pi - 2 * np.pi * (np.arange(width) + 0.5) / width
    latitude = (np.pi / 2 - np.pi * (np.arange(height) + 0.5) / height)[:, None]
    flat = np.cos(latitude)
    seen = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(latitude) + 0 * azimuth], axis=-1) @ axes.T
    column = (np.pi - np.arctan2(seen[..., 1], seen[..., 0])) / (2 * np.pi) * width - 0.5
    row = np.clip((np.pi / 2 - np.arcsin(np.clip(seen[..., 2], -1, 1))) / np.pi * height - 0.5, 0, height - 1)
    channels = [
        ndimage.map_coordinates(image[..., channel], [row, column], order=1, mode="grid-wrap") for channel in range(3)
    ]
    return np.stack(channels, axis=-1).astype(np.float32)


def _pole_axis(prim: Any) -> str:
    """Return the axis that a dome of the second schema has its pole on."""
    axis = str(prim.GetAttribute("poleAxis").Get() or "scene")
    return str(UsdGeom.GetStageUpAxis(prim.GetStage())) if axis == "scene" else axis
