"""Hours of `multilight dataset`, disturbed now and then: does anything grow, and what is left over?

Runs the command at low priority, with the options that follow, kills a worker or the whole run, which is started anew,
or stops a worker for some seconds, at moments that a seed decides; adds a line of JSON each half minute to a file, and
one for each fault. Its own end at any moment loses nothing: called again, it goes on with the same file.

    python -m benchmarks.soak --lines out/soak.jsonl --out out/soaked --hours 4 --preset volume --workers 1
    python -m benchmarks.soak --lines out/soak.jsonl --summary --plot docs/soak.png    # meanwhile, or afterwards
"""

import contextlib
import json
import os
import random
import re
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import tyro

MARK = "MULTILIGHT_SOAK"
"""The variable that all processes of the run inherit, by which they are found."""
KILLED, STOPPED = "the run killed", "a worker stopped"
FAULTS = "a worker killed", KILLED, STOPPED
COLUMNS = {
    "driver": ("memory of the driver [MB]", 25.0),
    "largest": ("memory of the largest worker [MB]", 100.0),
    "workers": ("memory of all workers [MB]", 200.0),
    "open": ("open files of the driver", 3.0),
    "processes": ("processes", 1.0),
    "temporary": ("temporary files", 2.0),
    "temporary_size": ("temporary files [MB]", 5.0),
    "work": ("files in work", 10.0),
    "work_size": ("files in work [MB]", 50.0),
    "shared": ("files in shared memory", 1.0),
}
"""What is watched, and how much more of it, or a tenth, is none."""
PATIENCE = 30.0
"""Seconds in which all is gone that a run leaves when it ends."""

Line = dict[str, Any]


@dataclass
class Options:
    """What to watch; what else is given goes to `multilight dataset`."""

    lines: Path
    """The file of what was seen; FILE.log has what the command says, FILE.tmp its temporary files."""
    out: Path = Path("out/soaked")
    hours: float = 4.0
    every: float = 10.0
    """Minutes from one fault to the next, on average."""
    interval: float = 30.0
    """Seconds from one line to the next."""
    faults_seed: int = 1
    summary: bool = False
    """Only say what the lines tell."""
    plot: Path | None = None


