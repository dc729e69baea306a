"""UsdLux lights and glowing parts of a stage as a rig's lights."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.errors import UserError
from multilight.datagen.usd.layout import get_own, own
from multilight.datagen.usd.read_bodies import BodyReader
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.photometry.radiometry import watts_from_photometric
from multilight.lights.rigs.custom import light_from_found
from multilight.lights.spec import EmissiveLight, Light
from multilight.scenes.assets.formats.usd.lights import LightReader
from multilight.scenes.assets.formats.usd.names import IMAGE
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs.background import PACK
from multilight.scenes.frozen import Rgb

WHITE: Rgb = (1.0, 1.0, 1.0)


def read_lights(
    path: Path, prims: Sequence[Any], place: Callable[[Any], Any], *, bodies: BodyReader, library: AssetLibrary
) -> tuple[Light, ...]:
    """Return the lights of these prims in order; `place` gives a prim's matrix (4, 4), world from prim."""
    brought = {} if library.background is None else {light.name: light.map for light in library.background.lights}

    def keep_map(file: Any, prim: Any, _: Any) -> tuple[str, Rgb]:
        asset = prim.GetAttribute(IMAGE).Get() if prim.HasAttribute(IMAGE) else None
        if asset is not None and bodies.is_installed(asset, Path(file.resolvedPath), environment=True):
            return str(asset), WHITE
        if brought.get(prim.GetName()) is None:
            raise UserError(f"{path}: the map {file.path!r} of {prim.GetPath()} cannot be read; put it there")
        return f"{PACK}/{brought[prim.GetName()]}", WHITE

    reader = LightReader(path, keep_map)
    lights = [
        _glow(path, prim, bodies) if prim.HasRelationship(own("part")) else _lamp(path, reader, prim, place, bodies)
        for prim in prims
    ]
    if not lights:
        raise UserError(f"{path} has no light; add one")
    return tuple(lights)


def _lamp(path: Path, reader: LightReader, prim: Any, place: Callable[[Any], Any], bodies: BodyReader) -> Light:
    """Read a UsdLux light, and what stands beside it for which UsdLux has no word."""
    found = reader.read(prim, place(prim))
    light = light_from_found(found, np.eye(4), prim.GetName())
    more = _source(prim)
    match light.kind:
        case "environment":
            more["map"] = found.map
        case "sun":
            more["angle"] = found.angle
        case "point":
            more["direction"] = tuple((-np.array(found.pose)[:3, 2]).tolist())
        case "spot":
            right = np.array(found.pose)[:3, 0] @ spot_frame(light.direction)
            more |= {"half_angle": found.half_angle, "gobo": _gobo(path, prim, bodies)}
            more["roll"] = float(np.arctan2(right[1], right[0]))
    return light.model_copy(update=more)


def _glow(path: Path, prim: Any, bodies: BodyReader) -> EmissiveLight:
    """Read a part that glows."""
    target = ", ".join(str(found) for found in prim.GetRelationship(own("part")).GetTargets())
    if target not in bodies.glows:
        raise UserError(f"{path}: {prim.GetPath()} names {target!r}, whose material does not glow; remove one of them")
    body, part, emission = bodies.glows[target]
    red, green, blue = (watts_from_photometric(value) for value in emission.amount)
    return EmissiveLight(
        name=prim.GetName(),
        body=body,
        part=part,
        radiance=(red, green, blue),
        texture=emission.texture,
        **_source(prim),
    )


def _source(prim: Any) -> dict[str, Any]:
    return {"colour_temperature": get_own(prim, "colourTemperature"), "gel": get_own(prim, "gel")}


def _gobo(path: Path, prim: Any, bodies: BodyReader) -> str | None:
    file = get_own(prim, "gobo")
    if file is None:
        return None
    asset = prim.GetAttribute(IMAGE).Get()
    if asset is None or not file.resolvedPath or not bodies.is_installed(asset, Path(file.resolvedPath)):
        raise UserError(f"{path}: the gobo {asset!r} of {prim.GetPath()} is not installed as it was; install its pack")
    return str(asset)
