"""The soak finds what grows, and what a run leaves."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.soak import COLUMNS, Line, compare, read, summary
from tests import ROOT

SMALL = ("--scenes", "400", "--renderer", "analytic", "--kind", "spheres", "--width", "16", "--height", "16",
         "--views", "1", "--spp", "1", "--workers", "1")  # fmt: skip


def lines_of(told: Callable[[int], dict[str, float]], lives: int = 3) -> list[Line]:
    """Write as many lines a life as would be of half an hour; what is not told stays as it is."""
    flat = dict.fromkeys(COLUMNS, 2.0)
    return [
        {"time": 30.0 * i, "scenes": i, "pid": life, **flat, **told(i)}
        for life in range(lives)
        for i in range(60 * life, 60 * life + 60)
    ]


@pytest.mark.parametrize(
    ("column", "told"),
    [
        ("temporary", lambda i: {"temporary": i // 10}),  # a file each five minutes
        ("shared", lambda i: {"shared": 2 + 2 * (i // 60)}),  # two semaphores each time the run was killed
        ("driver", lambda i: {"driver": 300 + (i % 60)}),  # a megabyte each half minute, until the run is killed
        (None, lambda i: {"largest": 900 + 300 * (i % 7 > 3), "driver": 180 + i / 30}),
    ],
)
def test_what_grows_is_found(column: str | None, told: Callable[[int], dict[str, float]]) -> None:
    lines = lines_of(told)
    assert [name for name, (*_, grows) in compare(lines).items() if grows] == [column] * (column is not None)
    assert summary(lines).count("grows") == (column is not None)


def test_it_goes_on_where_it_was_killed_and_names_what_is_left(tmp_path: Path) -> None:
    """The watcher is killed outright, then ended: its run goes with it, what was seen stays."""
    lines, out = tmp_path / "soak.jsonl", tmp_path / "set"
    command = [sys.executable, "-m", "benchmarks.soak", "--lines", str(lines), "--out", str(out), "--interval", "0.3"]
    command += ["--every", "0.02", *SMALL]

    def until_seen(count: int) -> subprocess.Popen[str]:
        soak = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        while sum("scenes" in line for line in read(lines)) < count:
            assert soak.poll() is None, soak.communicate()[0]
            time.sleep(0.05)
        return soak

    first = until_seen(3)
    first.kill()
    first.communicate()
    with lines.open("a") as file:
        file.write('{"time": 3, "sce')
    (tmp_path / "soak.tmp" / "forgotten").touch()
    again = until_seen(6)
    again.send_signal(signal.SIGTERM)
    again.communicate()
    assert again.returncode == 128 + signal.SIGTERM
    *_, last = read(lines)
    assert last["left"]["processes"] == last["left"]["shared memory"] == []
    assert last["left"]["temporary files"] == [str(tmp_path / "soak.tmp" / "forgotten")]
    told = subprocess.run([*command[:5], "--summary"], cwd=ROOT, text=True, capture_output=True, check=True).stdout
    assert f"left over, temporary files: {tmp_path}/soak.tmp/forgotten" in told
