"""Several drivers on one folder, killed, stopped and starved at random moments: the bytes stay those of a run alone.

    python -m tests.datagen.driver_faults SEED [SEED ...] --kills 300

Each driver plays a machine of its own, known to the others by its signs of life only, makes scenes in its own process,
and writes the index every fraction of a second. At random moments one is killed, or stopped for longer than its lease
lasts and woken again, or the clock on the wall jumps; in some rounds the disk is full, or writes fail or are short
(`faulty_machine.c`, where there is a compiler). A round ends when a driver finds nothing left to do. At every moment a
scene that has its name is whole, and at the end of a round all bytes are those of an undisturbed run, and nothing else
is left.
"""

import contextlib
import multiprocessing
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, field
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import tyro

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import RunStoppedError, UserError
from multilight.datagen.production import drivers, running, scene, worker
from multilight.datagen.production.crew import Failed, Limits, limits_for
from multilight.datagen.production.dataset import make_dataset
from multilight.datagen.production.running import Plan
from multilight.datagen.production.scene import SceneMaker, make_scene
from multilight.datagen.production.shards import Shard
from multilight.datagen.production.worker import WorkerReport, WorkerSetup, report_of
from multilight.datagen.report import silent
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import read_scene, scene_dir, scene_indices
from multilight.datagen.verification.views import Fault
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.errors import MultilightError
from multilight.scenes.random_streams import Streams
from tests.datagen.faults import small_disk, tree

DRIVERS = 4
PATIENCE = 3.0
"""Seconds without a new scene after which the next thing is done to them."""
LEASE = 0.4
"""Seconds, instead of a minute; signs of life come eight times as often."""
FAULTS = "faults"
"""The file that says which."""
KINDS = ("plain", "full disk", "failing writes")


class Here:
    """Makes scenes in the driver's own process, one after the other."""

    count = 1

    def __init__(self, setup: WorkerSetup, limits: Limits, count: int) -> None:
        backend = AnalyticBackend().__enter__()
        self._maker = SceneMaker(setup.config, "analytic", setup.root, AssetLibrary(), backend, 1, token=setup.token)
        self._setup = setup

    def start(self, index: int, replace: bool) -> "Future[object]":
        future: Future[object] = Future()
        try:
            told = report_of(make_scene(self._maker, index, replace=replace), {})
            future.set_result(worker._sent(self._setup, told, replace=replace) if self._setup.address else told)
        except Exception as error:
            future.set_exception(error)
        return future

    def told(self, index: int, future: "Future[object]") -> WorkerReport | Failed:
        try:
            report = future.result()
            assert isinstance(report, WorkerReport)
            return report
        except RunStoppedError:
            raise
        except Exception as error:
            return Failed(repr(error), again=not isinstance(error, UserError))

    def stop(self, *, at_once: bool) -> None:
        pass


def config_of(seed: int, scenes: int) -> DatasetConfig:
    """The cheapest scenes: what is tried is what is done with them."""
    small = {"width": 16, "height": 16, "views": 1, "spp": 1, "lights": (1, 1), "insertable": 1, "conditions": 1}
    return DatasetConfig(seed=seed, scenes=scenes, kind="spheres", renderer="analytic", **small)


def copied(alone: Path) -> Callable[..., tuple[SceneRecord, list[Fault]]]:
    """Stand in for drawing and rendering, which depend on nothing that is tried here: the files of a run alone."""

    def write(maker: SceneMaker, streams: Streams, work: Path, *_: object) -> tuple[SceneRecord, list[Fault]]:
        made = scene_dir(alone, streams.scene)
        for name in tree(made):
            (work / name).parent.mkdir(exist_ok=True)
            (work / name).write_bytes((made / name).read_bytes())
        return read_scene(made), []

    return write


