"""The command `mix`: files of conditions, what is said, stored maps as pictures, options that contradict each other."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import multilight
from multilight.datagen.cli import main
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples.condition_files import EXAMPLE
from multilight.lights.describe import describe
from multilight.lights.spec import AreaLight, EmissiveLight, Light, LightingCondition, SunLight
from multilight.scenes.poses import matrix4


def mix(*words: object) -> int:
    return main(["mix", *(str(word) for word in words)])


def channels(path: Path) -> dict[str, np.ndarray]:
    return {
        name: np.asarray(c.pixels) for name, c in OpenEXR.File(str(path), separate_channels=True).channels().items()
    }


GAIN = r"a number from 0 to 1e9, or three: of red, green and blue"
WRONG: dict[str, tuple[str, str]] = {
    "unknown key": ('{"name": "w", "gain": {}}', r"unknown key 'gain'; did you mean 'gains'\? known keys: name, "),
    "word": ('{"name": "w", "gains": {"key": "bright"}}', rf"gains\.key = 'bright'; allowed: .*{GAIN}"),
    "text of a number": ('{"name": "w", "gains": {"key": "1"}}', rf"gains\.key = '1'; allowed: .*{GAIN}"),
    "truth": ('{"name": "w", "gains": {"key": [1, true, 1]}}', rf"gains\.key\.1 = True; allowed: .*{GAIN}"),
    "negative": ('{"name": "w", "gains": {"key": -1}}', rf"gains\.key\.0 = -1; allowed: .*{GAIN}"),
    "two": ('{"name": "w", "gains": {"key": [1, 2]}}', rf"gains\.key = \[1, 2\]; allowed: .*{GAIN}"),
    "four": ('{"name": "w", "gains": {"key": [1, 2, 3, 4]}}', rf"gains\.key = \[1, 2, 3, 4\]; allowed: .*{GAIN}"),
    "large": ('{"name": "w", "gains": {"key": 1e10}}', rf"gains\.key\.0 = 10000000000\.0; allowed: .*{GAIN}"),
    "no table": ('{"name": "w", "gains": [1, 2, 3]}', rf"gains = \[1, 2, 3\]; allowed: .*{GAIN}"),
    "name": ('{"name": "Warm Light", "gains": {}}', "name = 'Warm Light'; allowed: lower-case letters, digits and _"),
    "no name": ('{"gains": {}}', r'name is missing, as in \{"name": "warm"'),
    "exposure": ('{"name": "w", "gains": {}, "exposure_ev": 65}', "exposure_ev = 65; allowed: .* from -64 to 64"),
    "list": ("[]", r'it is no JSON object, such as \{"name"'),
}  # fmt: skip
"""What neither the reader nor the JSON schema lets pass."""
UNREAD: dict[str, tuple[str, str]] = {
    "NaN": ('{"name": "w", "gains": {"key": [1, NaN, 1]}}', rf"gains\.key\.1 = nan; allowed: .*{GAIN}"),
    "light": (
        '{"name": "w", "gains": {"kee": 1}}',
        r"gains\.kee: there is no such light; did you mean 'key'\? the scene has key \(spot at \(.*\) m, \d+ K\); ",
    ),
    "no JSON": ("key = 1", r'it is no JSON \(expected value at line 1 column 1\), such as \{"name"'),
    "empty": ("", r"it is no JSON \(EOF"),
    "too large": (" " * 70_000, "it holds 70000 bytes, at most 65536 are read"),
}


def fits(value: Any, schema: dict[str, Any]) -> bool:
    """Validate a value by the keywords of JSON schema that a condition's schema uses."""
    kinds: dict[str, Any] = {"object": dict, "array": list, "string": str, "number": (int, float)}
    match schema:
        case {"anyOf": choices}:
            return any(fits(value, each) for each in choices)
        case {"type": kind} if not isinstance(value, kinds[kind]) or isinstance(value, bool):
            return False
        case {"type": "string"}:
            return re.search(schema["pattern"], value) is not None and len(value) <= schema["maxLength"]
        case {"type": "number"}:
            return bool(schema["minimum"] <= value <= schema["maximum"])
        case {"type": "array"}:
            right = schema["minItems"] <= len(value) <= schema["maxItems"]
            return right and all(map(fits, value, schema["prefixItems"]))
    known, others = schema.get("properties", {}), schema["additionalProperties"]
    if any(name not in value for name in schema.get("required", ())):
        return False
    return all(name in known or others for name in value) and all(
        fits(each, known.get(name, others)) for name, each in value.items()
    )


