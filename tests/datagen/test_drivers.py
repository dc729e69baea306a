"""Several runs on one folder: they share the work, take over from dead ones, and leave the bytes of a single run."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.datagen.production.drivers import FOLDER, LEASE, Driver
from multilight.datagen.production.shards import Shard, parse_shard
from multilight.datagen.storage.store import file_sha256, scene_indices

SCENES = 12
SETTINGS = ["--renderer", "analytic", "--kind", "spheres", "--width", "32", "--height", "32"]
SETTINGS += ["--views", "1", "--spp", "1", "--workers", "1"]


def contents(root: Path) -> dict[str, str]:
    return {
        p.relative_to(root).as_posix(): file_sha256(p) for p in root.rglob("*") if p.is_file() and p.name != ".lock"
    }


def start(root: Path, *words: str, **environment: str) -> "subprocess.Popen[str]":
    command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), "--scenes", str(SCENES)]
    return subprocess.Popen(
        [*command, *SETTINGS, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    )


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("alone") / "set"
    assert main(["dataset", "--out", str(root), "--scenes", str(SCENES), *SETTINGS]) == 0
    return root


def test_five_runs_of_which_two_are_killed(alone: Path, tmp_path: Path) -> None:
    root, rng = tmp_path / "set", random.Random(0)
    runs = [start(root, *words) for words in (("--shard", "0/2"), ("--shard", "1/2"), (), (), ())]
    try:
        while len(scene_indices(root)) < 2:
            time.sleep(0.05)
        for run in rng.sample(runs, 2):
            time.sleep(rng.random() / 4)
            run.send_signal(signal.SIGKILL)
        ended = [(run.communicate(), run.returncode) for run in runs]
    finally:
        for run in runs:
            run.kill()
    assert {code for _, code in ended} <= {0, -signal.SIGKILL}, ended
    assert contents(root) == contents(alone)


def test_shards_of_their_own_are_parts(tmp_path: Path) -> None:
    root = tmp_path / "set"
    run = start(root, "--shard", "auto", SLURM_ARRAY_TASK_ID="3", SLURM_ARRAY_TASK_MIN="1", SLURM_ARRAY_TASK_COUNT="8")
    said, _ = run.communicate(timeout=300)
    assert run.returncode == 0
    assert scene_indices(root) == [2, 10]
    assert "all 2 scenes ok: 2 made, 0 kept" in said
    assert not (root / FOLDER).exists()


@pytest.mark.parametrize(
    ("text", "environment", "expected"),
    [
        ("2/8", {}, Shard(2, 8)),
        ("auto", {"SLURM_ARRAY_TASK_ID": "4", "SLURM_ARRAY_TASK_COUNT": "8", "SLURM_ARRAY_TASK_MIN": "1"}, Shard(3, 8)),
        ("auto", {"AWS_BATCH_JOB_ARRAY_INDEX": "0", "AWS_BATCH_JOB_ARRAY_SIZE": "3"}, Shard(0, 3)),
        ("auto/4", {"JOB_COMPLETION_INDEX": "3"}, Shard(3, 4)),
        ("8/8", {}, "counted from 0 to 7"),
        ("-1/8", {}, "say I/N"),
        ("2", {}, "say I/N"),
        ("auto", {}, "none of SLURM"),
        ("auto", {"JOB_COMPLETION_INDEX": "3"}, "give --shard auto/N"),
        ("auto", {"SLURM_ARRAY_TASK_ID": "x", "SLURM_ARRAY_TASK_COUNT": "8"}, "is no number"),
    ],
)  # fmt: skip
def test_shards_as_they_are_said(text: str, environment: dict[str, str], expected: Shard | str) -> None:
    if isinstance(expected, Shard):
        assert parse_shard(text, environment) == expected
        return
    with pytest.raises(UserError, match=expected):
        parse_shard(text, environment)


def test_claims_go_with_those_who_hold_them(tmp_path: Path) -> None:
    first, second = Driver(tmp_path), Driver(tmp_path)
    assert first.claim(3)
    assert not second.claim(3)
    first.release(3)
    assert second.claim(3)
    assert first.others() == [second.token]
    second.leave()
    assert first.claim(3), "a run that has left holds nothing"
    first.leave()
    assert not (tmp_path / FOLDER).exists()


def test_a_run_on_another_machine_is_dead_when_it_gives_no_sign(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: clock[0])
    other = "0123456789ab"
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / other).write_text("another machine")
    (tmp_path / FOLDER / "000003").write_text(other)
    (tmp_path / "work" / f"000003-77-{other}").mkdir(parents=True)
    os.utime(tmp_path / FOLDER / other, (0, 1e10))  # its clock is not asked
    here = Driver(tmp_path)
    for beat in range(3):
        os.utime(tmp_path / FOLDER / other, (0, beat))
        assert not here.claim(3)
        clock[0] += LEASE - 1
        assert not here.claim(3)
    assert (tmp_path / "work" / f"000003-77-{other}").exists()
    clock[0] += 2
    assert here.claim(3)
    here.leave()


def test_a_killed_runs_remains_go(tmp_path: Path) -> None:
    code = (
        "import os, sys; from pathlib import Path; from multilight.datagen.production.drivers import Driver\n"
        "root = Path(sys.argv[1]); driver = Driver(root); driver.claim(1)\n"
        "(root / 'work' / f'000001-5-{driver.token}').mkdir(parents=True); os._exit(9)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False, timeout=60)
    assert list((tmp_path / "work").iterdir())
    driver = Driver(tmp_path)
    assert not list((tmp_path / "work").iterdir())
    assert driver.claim(1)
    driver.leave()
    assert not list(tmp_path.iterdir())


def test_repairing_while_others_work_is_the_same(alone: Path, tmp_path: Path) -> None:
    import shutil

    root = tmp_path / "set"
    shutil.copytree(alone, root)
    for index in range(0, SCENES, 3):
        os.truncate(root / f"scenes/{index:06d}/scene.json", 100)
    runs = [start(root) for _ in range(2)]
    for run in runs:
        _, said = run.communicate(timeout=300)
        assert run.returncode == 0, said
    assert contents(root) == contents(alone)
    assert main(["verify", str(root), "--quick", "--json"]) == 0
    assert json.loads((root / "dataset.json").read_text())["index_rows"] == SCENES