def drive(root: Path, config: DatasetConfig, machine: str, shard: Shard | None, lease: float, folder: Path) -> None:
    """Be a driver; exit code 1 for what a user is told, 2 for scenes set aside, 3 for a fault of the program."""
    if root != (alone := folder / "alone"):
        scene._write_scene = copied(alone)
    running.Crew = Here  # type: ignore[misc, assignment]
    running.BETWEEN = 0.2
    drivers.BEAT, drivers.LEASE = LEASE / 8, lease
    drivers._machine = lambda: machine
    plan = Plan(root, config, tuple(range(config.scenes)), 1, limits_for(config), shard=shard, retry=True)
    try:
        os._exit(2 if make_dataset(plan, silent).failures else 0)
    except BaseException as error:
        (folder / machine).write_text(traceback.format_exc())
        os._exit(1 if isinstance(error, MultilightError | OSError) else 3)


@dataclass
class Bench:
    """A folder for one seed: what an undisturbed run gives, what is done to drivers, and what was wrong."""

    folder: Path
    seed: int
    scenes: int
    done: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rng = random.Random(self.seed)
        self.config = config_of(self.seed, self.scenes)
        self._set(0, 0)
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload([__name__, "colour"])
        self._started = 0
        alone = self.start(self.folder / "alone", None)
        alone.join()
        self.wanted = tree(self.folder / "alone")
        assert alone.exitcode == 0, self.said(alone)
        assert len(self.wanted) == 2 + 3 * self.scenes

    def start(self, root: Path, shard: Shard | None, lease: float = LEASE) -> ForkServerProcess:
        self._started += 1
        name = f"{self._started}"
        process = self._context.Process(
            target=drive, args=(root, self.config, name, shard, lease, self.folder), name=name, daemon=True
        )
        process.start()
        return process

    def _set(self, rate: int, clock: int) -> None:
        """Say how often in a thousand writes fail, and by how many seconds the clock is wrong."""
        self._faults = rate, clock
        with (self.folder / FAULTS).open("r+b") as file:
            file.write(struct.pack("=qq", rate, clock))

    def _enlarge(self, disk: Path) -> None:
        subprocess.run(["mount", "-o", "remount,size=200m", str(disk)], check=True)

    def said(self, process: ForkServerProcess) -> str:
        path = self.folder / process.name
        return path.read_text() if path.exists() else ""

    def round(self, kind: str, kills: int) -> None:
        """Disturb drivers until a dataset is whole, killing so many at most."""
        size = sum(path.stat().st_size for path in (self.folder / "alone").rglob("*"))
        disk = self.folder / "disk"
        with small_disk(disk, f"{size // 1500}k") if kind == "full disk" else contextlib.nullcontext(disk) as place:
            if place is None:
                return
            self._set(20 * (kind == "failing writes"), 0)
            self.done[f"rounds: {kind}"] += 1
            self._disturb(disk / "set", kind, kills)
        shutil.rmtree(disk, ignore_errors=True)

    def _disturb(self, root: Path, kind: str, kills: int) -> None:
        root.mkdir(parents=True)
        live: list[ForkServerProcess] = []
        asleep: dict[int, float] = {}
        until = time.monotonic() + 120
        while True:
            while len(live) < DRIVERS:
                live.append(self.start(root, Shard(self.rng.randrange(3), 3) if self.rng.random() < 0.5 else None))
            self._wait_for_work(root)
            victim = self.rng.choice(live)
            match self.rng.choices(("kill", "stop", "jump"), (6, 2, 1))[0]:
                case "kill" if kills > 0 and victim.is_alive():
                    victim.kill()
                    kills -= 1
                    self.done["killed"] += 1
                case "stop" if victim.pid and victim.is_alive() and victim.pid not in asleep:
                    os.kill(victim.pid, signal.SIGSTOP)
                    asleep[victim.pid] = time.monotonic() + self.rng.uniform(0.5, 3) * LEASE
                    self.done["stopped beyond its lease"] += 1
                case "jump":
                    self._set(self._faults[0], self.rng.randint(-(10**6), 10**6))
                    self.done["clock jumps"] += 1
            for pid in [pid for pid, when in asleep.items() if when < time.monotonic()]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGCONT)
                del asleep[pid]
            self._look(root)
            over = [process for process in live if not process.is_alive()]
            live = [process for process in live if process.is_alive()]
            for process in over:
                if process.exitcode not in (0, 1, 2, -signal.SIGKILL) or (process.exitcode == 1 and kind == "plain"):
                    self.wrong.append(f"seed {self.seed}, {kind}: {self.said(process)}")
                if process.exitcode in (1, 2):
                    self.done["runs that ended with an error"] += 1
                    if kind == "full disk":
                        self._enlarge(root.parent)
            if any(process.exitcode == 0 for process in over) or time.monotonic() > until:
                break
        self._end(root, live, asleep, kind)

    def _wait_for_work(self, root: Path) -> None:
        """Wait until one more scene is there, and for a moment more."""
        before, until = len(scene_indices(root)), time.monotonic() + PATIENCE
        while len(scene_indices(root)) == before and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(self.rng.expovariate(1 / 0.03))

    def _end(self, root: Path, live: list[ForkServerProcess], asleep: dict[int, float], kind: str) -> None:
        """Let those that live come to an end, without faults, and one more see to what is left."""
        self._set(0, 0)
        if kind == "full disk":
            self._enlarge(root.parent)
        for pid in asleep:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        for process in live:
            process.join(60)
            if process.exitcode not in (0, 1, 2, -signal.SIGKILL) or (process.exitcode == 1 and kind == "plain"):
                self.wrong.append(f"seed {self.seed}, {kind}, at the end: {process.exitcode} {self.said(process)}")
                process.kill()
        last = self.start(root, None, lease=0)  # to which all others are dead
        last.join(60)
        if last.exitcode != 0:
            self.wrong.append(f"seed {self.seed}, {kind}, the last: {last.exitcode} {self.said(last)}")
        names = {path.name for path in root.iterdir()}
        if tree(root) != self.wanted or names != {"dataset.json", "index.parquet", "scenes"}:
            self.wrong.append(f"seed {self.seed}, {kind}: other bytes, or more: {sorted(names)}")

    def _look(self, root: Path) -> None:
        """See that every scene that has its name is whole."""
        for path in sorted((root / "scenes").glob("*")):
            name = f"scenes/{path.name}/"
            wanted = {file: digest for file, digest in self.wanted.items() if file.startswith(name)}
            if {name + file: digest for file, digest in tree(path).items()} != wanted:
                self.wrong.append(f"seed {self.seed}: {name} has its name and is not whole")