@pytest.fixture
def schema(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    assert mix("--condition-schema") == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_schema_takes_what_the_reader_takes(schema: dict[str, Any]) -> None:
    assert all("description" in about for about in schema["properties"].values())
    shown = schema["examples"][0]
    assert shown == json.loads(EXAMPLE)
    for good in (shown, {"name": "off", "gains": {}}, {"name": "a", "gains": {"x": [0, 1, 2.5]}, "exposure_ev": -3}):
        assert fits(good, schema)
        LightingCondition.model_validate_json(json.dumps(good), strict=True)
    assert LightingCondition.from_json(EXAMPLE).gains == {"key": (1.2, 0.9, 0.5), "fill": (1.0, 1.0, 1.0)}
    for content, _ in WRONG.values():
        assert not fits(json.loads(content), schema), content


@pytest.mark.parametrize("wrong", [*WRONG, *UNREAD])
def test_wrong_files_are_told_in_one_line(
    wrong: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, expected = (WRONG | UNREAD)[wrong]
    file = tmp_path / "w.json"
    file.write_text(content)
    for option in ("--condition", "--insert-condition"):
        assert mix(spheres_dataset, option, file, "--out", tmp_path / "m.png") == 1
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        assert line.startswith(f"error: {file}")
        assert re.search(expected, line.rstrip()), line
    assert list(tmp_path.iterdir()) == [file]
    with pytest.raises(multilight.UserError, match=expected):
        multilight.open(spheres_dataset)[0].mix(0, str(file))


def test_names_and_folders_that_are_none(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for word, expected in (("key_onyl", r"did you mean 'key_only'\? it is not"), (tmp_path, r"\(Is a directory\)$")):
        assert mix(spheres_dataset, "--condition", word, "--out", tmp_path / "m.png") == 1
        assert re.search(expected, capsys.readouterr().err)


def test_saved_conditions_make_the_same_picture(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, again = tmp_path / "first.exr", tmp_path / "again.exr"
    base, insert = tmp_path / "base.json", tmp_path / "insert.json"
    saves = ("--save-condition", base, "--save-insert-condition", insert)
    drawn = ("--condition", "random:7", "--insert-condition", "random:8", *saves)
    assert mix(spheres_dataset, "--view", 1, *drawn, "--out", first) == 0
    said = capsys.readouterr().out.splitlines()
    name = multilight.open(spheres_dataset)[0].objects[0]
    assert re.fullmatch(
        rf"{first}: scene 0, view 1: composite, lit by random_7 \(.*; [+-][0-9.]+ EV\), with {name} lit by random_8 "
        r"\(.*\); as numbers, channels RGB",
        said[0],
    )
    assert [line.partition(":")[0] for line in said] == [str(first), str(base), str(insert)]
    files = ("--condition", base, "--insert-condition", insert)
    assert mix(spheres_dataset, "--view", 1, *files, "--out", again) == 0
    assert first.read_bytes() == again.read_bytes()
    scene = multilight.open(spheres_dataset)[0]
    assert LightingCondition.from_json(base.read_text()) == scene.condition(7, 1)
    assert np.array_equal(scene.mix(1, str(insert)), scene.mix(1, 8))


def test_gains_are_told_in_words(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "w.json"
    for gains, expected in (
        ({"key": [1.2, 0.9, 0.5]}, "mine (key 1.2/0.9/0.5 RGB, others off; +0.50 EV)"),
        ({"key": 2, "environment": 0.25}, "mine (environment 0.25, key 2; +0.50 EV)"),
        ({"key": 0}, "mine (no light on; +0.50 EV)"),
    ):
        file.write_text(json.dumps({"name": "mine", "gains": gains, "exposure_ev": 0.5}))
        assert mix(spheres_dataset, "--condition", file, "--what", "effect", "--out", tmp_path / "m.png") == 0
        assert f"effect, lit by {expected}, of sphere_0" in capsys.readouterr().out


def test_lights_are_listed(spheres_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert mix(spheres_dataset, "--lights", "--scene", 1) == 0
    lines = capsys.readouterr().out.splitlines()
    scene = multilight.open(spheres_dataset)[1]
    for line, light in zip(lines, scene.record.rig.lights, strict=False):
        assert line.split() == [light.name, *describe(light).split()]
    assert " ".join(lines[len(scene.lights) :]) == f"stored conditions: {', '.join(scene.conditions)}"
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        (SunLight(name="s", direction=(0, -1, -1), irradiance=(1, 0.5, 0)),
         "sun 45 deg high, azimuth 90 deg, red 1.00 green 0.50 blue 0.00"),
        (AreaLight(name="a", width=1, height=0.5, world_from_light=matrix4(np.eye(4)), radiance=(1, 1, 1)),
         "area 1.00 x 0.50 m at (0.00, 0.00, 0.00) m, white"),
        (EmissiveLight(name="e", body="lamp", part=2, radiance=(1, 1, 1), gel="amber"),
         "emissive, part 2 of body lamp, gel amber"),
    ],
)  # fmt: skip
def test_lights_in_words(light: Light, expected: str) -> None:
    assert describe(light) == expected


def test_stored_maps_as_numbers(
    spheres_dataset: Path, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path
) -> None:
    geometry = sphere_view[1].geometry
    wanted: dict[str, dict[str, np.ndarray]] = {
        "depth": {"Z": geometry.z_depth},
        "normal": {axis: geometry.normal_world[..., i] for i, axis in enumerate("XYZ")},
        "albedo": {channel: geometry.albedo[..., i] for i, channel in enumerate("RGB")},
        "ids": {"ID": geometry.instance_id},
        "mask": {"Y": next(iter(sphere_view[1].coverage.values()))},
    }
    scene = multilight.open(spheres_dataset)[0]
    for what, planes in wanted.items():
        assert mix(spheres_dataset, "--what", what, "--out", tmp_path / f"{what}.exr") == 0
        found = channels(tmp_path / f"{what}.exr")
        assert set(found) == set(planes)
        for name, plane in planes.items():
            np.testing.assert_array_equal(found[name], plane)
        stored = scene.tuple(0)[4] if what == "mask" else getattr(scene, what)(0)
        assert np.array_equal(np.moveaxis(np.atleast_3d(stored), -1, 0), np.array(list(planes.values())))


def test_stored_maps_as_pictures(
    spheres_dataset: Path, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    geometry = sphere_view[1].geometry
    seen = {}
    for what in ("depth", "normal", "albedo", "ids", "mask"):
        assert mix(spheres_dataset, "--what", what, "--out", tmp_path / f"{what}.png") == 0
        seen[what] = np.asarray(Image.open(tmp_path / f"{what}.png"), int)
    told = capsys.readouterr().out
    near, far = (float(value) for value in re.findall(r"axis: ([0-9.]+) m white, ([0-9.]+) m", told)[0])
    z, grey = geometry.z_depth, seen["depth"][..., 0]
    assert (grey[(z > 0) & (z <= near)] >= 254).all()
    assert (grey[z > far] <= 0.15 * 255).all()
    assert (grey[z > 0] > 24).all()
    order = np.argsort(z[z > 0])
    assert (np.diff(grey[z > 0][order]) <= 0).all()
    assert (grey[z == 0] == 0).all()
    np.testing.assert_allclose(seen["normal"] / 127.5 - 1, geometry.normal_world, atol=1 / 127)
    ids = geometry.instance_id
    colours = [np.unique(seen["ids"][ids == body], axis=0) for body in np.unique(ids)]
    assert all(len(colour) == 1 for colour in colours)
    assert len(np.unique(np.concatenate(colours), axis=0)) == len(colours)
    assert sphere_view[0].scene.insertable[0] in told.splitlines()[-1]
    share = next(iter(sphere_view[1].coverage.values()))
    np.testing.assert_allclose(seen["mask"] / 255, np.repeat(share[..., None], 3, axis=2), atol=0.5 / 255 + 1e-6)
    assert f"ids of {len(np.unique(ids[ids > 0]))} bodies" in told


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--what target --insert-condition all", "--insert-condition all goes with --what composite; this makes "),
        ("--what depth --condition all", r"--condition all goes with --what target, background.*this makes the depth"),
        ("--what ids --save-condition c.json", "--save-condition c.json goes with --what target"),
        ("--save-insert-condition c.json", "--save-insert-condition c.json goes with --what composite; this "),
        ("--object sphere_0", "--object sphere_0 goes with --what background, composite, effect, mask; this "),
        ("--save-condition c.png", "c.png: the suffix of a condition's file must be .json"),
        ("--what composite --save-condition c.json --save-insert-condition c.json", "are both c.json; name two files"),
        ("--lights", "--lights only lists"),
        ("--what effect --object sphere_00", "did you mean 'sphere_0'"),
    ],
)  # fmt: skip
def test_options_that_contradict_each_other(
    words: str, expected: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert mix(spheres_dataset, *words.split(), "--out", tmp_path / "m.png") == 1
    assert re.search(expected, capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_what_is_missing_is_told(spheres_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert mix() == 1
    assert "multilight mix DIR --out FILE" in capsys.readouterr().err
    assert mix(spheres_dataset) == 1
    assert "--out FILE.png" in capsys.readouterr().err


def test_help_shows_a_condition_that_is_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert mix("--help") == 0
    text = re.sub(r"[│\s]+", " ", capsys.readouterr().out)
    example = re.search(r'\{ ?"name".*?0\.5\}', text)
    assert example is not None
    assert LightingCondition.from_json(example[0]) == LightingCondition.from_json(EXAMPLE)
