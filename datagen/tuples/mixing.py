"""One stored view under any lighting, as a picture: the command `mix`."""

import json
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_file, written
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, write_exr
from multilight.datagen.text import did_you_mean, plain
from multilight.datagen.tuples import compose, pictures
from multilight.datagen.tuples.condition_files import find_condition, in_words, save_condition
from multilight.datagen.tuples.request import MixRequest
from multilight.lights.describe import describe
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import UInt8

LIT = ("target", "background", "composite", "effect")
GOES_WITH = {
    "condition": LIT,
    "save_condition": LIT,
    "object": (*LIT[1:], "mask"),
    "insert_condition": ("composite",),
    "save_insert_condition": ("composite",),
}
"""Options that only some pictures take."""


@dataclass(frozen=True)
class Picture:
    """A picture: its channels (H, W), or `RGB` (H, W, 3), as they are; for the eye (H, W, 3); what it is, in words."""

    channels: Mapping[str, NDArray[np.generic]]
    shown: UInt8
    told: str


def write_mix(request: MixRequest) -> None:
    """Make the picture, write it and say so; raises `UserError` naming the value and those allowed."""
    if request.condition_schema:
        print(json.dumps(LightingCondition.model_json_schema(), indent=1))
        return
    if request.address is None:
        raise UserError("name the dataset: multilight mix DIR --out FILE, or multilight mix DIR --lights")
    what = request.what or ("composite" if request.insert_condition else "target")
    files = _checked_files(request, what)
    source = open_dataset(request.address)
    record = checked_scene(source, request.scene)
    if request.lights:
        _print_lights(record)
        return
    for path in files:
        check_file(path)
    if not 0 <= request.view < len(record.views):
        raise UserError(f"--view {request.view} is not in scene {record.index}; it has 0 to {len(record.views) - 1}")
    name = checked_object(request.object or record.scene.insertable[0], record)
    view = source.view(record, request.view)
    saved: list[tuple[LightingCondition, Path | None]] = []
    if what in LIT:
        base = find_condition(request.condition or "all", record, view)
        insert = find_condition(request.insert_condition, record, view) if request.insert_condition else base
        saved = [(base, request.save_condition), (insert, request.save_insert_condition)]
        picture = _lit(what, view, name, insert, base)
    else:
        picture = _stored(what, view, name)
    out = files[0]
    told = picture.told
    with written(out) as work:
        if out.suffix.lower() == ".exr":
            write_exr(work, picture.channels)
            told = f"{told}; as numbers, channels {', '.join(picture.channels)}"
        else:
            Image.fromarray(picture.shown).save(work)
    print(plain(f"{out}: scene {record.index}, view {request.view}: {told}"))
    for condition, file in saved:
        if file is not None:
            save_condition(condition, file)
            print(plain(f"{file}: {in_words(condition, view.lights)}"))


def checked_scene(source: DatasetSource, index: int) -> SceneRecord:
    """Read the scene that `--scene` names; raises `UserError` where there is none."""
    if index not in source.indices:
        there = f"{source.indices[0]} to {source.indices[-1]}" if source.indices else "none"
        raise UserError(f"--scene {index} is not in {source.address}; it has {there}")
    return source.scene(index)


def checked_object(name: str, record: SceneRecord) -> str:
    """Return the name that `--object` gives; raises `UserError` where it is no insertable object's."""
    names = record.scene.insertable
    if name not in names:
        raise UserError(f"--object {name} is not insertable; {did_you_mean(name, names)}choose one of {list(names)}")
    return name


def _checked_files(request: MixRequest, what: str) -> list[Path]:
    """Return the files that are to be written, the picture first; raises `UserError` where options contradict."""
    if request.lights:
        if request.out or request.what or any(getattr(request, option) for option in GOES_WITH):
            raise UserError("--lights only lists; it goes with --scene alone")
        return []
    if request.out is None:
        raise UserError("name the picture to write: --out FILE.png or --out FILE.exr")
    if request.out.suffix.lower() not in (".png", ".exr"):
        raise UserError(f"--out {request.out}: the suffix must be .png or .exr")
    for option, pictured in GOES_WITH.items():
        value = getattr(request, option)
        if value is not None and what not in pictured:
            given = f"--{option.replace('_', '-')} {value}"
            raise UserError(f"{given} goes with --what {', '.join(pictured)}; this makes the {what}")
    saves = [path for path in (request.save_condition, request.save_insert_condition) if path is not None]
    for path in saves:
        if path.suffix != ".json":
            raise UserError(f"{path}: the suffix of a condition's file must be .json")
    if len(saves) == 2 and saves[0] == saves[1]:
        raise UserError(f"--save-condition and --save-insert-condition are both {saves[0]}; name two files")
    return [request.out, *saves]


def _print_lights(record: SceneRecord) -> None:
    lights = record.rig.lights
    width = max(len(light.name) for light in lights)
    for light in lights:
        print(plain(f"{light.name:{width}}  {describe(light)}"))
    names = ", ".join(condition.name for condition in record.conditions)
    print(textwrap.fill(plain(f"stored conditions: {names}"), 80, break_long_words=False))


def _lit(what: str, view: ViewData, name: str, insert: LightingCondition, base: LightingCondition) -> Picture:
    told = f"{what}, lit by {in_words(base, view.lights)}"
    match what:
        case "target":
            radiance = compose.target(view, base)
        case "background":
            radiance, told = compose.background(view, name, base), f"{told}, without {name}"
        case "composite":
            radiance = compose.composite(view, name, insert=insert, base=base)
            told = f"{told}, with {name} lit by {in_words(insert, view.lights)}"
        case _:
            radiance, told = compose.effect(view, name, base), f"{told}, of {name}"
    shown = pictures.effect_picture(radiance) if what == "effect" else to_display(radiance)
    return Picture({"RGB": radiance}, shown, told)


def _stored(what: str, view: ViewData, name: str) -> Picture:
    geometry = view.geometry
    match what:
        case "depth":
            near, far = pictures.depth_range(geometry.z_depth)
            told = f"depth along the optical axis: {near:.3g} m white, {far:.3g} m and beyond dark, nothing black"
            return Picture({"Z": geometry.z_depth}, pictures.depth_picture(geometry.z_depth), told)
        case "normal":
            normals = geometry.normal_world
            channels = {axis: normals[..., i] for i, axis in enumerate("XYZ")}
            return Picture(channels, pictures.normal_picture(normals), "normals in world axes, +Z up")
        case "albedo":
            return Picture({"RGB": geometry.albedo}, pictures.albedo_picture(geometry.albedo), "albedo")
        case "mask":
            share = view.coverage[name]
            return Picture({"Y": share}, pictures.mask_picture(share), f"the share of each pixel that {name} covers")
        case _:
            ids = geometry.instance_id
            told = f"ids of {len(np.unique(ids[ids > 0]))} bodies, each its place in scene.json plus one"
            return Picture({"ID": ids.astype(np.uint32)}, pictures.ids_picture(ids), told)
