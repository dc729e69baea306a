"""The command `plan`: arithmetic by hand, and a real run whose bytes are those of the dataset that it stands for."""

import json
import tempfile
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.config.dataset import load_config
from multilight.datagen.errors import UserError
from multilight.datagen.production import estimate as production
from multilight.datagen.production.estimate import LEAST, Estimate
from multilight.datagen.production.worker import WorkerSetup
from multilight.datagen.report import silent
from tests.conftest import SPHERES

GB = 10**9


def one_fails(setup: WorkerSetup, index: int) -> production.Measured:
    if index == 1:
        raise UserError("scene 1 has no room for a plate")
    return production.Measured(core_seconds=1.0, start=1.0, memory=GB, size=10)


def test_hours_are_core_seconds_and_starts_over_workers() -> None:
    found = Estimate(
        scenes=1000,
        core_seconds=36.0,
        error=1.0,
        start=90.0,
        a_worker=25,
        memory=2 * GB,
        size=5.0,
        measured=10,
        failed=0,
    )
    assert found.core_hours() == pytest.approx(10 + 1)  # 1000 scenes, and 40 starts: one in 25 scenes
    assert found.workers(cores=16, memory=64 * GB) == 16
    assert found.workers(cores=64, memory=20 * GB) == 9  # a tenth is kept free
    assert found.workers(cores=2, memory=GB) == 1
    assert found.hours(machines=2, cores=11, memory=100 * GB) == pytest.approx(0.5)
    # However many machines, a scene takes its time.
    assert found.hours(machines=10**6, cores=64, memory=200 * GB) == pytest.approx((90 + 36) / 3600)


def test_it_measures_what_the_dataset_then_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    assert main(["plan", *SPHERES, "--scenes", "8", "--minutes", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert LEAST <= told["measured"] <= 8
    assert not list(temporary.iterdir())
    assert told["core_seconds"] > 0.01
    assert told["start"] > 0.1
    assert 5e7 < told["memory"] < 2e9
    assert main(["dataset", "--out", str(tmp_path / "made"), *SPHERES, "--scenes", "8"]) == 0
    made = sum(file.stat().st_size for file in (tmp_path / "made" / "scenes").rglob("*.*"))
    assert told["bytes"] == pytest.approx(made, rel=0.2)


def test_it_says_so_in_words(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["plan", *SPHERES, "--scenes", "3", "--minutes", "0.01", "--machines", "4", "--cores", "8", "--memory", "1"]
    assert main(words) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[0] == "3 scenes of 3 views of 64 x 48 pixels"
    assert "as many as the memory holds" in told[2]
    assert max(map(len, told)) <= 100


def test_scenes_that_cannot_be_made_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three scenes one fails in its worker."""
    size = {"width": 32, "height": 24, "views": 1}
    config = load_config(None, {"scenes": 3, "kind": "spheres", "renderer": "analytic"} | size)
    monkeypatch.setattr(production, "_measured", one_fails)
    found = production.estimate(config, (), workers=1, seconds=60, report=silent)
    assert (found.measured, found.failed) == (2, 1)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--machines 0", "--machines 0 must be more than 0"),
        ("--cores -1", "--cores -1 must be more than 0"),
        ("--memory 0", "--memory 0.0 must be more than 0"),
        ("--minutes 0", "--minutes 0.0 must be more than 0"),
    ],
)
def test_options_that_cannot_be(words: str, expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", *SPHERES, *words.split()]) == 1
    assert expected in capsys.readouterr().err
