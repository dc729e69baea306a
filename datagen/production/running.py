"""Have worker processes make scenes, those that no other run on the folder has in hand."""

import contextlib
import glob
import multiprocessing
import os
import shutil
import signal
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass, field
from pathlib import Path

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from multilight.datagen.backends.protocol import LARGE
from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.errors import RunStoppedError, UserError
from multilight.datagen.files.locks import locked
from multilight.datagen.production.drivers import Driver
from multilight.datagen.production.finishing import Survey, finish
from multilight.datagen.production.shards import Shard
from multilight.datagen.production.worker import WorkerReport, WorkerSetup, log_path, run_scene
from multilight.datagen.report import Report
from multilight.datagen.storage.store import scene_dir

AHEAD = 2
"""Scenes a worker that are handed out: the one in work, and the next."""
BETWEEN = 60.0
"""Seconds from one writing of the index to the next, while scenes are made."""
PATIENCE = 600.0
"""Seconds to wait for another run that writes the index, which takes it a few."""
SCENES_A_WORKER: dict[RendererName, int] = {"cycles": 25, "mitsuba": 50, "analytic": 1000}
"""Then a fresh process: a long-lived Blender grows. A fresh one has to read its meshes and textures anew, which is
little beside a scene of large pictures: of such each has a process to itself."""
SECONDS_A_MEGASAMPLE = 60.0  # a hundred times what a slow core needs; only a hung scene exceeds it
LEAST_TIMEOUT = 600.0


def scenes_a_worker(renderer: RendererName, config: DatasetConfig) -> int:
    """Return how many scenes a process makes."""
    return 1 if config.width * config.height > LARGE else SCENES_A_WORKER[renderer]


@dataclass(frozen=True)
class Plan:
    """A run: where, what, which scenes, with how many processes.

    `repair` looks at the contents of what is there as well, not at names and sizes only. Of a `shard`, what is its own
    comes first, then help with those that others have begun.
    """

    root: Path
    config: DatasetConfig
    indices: tuple[int, ...]
    workers: int
    asset_folders: tuple[Path, ...] = ()
    repair: bool = False
    shard: Shard | None = None


@dataclass(frozen=True)
class Work:
    """Scenes in the making, and what is learned meanwhile: broken assets, where the time goes, what was drawn anew.

    `there` gets the scenes that are made, `made` the number and the bytes of their views.
    """

    plan: Plan
    renderer: RendererName
    there: Survey
    driver: Driver
    report: Report
    broken: dict[str, str] = field(default_factory=dict)
    made: dict[int, tuple[int, int]] = field(default_factory=dict)
    changed: list[int] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    thrown_away: list[str] = field(default_factory=list)

    def take(self, told: WorkerReport) -> None:
        """Count a scene in that was made."""
        index = told.row["index"]
        if self.there.stated.get(index, told.row["record_sha256"]) != told.row["record_sha256"]:
            self.changed.append(index)
        self.there.add(told.row, told.credits)
        self.made[index] = told.row["views"], told.row["bytes"]
        self.broken.update(told.broken)
        self.thrown_away.extend(told.thrown_away)
        for stage, seconds in told.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds


