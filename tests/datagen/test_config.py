"""Configuration: presets, files and options join; every key is documented; a wrong one is named with the nearest."""

import json
from pathlib import Path
from typing import get_args

import pytest
from pydantic import ValidationError

from multilight.datagen.cli import main
from multilight.datagen.config import presets
from multilight.datagen.config.dataset import DatasetConfig, load_config
from multilight.datagen.config.loading import keys_of
from multilight.datagen.config.presets import PRESETS
from multilight.datagen.config.table import config_rows
from multilight.datagen.errors import UserError


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "c.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_valid_and_differ(preset: presets.Preset) -> None:
    made = load_config(None, {}, preset)
    assert (made == DatasetConfig()) == (preset == "tabletop")
    assert made == DatasetConfig.from_json(made.model_dump_json())
    hash(made)  # workers keep it as a key


def test_presets_are_named_alike() -> None:
    assert set(get_args(presets.Preset)) == set(PRESETS)


def test_file_goes_over_preset_and_options_over_file(tmp_path: Path) -> None:
    path = write(
        tmp_path, 'preset = "smoke"\nviews = 5\n[cameras]\nlens_mm = [30, 60]\n[cameras.trajectories]\norbit = 0\n'
    )
    made = load_config(path, {"views": 7, "spp": None})
    assert (made.views, made.spp, made.width) == (7, 4, 64)
    assert made.cameras.lens_mm == (30, 60)
    assert made.cameras.trajectories.orbit == 0
    assert made.cameras.trajectories.approach == DatasetConfig().cameras.trajectories.approach
    assert load_config(path, {}, "tabletop").width == 256


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sceens = 3", ["unknown key 'sceens'", "did you mean 'scenes'"]),
        ("[cameras]\nlens = [24, 50]", ["unknown key 'cameras.lens'", "did you mean 'cameras.lens_mm'"]),
        ("lens_mm = [24, 50]", ["unknown key 'lens_mm'", "did you mean 'cameras.lens_mm'"]),
        ("[splits]\ntrian = 1", ["unknown key 'splits.trian'", "did you mean 'splits.train'"]),
        ("[cameras]\nlens_mm = [5, 50]", ["cameras.lens_mm.0 = 5", "12"]),
        ("[cameras]\nlens_mm = [60, 50]", ["cameras", "lens_mm must ascend"]),
        ('preset = "rooms"', ["rooms", "room"]),
        ("preset = []", ["preset", "room"]),
        ('ood_kinds = ["tabletop"]', ["ood_kinds", "tabletop"]),
        ("lights = [6, 2]", ["lights must ascend"]),
        ("[splits]\ntrain = 0\nval = 0\ntest = 0", ["splits", "share above 0"]),
    ],
)
def test_a_wrong_file_is_named_with_key_and_remedy(text: str, words: list[str], tmp_path: Path) -> None:
    with pytest.raises(UserError) as error:
        load_config(write(tmp_path, text), {})
    line = str(error.value)
    assert "\n" not in line
    assert "c.toml" in line
    assert all(word in line for word in words), line


def test_a_wrong_option_is_not_blamed_on_the_file(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"^command line: width = 3"):
        load_config(write(tmp_path, "views = 3"), {"width": 3})


def test_every_key_says_what_it_is_and_what_it_may_be() -> None:
    rows = config_rows(DatasetConfig())
    assert [row.key for row in rows] == list(keys_of(DatasetConfig))
    for row in rows:
        assert len(row.meaning) > 8, row
        assert row.range, row
        assert "None" not in row.range, row
    units = {row.key: row.unit for row in rows}
    assert (units["width"], units["cameras.lens_mm"]) == ("px", "mm")


def test_config_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "show", "room", "--json"]) == 0
    shown = {row["key"]: row for row in json.loads(capsys.readouterr().out)["keys"]}
    assert shown["kind"]["value"] == "room"
    assert shown["width"] | {"meaning": ""} == {
        "key": "width", "value": 256, "unit": "px", "range": "16 to 8192", "meaning": ""
    }  # fmt: skip


@pytest.mark.parametrize("preset", PRESETS)
def test_what_config_show_prints_is_the_configuration(
    preset: presets.Preset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["config", "show", preset]) == 0
    printed = capsys.readouterr().out
    assert load_config(write(tmp_path, printed), {}) == load_config(None, {}, preset)
    assert "# Image width in pixels. (px, 16 to 8192)\nwidth = " in printed
    assert max(len(line) for line in printed.splitlines() if line.startswith("#")) <= 80


def test_options_are_described_as_the_keys_they_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dataset", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for key in ("scenes", "seed", "kind", "spp"):
        field = DatasetConfig.model_fields[key]
        assert f"{' '.join((field.description or '').split())} (default: {field.default})" in shown


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(ValidationError, match="kind"):
        DatasetConfig(kind="moon")
