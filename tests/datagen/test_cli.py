"""The command line: help, one-line errors, exit codes, and what `mix`, `sheet` and `verify` make."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.storage.records import SceneRecord, view_file
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.sheet import telling_view
from multilight.scenes.errors import MultilightError
from tests.conftest import SPHERES

COMMANDS = ("dataset", "scene", "verify", "mix", "sheet", "stats", "query", "export", "config", "assets", "doctor")


def run(*words: object) -> int:
    return main([str(word) for word in words])


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--help") == 0
    shown = capsys.readouterr().out
    assert all(command in shown for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_each_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(command, "--help") == 0
    assert len(capsys.readouterr().out) > 200


@pytest.mark.parametrize(
    ("toml", "expected"),
    [
        ("sceens = 3", ["sceens", "unknown key", "scenes"]),
        ("width = 4", ["width", "4", "16"]),
        ("spp = 'many'", ["spp", "many", "integer"]),
        ("objects = [2, 8]", ["objects", "insertable"]),
        ("renderer = 'arnold'", ["renderer", "arnold", "cycles"]),
        ("scenes = ", ["cannot be read as TOML"]),
    ],
)
def test_bad_configuration_is_one_clear_line(
    toml: str, expected: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    path.write_text(toml)
    assert run("dataset", "--out", tmp_path / "d", "--config", path) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "c.toml" in line
    for word in expected:
        assert word in line


def test_configuration_file_and_command_line_join(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text('renderer = "analytic"\nkind = "spheres"\nviews = 9\nwidth = 32\nheight = 32\nscenes = 1\n')
    assert run("dataset", "--out", tmp_path / "d", "--config", path, "--views", 2) == 0
    config = json.loads((tmp_path / "d" / "dataset.json").read_text())["config"]
    assert (config["views"], config["width"], config["scenes"]) == (2, 32, 1)


def test_missing_configuration_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("dataset", "--out", tmp_path / "d", "--config", tmp_path / "none.toml") == 1
    assert "none.toml does not exist" in capsys.readouterr().err


def test_traceback_only_when_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("verify", tmp_path) == 1
    assert "Traceback" not in capsys.readouterr().err
    with pytest.raises(MultilightError):
        run("verify", tmp_path, "--traceback")


def test_tabletop_in_closed_form_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("dataset", "--out", tmp_path / "d", "--renderer", "analytic") == 1
    assert "--kind spheres" in capsys.readouterr().err


def test_verify_exit_codes_and_json(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("verify", spheres_copy) == 0
    capsys.readouterr()
    (spheres_copy / "scenes" / "000001" / view_file(0)).write_bytes(b"not an exr")
    assert run("verify", spheres_copy, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["scenes"] == 2
    assert [(f["scene"], f["view"], f["check"]) for f in found["faults"]] == [(1, 0, "files")]


def read_rgb(path: Path) -> np.ndarray:
    return np.asarray(OpenEXR.File(str(path)).channels()["RGB"].pixels)


def test_mix_writes_what_compose_makes(
    spheres_dataset: Path, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path
) -> None:
    record, view = sphere_view
    base, insert = record.conditions[0], record.conditions[3]
    name = record.scene.insertable[1]
    out = tmp_path / "c.exr"
    words = ["--condition", base.name, "--insert-condition", insert.name, "--object", name]
    assert run("mix", spheres_dataset, "--scene", 0, "--view", 0, *words, "--out", out) == 0
    np.testing.assert_array_equal(read_rgb(out), compose.composite(view, name, insert=insert, base=base))
    assert run("mix", spheres_dataset, "--condition", base.name, "--out", out) == 0
    np.testing.assert_array_equal(read_rgb(out), compose.target(view, base))


def test_mix_takes_a_file_and_random_lightings(
    spheres_dataset: Path, sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path
) -> None:
    record, view = sphere_view
    light = record.rig.names[0]
    path = tmp_path / "lit.json"
    path.write_text(json.dumps({"name": "mine", "gains": {light: [2, 1, 0]}, "exposure_ev": -1}))
    assert run("mix", spheres_dataset, "--condition", path, "--out", tmp_path / "a.exr") == 0
    layer = view.variants["all"][view.lights.index(light)]
    np.testing.assert_allclose(read_rgb(tmp_path / "a.exr"), layer * np.array([1, 0.5, 0], np.float32), rtol=1e-6)
    for seed, name in ((3, "b"), (3, "c"), (4, "d")):
        words = ["--condition", f"random:{seed}", "--what", "target", "--out", tmp_path / f"{name}.png"]
        assert run("mix", spheres_dataset, *words) == 0
    b, c, d = (np.asarray(Image.open(tmp_path / f"{name}.png"), float) for name in "bcd")
    assert b.shape == (48, 64, 3)
    np.testing.assert_array_equal(b, c)
    assert np.abs(b - d).mean() > 1
    assert 30 < b.mean() < 220


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--scene", "7"), "--scene 7"),
        (("--view", "3"), "--view 3 is not in scene 0; it has 0 to 2"),
        (("--object", "teapot"), "teapot"),
        (("--condition", "noon"), "'noon'"),
        (("--condition", "random:x"), "whole number"),
    ],
)
def test_mix_names_the_bad_value(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, str], expected: str
) -> None:
    assert run("mix", spheres_dataset, *words, "--out", tmp_path / "x.png") == 1
    assert expected in capsys.readouterr().err


def test_sheet_shows_every_scene(spheres_dataset: Path, tmp_path: Path) -> None:
    assert run("sheet", spheres_dataset, "--out", tmp_path / "s.png") == 0
    sheet = np.asarray(Image.open(tmp_path / "s.png"))
    assert sheet.shape[1] > 5 * 256
    assert sheet.shape[0] > 2 * 192
    assert len(np.unique(sheet.reshape(-1, 3), axis=0)) > 1000


def test_sheet_looks_where_something_is_to_be_seen(sphere_view: tuple[SceneRecord, ViewData]) -> None:
    def showing(share: float) -> ViewData:
        ball = (np.arange(1000) < 1000 * share).astype("f4").reshape(10, 100)
        return replace(sphere_view[1], coverage={"small": np.zeros((10, 100), "f4"), "ball": ball})

    views = [(number, showing(share)) for number, share in enumerate((0.0, 0.004, 0.02, 0.5))]
    assert telling_view(iter(views))[0] == 2
    assert telling_view(views[2:])[0] == 2
    assert telling_view(views[1::-1])[0] == 1
    rest = iter(views)
    telling_view(rest)
    assert next(rest)[0] == 3  # not read for nothing


def test_module_and_sizes_of_any_aspect(tmp_path: Path) -> None:
    options = [{"64": "50", "48": "77"}.get(word, word) for word in SPHERES]
    assert run("scene", "--out", tmp_path / "d", *options) == 0
    assert run("verify", tmp_path / "d") == 0
