"""Scenes that take too long or too much memory: ended, told, tried again, set aside; the run goes on."""

import os
import re
import shutil
from concurrent.futures import wait
from pathlib import Path

import pytest

from multilight.datagen.backends.machine import memory
from multilight.datagen.cli import main
from multilight.datagen.production import crew
from multilight.datagen.production.aside import aside_path
from multilight.datagen.production.crew import Crew, Failed, Limits
from multilight.datagen.production.worker import WorkerReport, WorkerSetup
from multilight.datagen.storage.store import read_dataset
from tests.datagen.test_drivers import contents


def made(data: Path, root: Path, limits: Limits) -> WorkerReport | Failed:
    """Make a scene of a dataset again in another folder, within limits."""
    config = read_dataset(data).config.model_copy(update={"views": 40})
    workers = Crew(WorkerSetup(config, "analytic", root, (), 1, os.getpid(), "me"), limits, 1)
    try:
        future = workers.start(0, False)
        wait([future], timeout=120)
        return workers.told(0, future)
    finally:
        workers.stop(at_once=True)


@pytest.mark.parametrize(
    ("limits", "free", "said"),
    [
        (Limits(0.3), 10**10, "took longer than 0 s; raise --limit-minutes"),
        (Limits(100, 10**8), 10**10, "needed more than 0.1 GB of memory; lower --width"),
        (Limits(100), 10**8, "memory ran out while it had 0.[0-9] GB"),
    ],
)
def test_what_takes_too_much_is_ended_and_told(
    limits: Limits, free: int, said: str, spheres_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crew, "free_bytes", lambda: free)
    told = made(spheres_dataset, tmp_path, limits)
    assert isinstance(told, Failed)
    assert told.again
    assert re.match(said, told.reason)
    assert not (tmp_path / "scenes").exists()


def test_after_three_tries_a_scene_is_set_aside_until_it_is_asked_for(
    spheres_dataset: Path, spheres_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = spheres_copy
    shutil.rmtree(root / "scenes" / "000001")
    words = ["dataset", "--out", str(root), "--workers", "1"]
    assert main([*words, "--limit-minutes", "0.001"]) == 1
    said = capsys.readouterr()
    assert said.err.count("tried again: scene 1: took longer than 0 s") == 2
    assert f"(seed {read_dataset(root).config.seed}, log {aside_path(root, 1)})" in said.err
    assert "1 of 2 scenes ok: 0 made, 1 kept, 1 failed, 2 tries failed" in said.out
    assert aside_path(root, 1).read_text().startswith("took longer")
    assert main(words) == 1
    said = capsys.readouterr()
    assert "failed: scene 1: took longer than 0 s" in said.err
    assert "tried again:" not in said.err
    assert main([*words, "--retry"]) == 0
    assert contents(root) == contents(spheres_dataset)


@pytest.mark.parametrize("name", ["--limit-minutes", "--limit-memory"])
def test_limits_must_be_more_than_nothing(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["dataset", "--out", str(tmp_path / "d"), name, "0"]) == 1
    assert f"{name} 0.0 must be more than 0" in capsys.readouterr().err


@pytest.mark.parametrize("version", [1, 2])
def test_a_container_has_what_it_is_allowed_less_what_is_used(
    version: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (_, *names), = [row for row in memory.CONTAINERS if ("max" in row[1]) == (version == 2)]  # fmt: skip
    monkeypatch.setattr(memory, "CONTAINERS", ((f"{tmp_path}/", *names),))
    (tmp_path / names[0]).write_text("500000\n")
    (tmp_path / names[1]).write_text("300000\n")
    (tmp_path / "memory.stat").write_text(f"anon 200000\n{names[2]} 100000\n")
    assert memory.free_bytes() == 300_000
    assert memory.whole_bytes() == 500_000
    (tmp_path / names[0]).write_text("max\n")
    assert memory.whole_bytes() > memory.free_bytes() > 10**7
