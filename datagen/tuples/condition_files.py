"""Lighting conditions as users name and write them: by name, by seed, in a JSON file, as gains by light."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pydantic import ValidationError

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import written
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.text import did_you_mean
from multilight.datagen.tuples.exposure import levels, meter_condition, thumbnail
from multilight.lights.describe import describe
from multilight.lights.relight import mix
from multilight.lights.sample_conditions import random_condition
from multilight.lights.spec import LightingCondition, LightRig
from multilight.scenes.files.limits import read_text, shown
from multilight.scenes.frozen import Rgb
from multilight.scenes.random_streams import Streams

EXAMPLE = '{"name": "warm", "gains": {"key": [1.2, 0.9, 0.5], "fill": 1}, "exposure_ev": 0.5}'
"""What a file of a condition holds, where a scene has lights of these names."""
MOST = 1 << 16
"""Bytes of such a file."""


def find_condition(text: str, record: SceneRecord, view: ViewData) -> LightingCondition:
    """Resolve a condition's name, `random:SEED` (metered on the view) or a JSON file; raises `UserError`."""
    if text.startswith("random:"):
        seed = text.removeprefix("random:")
        if not re.fullmatch("[0-9]{1,10}", seed):
            raise UserError(f"condition {shown(text)}: the seed must be a whole number of at most 10 digits")
        rng = Streams(int(seed), record.index)("mix")
        return metered(random_condition(rng, record.rig, f"random_{seed}"), view)
    if text in (names := [condition.name for condition in record.conditions]):
        return record.condition(text)
    try:
        content = read_text(Path(text), MOST)
    except OSError as error:
        near = did_you_mean(text, names)
        raise UserError(
            f"condition {shown(text)}: {near}it is not one of {names}, nor random:SEED, nor a file that can be read "
            f"({error.strerror})"
        ) from None
    except ValueError as error:
        raise UserError(f"{text} is not a lighting condition: {error}") from None
    return check_condition(content, text, record.rig)


def read_condition(path: Path) -> LightingCondition:
    """Read a condition's file, whatever scene it is for; raises `UserError` naming what is wrong with it."""
    try:
        return _condition(read_text(path, MOST), str(path))
    except OSError as error:
        raise UserError(f"condition {path}: it cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise UserError(f"{path} is not a lighting condition: {error}") from None


def check_condition(values: str | Mapping[str, object], source: str, rig: LightRig) -> LightingCondition:
    """Return the condition of a rig that JSON, or values, state.

    Raises `UserError` with `source`, the key, the value and what is allowed.
    """
    condition = _condition(values, source)
    check_lights(condition.gains, source, rig)
    return condition


def _condition(values: str | Mapping[str, object], source: str) -> LightingCondition:
    try:
        if isinstance(values, str):
            return LightingCondition.model_validate_json(values, strict=True)
        return LightingCondition.model_validate(values)
    except ValidationError as error:
        raise UserError(f"{source} is not a lighting condition: {_fault(error)}") from None


def check_lights(names: Iterable[str], source: str, rig: LightRig) -> None:
    """Raise `UserError` where one of the names is no light's, listing those that there are and what they are."""
    if unknown := [name for name in names if name not in rig.names]:
        there = "; ".join(f"{light.name} ({describe(light)})" for light in rig.lights)
        raise UserError(
            f"{source}: gains.{shown(unknown[0])[1:-1]}: there is no such light; "
            f"{did_you_mean(unknown[0], rig.names)}the scene has {there}; "
            "a lighting is for scenes with all of its lights"
        )


def metered(condition: LightingCondition, view: ViewData) -> LightingCondition:
    """Expose a condition as a camera would on a view."""
    layers = view.variants[ALL]
    seen = levels(mix(layers, view.lights, condition.model_copy(update={"exposure_ev": 0.0})))
    return meter_condition(condition, view.lights, [thumbnail(layers)], [seen])


def save_condition(condition: LightingCondition, path: Path) -> None:
    """Write a condition as the file that `find_condition` takes."""
    with written(path) as work:
        work.write_text(condition.model_dump_json(indent=1) + "\n")


def in_words(condition: LightingCondition, lights: Sequence[str]) -> str:
    """Say which lights are on and how strong: `warm (key 1.2/0.9/0.5 RGB, fill 1, others off; +0.50 EV)`."""
    on = [f"{name} {_gain(condition.gains[name])}" for name in lights if any(condition.gains.get(name, ()))]
    told = ", ".join(on) + (", others off" if len(on) < len(lights) else "") if on else "no light on"
    return f"{condition.name} ({told}; {condition.exposure_ev:+.2f} EV)"


def _gain(gain: Rgb) -> str:
    return f"{gain[0]:.3g}" if min(gain) == max(gain) else f"{'/'.join(f'{value:.3g}' for value in gain)} RGB"


def _fault(error: ValidationError) -> str:
    """Say what is wrong first: the key, its value and what is allowed."""
    faults, known = error.errors(), LightingCondition.model_fields
    if unknown := [str(fault["loc"][0]) for fault in faults if fault["type"] == "extra_forbidden"]:
        return f"unknown key {shown(unknown[0])}; {did_you_mean(unknown[0], known)}known keys: {', '.join(known)}"
    first = faults[0]
    place = first["loc"]
    if first["type"] == "json_invalid":
        return f"it is no JSON ({first['ctx']['error']}), such as {EXAMPLE}"
    if not place:
        return f"it is no JSON object, such as {EXAMPLE}"
    if first["type"] == "missing" and len(place) == 1:
        return f"{place[0]} is missing, as in {EXAMPLE}"
    allowed = str(known[str(place[0])].description).removesuffix(".")
    if first["type"] == "missing":  # of three numbers
        place = place[:-1]
    where, value = ".".join(str(part) for part in place), first["input"]
    value = list(value) if isinstance(value, tuple) else value
    return f"{shown(where)[1:-1]} = {shown(value)}; allowed: {allowed[0].lower()}{allowed[1:]}"