def read(path: Path) -> list[Line]:
    """Read the lines that are whole: the writer of others was killed."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def compare(seen: list[Line]) -> dict[str, tuple[float, float, float, bool]]:
    """Return each column's medians in the first and the last quarter, what a driver's life adds, whether it grows.

    What it adds is its last quarter's median less its first's, the median over lives.
    """
    lives: dict[int, list[Line]] = {}
    for line in seen:
        lives.setdefault(line["pid"], []).append(line)
    found = {}
    for column, (_, none) in COLUMNS.items():
        ends = [_ends(life, column) for life in lives.values() if len(life) >= 8]
        first, last = _ends(seen, column)
        added = statistics.median([end - start for start, end in ends] or [0.0])
        found[column] = first, last, added, max(last - first, added) > max(none, first / 10)
    return found


def _ends(seen: list[Line], column: str) -> tuple[float, float]:
    quarter = -(-len(seen) // 4)
    values = [float(line[column]) for line in seen]
    return statistics.median(values[:quarter]), statistics.median(values[-quarter:])


def summary(lines: list[Line]) -> str:
    """Put first and last quarter side by side, count scenes and faults, and say what is left over."""
    seen = [line for line in lines if "scenes" in line]
    faults = Counter(line["fault"] for line in lines if "fault" in line)
    quarter = -(-len(seen) // 4)
    first, last = (
        3600 * (part[-1]["scenes"] - part[0]["scenes"]) / max(1.0, part[-1]["time"] - part[0]["time"])
        for part in (seen[:quarter], seen[-quarter:])
    )
    told = [
        f"{seen[-1]['scenes']} scenes; in {(seen[-1]['time'] - seen[0]['time']) / 3600:.2f} h "
        + (", ".join(f"{count} x {fault}" for fault, count in sorted(faults.items())) or "no fault"),
        f"{'':36}{'first quarter':>14}{'last quarter':>14}{'in a life':>11}",
        f"{'scenes an hour':36}{first:14.0f}{last:14.0f}",
    ]
    for column, (first, last, added, grows) in compare(seen).items():
        told.append(f"{COLUMNS[column][0]:36}{first:14.1f}{last:14.1f}{added:+11.1f}{'  grows' * grows}")
    for what, names in next((line["left"] for line in reversed(lines) if "left" in line), {}).items():
        told.append(f"left over, {what}: " + (", ".join(names) or "nothing"))
    return "\n".join(told)


def draw(lines: list[Line], path: Path) -> None:
    """Plot what was seen over the hours, faults as upright lines."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    seen, faults = ([line for line in lines if key in line] for key in ("scenes", "fault"))
    rows = (("scenes",), ("driver", "largest"), ("open", "processes"), ("temporary", "work", "shared"))
    hours, disturbed = ([(line["time"] - seen[0]["time"]) / 3600 for line in some] for some in (seen, faults))
    figure, axes = pyplot.subplots(len(rows), 1, figsize=(8, 8), sharex=True)
    for axis, columns in zip(axes, rows, strict=True):
        for column in columns:
            axis.plot(hours, [line[column] for line in seen], label=COLUMNS.get(column, ("scenes",))[0])
        for line, hour in zip(faults, disturbed, strict=True):
            axis.axvline(hour, linewidth=0.6, color="tab:red" if line["fault"] == KILLED else "0.7", zorder=0)
        axis.set_ylim(bottom=0)
        axis.legend(loc="upper left", fontsize="small")
    axes[-1].set_xlabel("hours; upright lines: faults, red where the whole run was killed")
    figure.tight_layout()
    figure.savefig(path, dpi=100)