@contextlib.contextmanager
def preloaded(folder: Path) -> Iterator[bool]:
    """Have the processes that are started load what makes writes fail and clocks jump; yield False where none is."""
    before = dict(os.environ)
    if compiler := shutil.which("cc"):
        library, source = folder / "faulty_machine.so", Path(__file__).with_name("faulty_machine.c")
        subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        os.environ |= {"LD_PRELOAD": str(library), "FAULTY_ROOT": str(folder / "disk"), "FAULTY": str(folder / FAULTS)}
    os.environ |= {"OMP_NUM_THREADS": "1", "POLARS_MAX_THREADS": "1"}
    try:
        yield compiler is not None
    finally:
        os.environ.clear()
        os.environ.update(before)


def disturbed(folder: Path, seed: int, kills: int, scenes: int = 24) -> Bench:
    """Disturb drivers in rounds of all kinds until so many were killed."""
    (folder / FAULTS).write_bytes(bytes(16))
    with preloaded(folder) as able:
        bench = Bench(folder, seed, scenes)
        while bench.done["killed"] < kills and not bench.wrong:
            for kind in KINDS if able else KINDS[:2]:
                bench.round(kind, kills - bench.done["killed"])
    return bench


def main(seeds: tyro.conf.Positional[tuple[int, ...]], kills: int = 300) -> int:
    """Disturb drivers and return the exit code: 1 where something was wrong.

    Args:
        seeds: each decides what is done to whom, and when
        kills: of each seed, at least
    """
    wrong = []
    for seed in seeds:
        with tempfile.TemporaryDirectory(prefix="multilight-drivers-") as folder:
            begun = time.monotonic()
            bench = disturbed(Path(folder), seed, kills)
        counts = ", ".join(f"{count} {what}" for what, count in sorted(bench.done.items()))
        print(f"seed {seed}: {counts}; {time.monotonic() - begun:.0f} s", flush=True)
        wrong += bench.wrong
    print("\n".join(wrong) or "the bytes are those of an undisturbed run, every time")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(tyro.cli(main))
