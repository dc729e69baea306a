"""What a dataset will cost: a few of its scenes are made, as its workers would, and the rest is arithmetic."""

import math
import multiprocessing
import os
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, stdev

from pebble import ProcessPool

from multilight.datagen.backends.choose import resolve_renderer
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import UserError
from multilight.datagen.production.library import check_library
from multilight.datagen.production.worker import WorkerSetup, run_scene, scenes_a_worker
from multilight.datagen.report import Report
from multilight.datagen.storage.store import scene_dir
from multilight.scenes.errors import MultilightError
from multilight.scenes.random_streams import Streams

LEAST = 6
"""Scenes that are made at least, where there are so many: two tell nothing of how they differ."""
SURE = 0.06
"""Standard error of the mean cost, as a share of it, that is enough."""


@dataclass(frozen=True)
class Measured:
    """One scene as it was made: core-seconds, peak memory of its process and size on disk [bytes].

    `start` are the core-seconds that the process needed before, 0 but for its first scene.
    """

    core_seconds: float
    start: float
    memory: int
    size: int


@dataclass(frozen=True)
class Estimate:
    """What `scenes` scenes cost: `core_seconds` each, give or take `error` (one standard error), on one core.

    `start` are core-seconds each time a worker starts, once in `a_worker` scenes; `memory` is the most that a
    worker took [bytes], `size` the mean of a scene on disk [bytes], `measured` how many were made, `failed` how many of
    those that were tried could not be, which the cost leaves out.
    """

    scenes: int
    core_seconds: float
    error: float
    start: float
    a_worker: int
    memory: int
    size: float
    measured: int
    failed: int

    def core_hours(self) -> float:
        """Return the core-hours of all scenes, workers' starts included."""
        return (self.scenes * self.core_seconds + math.ceil(self.scenes / self.a_worker) * self.start) / 3600

    def workers(self, cores: int, memory: int) -> int:
        """Return how many workers a machine of so many cores and bytes holds, at least one; a tenth is kept free."""
        return max(1, min(cores, int(0.9 * memory / self.memory)))

    def hours(self, machines: int, cores: int, memory: int) -> float:
        """Return the hours until all machines are done, each worker with its share of the scenes."""
        workers = machines * self.workers(cores, memory)
        return max(self.core_hours() / workers, (self.start + self.core_seconds) / 3600)


def estimate(
    config: DatasetConfig, assets: Sequence[Path], *, workers: int, seconds: float, report: Report
) -> Estimate:
    """Make scenes of a dataset, drawn by lot, in a temporary folder, until their mean cost is known or time is up.

    `seconds` are the wall's; scenes that are begun are finished. Raises `UserError` where none could be made.
    """
    renderer = resolve_renderer(config.renderer)
    check_library(config, tuple(assets))
    order = Streams(config.seed, 0)("estimate").permutation(config.scenes).tolist()
    found: list[Measured] = []
    with tempfile.TemporaryDirectory(prefix="multilight-plan-") as folder:
        setup = WorkerSetup(config, renderer, Path(folder), tuple(assets), _threads(workers), os.getpid(), "plan")
        begun, failed = time.monotonic(), list[str]()
        with _pool(workers) as pool:
            waiting: set[Future[Measured]] = set()
            while order or waiting:
                over = time.monotonic() - begun > seconds or _sure(found)
                while order and not over and len(waiting) < workers:
                    waiting.add(pool.schedule(_measured, args=(setup, order.pop(0))))
                if not waiting:
                    break
                done, waiting = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in done:
                    try:
                        found.append(future.result())
                    except MultilightError as error:
                        failed.append(str(error))
                report(min(time.monotonic() - begun, seconds), seconds, f"making scenes to measure ({len(found)} made)")
    if not found:
        raise UserError(f"no scene could be made: {failed[-1] if failed else 'time was up'}")
    costs = [one.core_seconds for one in found]
    starts = [one.start for one in found if one.start]
    return Estimate(
        scenes=config.scenes,
        core_seconds=fmean(costs),
        error=_error(costs),
        start=fmean(starts),
        a_worker=scenes_a_worker(renderer, config),
        memory=max(one.memory for one in found),
        size=fmean(one.size for one in found),
        measured=len(found),
        failed=len(failed),
    )


def _error(costs: Sequence[float]) -> float:
    return stdev(costs) / math.sqrt(len(costs)) if len(costs) > 1 else costs[0]


def _sure(found: Sequence[Measured]) -> bool:
    costs = [one.core_seconds for one in found]
    return len(costs) >= LEAST and _error(costs) <= SURE * fmean(costs)


def _threads(workers: int) -> int:
    return max(1, len(os.sched_getaffinity(0)) // workers)


@contextmanager
def _pool(workers: int) -> Iterator[ProcessPool]:
    pool = ProcessPool(max_workers=workers, context=multiprocessing.get_context("spawn"))
    try:
        yield pool
    finally:
        pool.stop()
        pool.join()


def _measured(setup: WorkerSetup, index: int) -> Measured:
    """Make a scene in a worker and say what it took."""
    wall, computed = time.perf_counter(), time.process_time()
    told = run_scene(setup, index, False)
    share = min(sum(told.seconds.values()) / (time.perf_counter() - wall), 1.0)
    spent = time.process_time() - computed
    files = (file for file in scene_dir(setup.root, index).rglob("*") if file.is_file())
    first = not _MADE
    _MADE.append(index)
    return Measured(
        core_seconds=share * spent,
        start=computed + (1 - share) * spent if first else 0.0,
        memory=_most_memory(),
        size=sum(file.stat().st_size for file in files),
    )


def _most_memory() -> int:
    """Return the most memory that this process took [bytes]; not by `getrusage`, which counts what its parent had."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM:"))


_MADE: list[int] = []
"""Scenes that this process has made."""