class Soak:
    """A run, the processes it consists of, and the file that says how it fares."""

    def __init__(self, options: Options, arguments: list[str]) -> None:
        self.options, self.out, self.lines = options, options.out.absolute(), options.lines.absolute()
        self.temporary = self.lines.with_suffix(".tmp")
        self.asked = threading.Event()  # to end, between two steps
        signal.signal(signal.SIGTERM, lambda *_: self.asked.set())
        self.temporary.mkdir(parents=True, exist_ok=True)
        self.command = [sys.executable, "-m", "multilight", "dataset", "--out", str(self.out), *arguments]
        seen = [line for line in read(self.lines) if "scenes" in line]
        self.ticks, self.shared = len(seen), set(seen[-1]["names"] if seen else ())
        with self.lines.open("a", encoding="utf-8") as file:
            file.write("\n" * bool(seen))  # the last line may have been cut
        for process in self.processes().values():  # their watcher was killed
            with contextlib.suppress(psutil.NoSuchProcess):
                if "resource_tracker" not in " ".join(process.cmdline()):  # it clears up after them, and ends
                    process.kill()
        self.start()

    def start(self) -> None:
        env = os.environ | {MARK: str(self.lines), "TMPDIR": str(self.temporary)}
        with self.lines.with_suffix(".log").open("a", encoding="utf-8") as log:
            self.driver = subprocess.Popen(self.command, stdout=log, stderr=log, env=env, start_new_session=True)

    def tell(self, line: Line) -> None:
        with self.lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": round(time.time(), 1)} | line) + "\n")

    def processes(self) -> dict[int, psutil.Process]:
        """Return the processes of the run, orphans included."""
        found = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):  # it has ended, or is another user's
                if process.environ().get(MARK) == str(self.lines):
                    found[process.pid] = process
        return found

    def work(self) -> dict[Path, int]:
        """List what lies in the dataset's folder while it is made, and should not afterwards."""
        wrong = re.compile(r"/(\.|work(/|$)|logs(/|$))")
        return {path: size for path, size in _files(self.out).items() if wrong.search(f"/{path.relative_to(self.out)}")}

    def look(self) -> Line:
        """Return what is there now; sizes in MB."""
        memory, opened = {self.driver.pid: 0.0}, 0
        for pid, process in self.processes().items():
            with contextlib.suppress(psutil.Error):
                memory[pid] = round(process.memory_info().rss / 1e6, 1)
                opened = process.num_fds() if pid == self.driver.pid else opened
                self.shared |= {name for name, *_ in process.memory_maps() if name.startswith("/dev/shm/")}
        self.shared = {name for name in self.shared if Path(name).exists()}
        line: Line = {
            "scenes": len([*self.out.glob("scenes/[0-9]*")]),
            "pid": self.driver.pid,
            "processes": len(memory),
        }
        line |= {"driver": memory.pop(self.driver.pid), "open": opened}
        line |= {"largest": max(memory.values(), default=0.0), "workers": round(sum(memory.values()), 1)}
        line |= {"shared": len(self.shared), "names": sorted(self.shared)}
        for name, paths in (("temporary", _files(self.temporary)), ("work", self.work())):
            line |= {name: len(paths), f"{name}_size": round(sum(paths.values()) / 1e6, 3)}
        return line

    def disturb(self, rng: random.Random) -> None:
        fault = rng.choice(FAULTS)
        with contextlib.suppress(psutil.NoSuchProcess, LookupError):  # there is none just now
            there = self.processes()
            workers = [process for process in there.values() if "spawn_main" in " ".join(process.cmdline())]
            victim = there[self.driver.pid] if fault == KILLED else rng.choice(workers)
            self.tell({"fault": fault, "victim": victim.pid})
            if fault == STOPPED:
                victim.suspend()
                self.asked.wait(rng.uniform(1, 20))
                victim.resume()
            else:
                victim.kill()

    def run(self) -> int:
        """Go on for so many hours, until asked to end, or until the command ends by itself; return the exit code."""
        options = self.options
        while self.ticks * options.interval < options.hours * 3600 and not self.asked.is_set():
            until = time.monotonic() + options.interval
            rng = random.Random(f"{options.faults_seed} {self.ticks}")
            if rng.random() * options.every * 60 < options.interval:
                self.asked.wait(rng.uniform(0, options.interval))
                self.disturb(rng)
            while time.monotonic() < until and self.driver.poll() is None and not self.asked.wait(0.2):
                pass
            self.ticks += 1
            code = self.driver.poll()
            if code is None:
                self.tell(self.look())
            elif code == -signal.SIGKILL:
                self.start()
            else:
                return code
        return 128 + signal.SIGTERM if self.asked.is_set() else 0

    def end(self) -> None:
        """End the run, and see what is left of it."""
        self.driver.terminate()
        psutil.wait_procs([*self.processes().values()], PATIENCE)
        self.look()
        left: dict[str, Iterable[object]] = {
            "processes": self.processes(),
            "temporary files": _files(self.temporary),
            "files in work": self.work(),
            "shared memory": self.shared,
        }
        self.tell({"left": {what: sorted(map(str, found)) for what, found in left.items()}})


def _files(folder: Path) -> dict[Path, int]:
    """List all that lies in a folder, folders as well, and its bytes, while others make and remove it."""
    found = {}
    for place, folders, files in os.walk(folder):
        for path in (Path(place, name) for name in (*folders, *files)):
            with contextlib.suppress(FileNotFoundError):
                found[path] = path.lstat().st_size
    return found


def main(options: Options, arguments: list[str]) -> int:
    code = 0
    if not options.summary:
        os.nice(19)
        soak = Soak(options, arguments)
        try:
            code = soak.run()
        finally:
            soak.end()
    lines = read(options.lines)
    if not any("scenes" in line for line in lines):
        raise SystemExit(f"{options.lines} has no lines yet")
    print(summary(lines))
    if options.plot is not None:
        draw(lines, options.plot)
    return code


if __name__ == "__main__":
    sys.exit(main(*tyro.cli(Options, return_unknown_args=True)))