def run_scenes(work: Work, missing: Sequence[int], further: Sequence[int]) -> dict[int, str]:
    """Make the scenes that are missing, then help with further ones; return the reasons of those that failed.

    Ends when the missing ones are there, whoever made them.
    """
    plan = work.plan
    workers = min(plan.workers, max(1, len(missing) + len(further)))
    threads = max(1, len(os.sched_getaffinity(0)) // workers)
    setup = WorkerSetup(
        plan.config, work.renderer, plan.root, plan.asset_folders, threads, os.getpid(), work.driver.token
    )
    pool = ProcessPool(
        max_workers=workers,
        max_tasks=scenes_a_worker(work.renderer, plan.config),
        context=multiprocessing.get_context("spawn"),
    )
    hand = _Hand(work, deque(missing), deque(further))
    try:
        failures = _collect(work, hand, pool, setup, AHEAD * workers)
        pool.close()
        pool.join()
    except BaseException:
        pool.stop()
        pool.join()
        # Half-made scenes are of no use to anyone, and on a full disk they are in the way.
        for path in plan.root.glob(f"work/*-{work.driver.token}"):
            shutil.rmtree(path, ignore_errors=True)
        raise
    return failures


class _Hand:
    """The scenes that are still to be made, and which of them this run may take in hand."""

    def __init__(self, work: Work, own: deque[int], further: deque[int]) -> None:
        self._work, self.own, self._further = work, own, further
        self._before = {index: _folder(work.plan.root, index) for index in work.there.damaged}

    def next(self) -> int | None:
        """Claim a scene; None where all that are left are in others' hands."""
        found = self._claimed(self.own)
        return found if found is not None else self._claimed(self._further)

    def made(self, index: int) -> bool:
        """Whether a scene is there that was not, or was damaged, when this run began."""
        return _folder(self._work.plan.root, index) not in (None, self._before.get(index))

    def _claimed(self, left: deque[int]) -> int | None:
        shard, driver = self._work.plan.shard, self._work.driver
        begun: dict[Shard, bool] = {}
        for _ in range(len(left)):
            index = left.popleft()
            if left is self._further and shard is not None:
                if (of := shard.of(index)) not in begun:
                    begun[of] = driver.begun(of)
                if not begun[of]:
                    left.append(index)  # another job's, which will come
                    continue
            if self.made(index):
                continue
            if driver.claim(index):
                if not self.made(index):
                    return index
                driver.release(index)
            else:
                left.append(index)
        return None


def _folder(root: Path, index: int) -> int | None:
    """Return what tells a scene's folder from any other that has its name before or after; None where there is none."""
    with contextlib.suppress(OSError):
        return scene_dir(root, index).stat().st_ino
    return None


def _collect(work: Work, hand: _Hand, pool: ProcessPool, setup: WorkerSetup, most: int) -> dict[int, str]:
    """Have scenes made, few ahead of the workers; report the views on disk, and finish now and then.

    The views of a draw that is thrown away stay counted till they are made anew.
    """
    plan, driver = work.plan, work.driver
    failures: dict[int, str] = {}
    waiting: dict[ProcessFuture, int] = {}
    total, done, finished = len(hand.own) * plan.config.views, 0, time.monotonic()
    while True:
        while len(waiting) < most and (index := hand.next()) is not None:
            args = (setup, index, index in work.there.damaged)
            waiting[pool.schedule(run_scene, args=args, timeout=_timeout(plan.config))] = index
        if not waiting and not hand.own:
            return failures
        if waiting:
            over, _ = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
        else:  # all that is left is in others' hands
            over = set()
            time.sleep(0.5)
        for future in over:
            index = waiting.pop(future)
            if (reason := _failure(work, index, future)) is not None and not hand.made(index):
                failures[index] = reason
            driver.release(index)
        if time.monotonic() - finished > BETWEEN:
            with locked(plan.root, PATIENCE):
                finish(plan.root, work.there)
            finished = time.monotonic()
        # Not pathlib's glob, which fails where a folder goes away meanwhile.
        in_work = len(glob.glob(f"work/*-{driver.token}/views/*.exr", root_dir=plan.root))
        done = max(done, min((len(work.made) + len(failures)) * plan.config.views + in_work, total))
        note = "rendering" if done else "starting and drawing"
        work.report(done, total, note + (f" ({len(work.thrown_away)} drawn anew)" if work.thrown_away else ""))


def _timeout(config: DatasetConfig) -> float:
    renders = config.views * (1 + 2 * config.insertable)
    megasamples = config.width * config.height * config.spp * renders / 1e6
    return LEAST_TIMEOUT + SECONDS_A_MEGASAMPLE * megasamples


def _ended(code: int) -> str:
    """Say how a process ended; native libraries crash in many ways where memory is refused."""
    if code >= 0:
        return f"died with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}, most often for want of memory: use fewer --workers"


def _failure(work: Work, index: int, future: ProcessFuture) -> str | None:
    """Return why a scene was not made, or None; what stops every scene (a full disk) is raised."""
    plan = work.plan
    where = f"seed {plan.config.seed}, log {log_path(plan.root, index)}"
    try:
        work.take(future.result())
    except FutureTimeout:
        return f"took longer than {_timeout(plan.config):.0f} s and was stopped ({where})"
    except ProcessExpired as error:
        return f"the worker {_ended(error.exitcode)} ({where})"
    except RunStoppedError:
        raise
    except UserError as error:
        return f"{error} ({where})"
    except Exception as error:
        return f"{type(error).__name__}: {error} ({where})"
    return None
