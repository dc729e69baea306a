"""Commands in a hostile terminal: closed streams, readers that leave, full outputs, signals, refused memory."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from multilight.datagen.commands.terminal import one_line
from tests import ROOT
from tests.conftest import SPHERES

RUN = f"{sys.executable} -m multilight"


def shell(command: str) -> subprocess.CompletedProcess[str]:
    """Run a line of bash; its exit code is that of the first command of a pipe."""
    return subprocess.run(
        ["bash", "-c", f"{command}; exit ${{PIPESTATUS[0]}}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def make(out: Path, scenes: int = 1) -> str:
    return f"{RUN} dataset --out {out} --scenes {scenes} --workers 2 {' '.join(SPHERES)}"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&- <&-"])
def test_scenes_are_made_with_closed_streams(closed: str, tmp_path: Path, spheres_dataset: Path) -> None:
    done = shell(f"{make(tmp_path / 'd')} {closed}")
    assert done.returncode == 0, done.stderr
    assert "failed: scene" not in done.stderr
    name = "scenes/000000/views/00.exr"
    assert (tmp_path / "d" / name).read_bytes() == (spheres_dataset / name).read_bytes()


def test_readers_that_leave_end_commands_quietly(spheres_dataset: Path) -> None:
    for command in (f"query {spheres_dataset} --json", f"query {spheres_dataset}", "config show --json", "config show"):
        done = shell(f"{RUN} {command} | true")
        assert done.stderr == ""
        assert done.returncode in (0, 128 + signal.SIGPIPE)  # 0: all was written before the reader left
    done = shell(f"(sleep 1; {RUN} query {spheres_dataset} --json) | true")
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")


def test_help_and_mistakes_that_nobody_reads_are_quiet() -> None:
    for words in ("--help", "mix --help"):
        done = shell(f"{RUN} {words} | true")
        assert (done.returncode in (0, 128 + signal.SIGPIPE), done.stderr) == (True, "")
        done = shell(f"{RUN} {words} > /dev/full")
        assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert shell(f"{RUN} mixx 2>/dev/full").returncode != 0


def test_terminals_and_locales_of_other_alphabets(spheres_dataset: Path, tmp_path: Path) -> None:
    plain = "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 PYTHONIOENCODING=latin-1"
    for words in (
        "--help",
        "query --help",
        "config show",
        f"verify {spheres_dataset} --quick",
        f"query {spheres_dataset}",
    ):
        done = shell(f"{plain} {RUN} {words}")
        assert (done.returncode, done.stderr) == (0, "")
    code = "from multilight.datagen.storage.store import write_text, Path; "
    code += f"write_text(Path('{tmp_path}/t'), 'Gr\\u00fc\\u00dfe')"
    assert shell(f'{plain} {sys.executable} -X utf8=0 -c "{code}"').stderr == ""
    assert (tmp_path / "t").read_text(encoding="utf-8") == "Grüße"


def test_native_warnings_stay_out_of_standard_output(spheres_dataset: Path, tmp_path: Path) -> None:
    """OpenEXR's binding prints its own where it cannot decode a part."""
    shutil.copytree(spheres_dataset, tmp_path / "d")
    path = tmp_path / "d" / "scenes" / "000000" / "views" / "00.exr"
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 64] = bytes(byte ^ 0x5A for byte in content[middle : middle + 64])
    path.write_bytes(content)
    done = shell(f"{RUN} mix {tmp_path / 'd'} --out {tmp_path / 'm.png'}")
    assert (done.returncode, done.stdout) == (1, "")
    assert "Warning: " in done.stderr
    assert "00.exr cannot be decoded" in done.stderr


def test_output_that_is_full_is_one_line(spheres_dataset: Path) -> None:
    for command in (f"query {spheres_dataset}", f"query {spheres_dataset} --json", "config show"):
        done = shell(f"{RUN} {command} > /dev/full")
        assert done.returncode == 1
        assert done.stderr == "error: No space left on device; free some space, or choose another place\n"


def test_refused_memory_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    done = shell(f"ulimit -v 1000000; {make(tmp_path / 'd')}")
    assert done.returncode == 1
    assert done.stderr.startswith("error: memory is limited to 1024 MB")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "d").exists()


@pytest.fixture(params=[signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    """A signal that ends what is started, whatever started the tests (`nohup` and `&` have some ignored)."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_signals_stop_workers_and_say_so(number: signal.Signals, tmp_path: Path) -> None:
    semaphores = {path.name for path in Path("/dev/shm").glob("sem.mp-*")}
    process = subprocess.Popen(make(tmp_path / "d", 40).split(), cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "d").glob("scenes/*")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert said.splitlines()[-1] == "stopped; the same command goes on where it was"
    assert "semaphore" not in said
    assert "Traceback" not in said
    assert not (tmp_path / "d" / "work").exists()
    assert {path.name for path in Path("/dev/shm").glob("sem.mp-*")} <= semaphores | others()


def others() -> set[str]:
    """Return the semaphores of processes that have nothing to do with this one."""
    open_by = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        try:
            open_by |= {
                line.split("/dev/shm/")[1].split()[0] for line in maps.read_text().splitlines() if "sem.mp-" in line
            }
        except OSError:
            continue
    return open_by


def test_ignored_signals_stay_ignored(tmp_path: Path) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = subprocess.Popen(make(tmp_path / "d").split(), cwd=ROOT, stderr=subprocess.PIPE, text=True)
        time.sleep(1.5)
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=60)
        assert process.returncode == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_link_that_leads_nowhere_is_said(tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "none" / "there")
    done = shell(make(link))
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "is a link that leads nowhere" in done.stderr


def test_messages_are_one_line_whatever_is_in_them() -> None:
    assert one_line("a\nb \x1b[31mred\udcff") == "a b \\x1b[31mred\\udcff"
    assert len(one_line("x" * 10_000)) == 2000
    assert one_line("Grüße, 世界") == "Grüße, 世界"


def test_arguments_that_are_no_text_or_endless_are_refused(tmp_path: Path) -> None:
    for word in (os.fsencode(tmp_path) + b"/\xff", b"9" * 100_000):
        words = [*RUN.encode().split(), b"dataset", b"--seed", b"1", b"--out", word]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, timeout=60, check=False)
        assert done.returncode == 2
        assert done.stderr.startswith(b"error: ")
        assert done.stderr.count(b"\n") == 1
        assert len(done.stderr) < 500
