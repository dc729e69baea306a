"""What a dataset in the making tells from the outside, and the log of a run."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.production.drivers import FOLDER
from multilight.datagen.production.status import RunState, Status, kind_of_failure, prometheus
from multilight.datagen.storage.store import scene_indices

SETTINGS = ["--renderer", "analytic", "--kind", "spheres", "--width", "32", "--height", "32"]
SETTINGS += ["--views", "1", "--spp", "1", "--workers", "1"]
RUN = RunState(
    host="node", process=7, time=0.0, seconds=1800.0, workers=2, made=3, in_work=(4, 5), memory=10, free_memory=20,
    free_disk=30,
)  # fmt: skip
FAILED = {"took longer than 600 s": [2, 6]}


def test_a_run_is_seen_from_another_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root, log = tmp_path / "set", tmp_path / "log.jsonl"
    command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), "--scenes", "400", *SETTINGS]
    run = subprocess.Popen([*command, "--log-json", str(log)], stderr=subprocess.PIPE, text=True)
    try:
        while not scene_indices(root):
            time.sleep(0.05)
        assert main(["status", str(root), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["scenes"] == 400
        assert 1 <= found["done"] < 400
        assert found["in_work"] >= 0
        (told,) = found["runs"]
        assert told["process"] == run.pid
        assert told["memory"] > 50e6
        assert main(["status", str(root)]) == 0
        assert f"process {run.pid}: " in capsys.readouterr().out
        before = sorted(path.name for path in (root / FOLDER).iterdir())
        assert any(name.endswith(".json") for name in before)
    finally:
        run.send_signal(signal.SIGTERM)
        _, said = run.communicate(timeout=60)
    assert run.returncode == 143, said
    assert not (root / FOLDER).exists()
    assert main(["status", str(root)]) == 0
    assert "no run is at work" in capsys.readouterr().out
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert [lines[0]["event"], lines[-1]["event"]] == ["run begins", "run stopped"]
    assert lines[0]["missing"] == 400
    assert {"scene", "views", "bytes", "seconds", "time"} <= lines[1].keys()
    assert sorted(line["scene"] for line in lines[1:-1]) == scene_indices(root)[: len(lines) - 2]


def test_numbers_of_all_runs_together() -> None:
    other = RUN.model_copy(update={"made": 0, "in_work": (5, 9)})
    status = Status("out/set", 20, 8, {}, (RUN, other))
    assert (status.in_work, status.per_hour, status.seconds_left) == (3, 6.0, 7200.0)
    assert Status("out/set", 20, 8, {}, ()).seconds_left is None


@pytest.mark.parametrize(
    ("reason", "kind"),
    [
        ("took longer than 600 s and was stopped (seed 0, log x)", "took longer than 600 s and was stopped"),
        ("scene 5 (seed 3) failed its checks 3 times: noise: view 1", "failed its checks 3 times"),
        ("ValueError: no", "ValueError"),
    ],
)
def test_failures_alike(reason: str, kind: str) -> None:
    assert kind_of_failure(reason) == kind


def test_prometheus_text(tmp_path: Path) -> None:
    text = prometheus(Status('a"b\\c\n', 20, 8, FAILED, (RUN,)))
    number = r"[-+]?[0-9.]+(e[-+][0-9]+)?"
    for line in text.splitlines():
        label = r'[a-z_]+="([^"\\\n]|\\["\\n])*"'
        assert re.fullmatch(rf"# (HELP|TYPE) multilight_\w+ .+|multilight_\w+{{{label}(,{label})*}} {number}", line), (
            line
        )
    named = 'dataset="a\\"b\\\\c\\n"'
    assert f'multilight_scenes{{{named},state="done"}} 8\n' in text
    assert f'multilight_scenes_failed{{{named},reason="took longer than 600 s"}} 2\n' in text
    assert f'multilight_run_memory_bytes{{{named},host="node",process="7"}} 10\n' in text
    assert text.count("# TYPE") == len(set(re.findall("# TYPE (.+) gauge", text)))


def test_files_that_are_written(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = str(spheres_dataset)
    assert main(["status", root, "--prometheus", "--out", str(tmp_path / "m.prom")]) == 0
    assert 'state="done"' in (tmp_path / "m.prom").read_text()
    assert main(["dataset", "--out", root, *SETTINGS, "--log-json", str(tmp_path)]) == 1
    assert "it is a folder or a device; name a file" in capsys.readouterr().err


def test_a_log_that_cannot_be_written_is_told_once(
    spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "log").symlink_to("/dev/full")
    assert main(["dataset", "--out", str(spheres_dataset), "--log-json", str(tmp_path / "log")]) == 0
    assert capsys.readouterr().err.count("cannot be written: No space left on device") == 1
