"""One stored view under any lighting, as a picture: the command `mix`."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image
from pydantic import ValidationError

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_file, written
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.source import open_dataset
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.exposure import meter_condition, thumbnail
from multilight.datagen.tuples.request import MixRequest
from multilight.datagen.tuples.sheet import effect_picture
from multilight.lights.conditions import random_condition
from multilight.lights.display.tonemap import to_display
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32
from multilight.scenes.files.limits import read_text, shown
from multilight.scenes.streams import Streams


def write_mix(request: MixRequest) -> None:
    """Make the picture and write it; raises `UserError` naming the value and those allowed."""
    out, what = request.out, request.what or ("composite" if request.insert_condition else "target")
    if out.suffix not in (".png", ".exr"):
        raise UserError(f"--out {out}: the suffix must be .png or .exr")
    source = open_dataset(request.address)
    check_file(out)
    if request.scene not in source.indices:
        raise UserError(f"--scene {request.scene} is not in {request.address}; it has {_short(source.indices)}")
    record = source.scene(request.scene)
    if not 0 <= request.view < len(record.views):
        raise UserError(f"--view {request.view} must be 0 to {len(record.views) - 1}")
    name = request.object or record.scene.insertable[0]
    if name not in record.scene.insertable:
        raise UserError(f"--object {name} is not insertable; choose one of {list(record.scene.insertable)}")
    view = source.view(record, request.view)
    base = find_condition(request.condition, record, view)
    insert = find_condition(request.insert_condition or request.condition, record, view)
    picture = _picture(what, view, name, insert, base)
    with written(out) as work:
        if out.suffix == ".exr":
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            OpenEXR.File(header, {"RGB": np.ascontiguousarray(picture)}).write(str(work))
        else:
            shown = effect_picture(picture) if what == "effect" else to_display(picture)
            Image.fromarray(shown).save(work)


def find_condition(text: str, record: SceneRecord, view: ViewData) -> LightingCondition:
    """Resolve a condition's name, a JSON file or `random:SEED` (metered on the view)."""
    if text.startswith("random:"):
        seed = text.removeprefix("random:")
        if not re.fullmatch("[0-9]{1,10}", seed):
            raise UserError(f"condition {shown(text)}: the seed must be a whole number of at most 10 digits")
        rng = Streams(int(seed), record.index)("mix")
        drawn = random_condition(rng, record.rig, f"random_{seed}")
        return meter_condition(drawn, view.lights, [thumbnail(view.variants["all"])])
    if text in (names := [condition.name for condition in record.conditions]):
        return record.condition(text)
    path = Path(text)
    try:
        condition = LightingCondition.from_json(read_text(path))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "content"
        raise UserError(f"{path} is not a lighting condition: {key}: {first['msg']}") from None
    except ValueError as error:
        raise UserError(f"{path} is not a lighting condition: {error}") from None
    except OSError as error:
        raise UserError(
            f"condition {shown(text)} is not one of {names}, nor random:SEED, nor a file ({error.strerror})"
        ) from None
    if unknown := set(condition.gains) - set(view.lights):
        raise UserError(f"{path}: unknown lights {sorted(unknown)}; the scene has {list(view.lights)}")
    return condition


def _picture(what: str, view: ViewData, name: str, insert: LightingCondition, base: LightingCondition) -> Float32:
    match what:
        case "target":
            return compose.target(view, base)
        case "background":
            return compose.background(view, name, base)
        case "composite":
            return compose.composite(view, name, insert=insert, base=base)
        case _:
            return compose.effect(view, name, base)


def _short(indices: Sequence[int]) -> str:
    return f"{indices[0]} to {indices[-1]}" if indices else "none"
