"""Have scenes made, those that no other run on the folder has in hand."""

import glob
import os
import shutil
import time
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path

from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.production.aside import set_aside, take_up, why_aside
from multilight.datagen.production.crew import Crew, Limits, Workers
from multilight.datagen.production.drivers import Driver
from multilight.datagen.production.finishing import Survey
from multilight.datagen.production.homes import Home
from multilight.datagen.production.shards import Shard
from multilight.datagen.production.status import state_here
from multilight.datagen.production.worker import WorkerReport, WorkerSetup
from multilight.datagen.report import Report, event
from multilight.datagen.storage.address import without_password

AHEAD = 2
"""Scenes a worker that are handed out: the one in work, and the next."""
BETWEEN = 60.0
"""Seconds from one writing of the index to the next, while scenes are made."""
TRIES = 3
"""Then a scene is set aside, if it was not its own fault before."""


@dataclass(frozen=True)
class Plan:
    """A run: where, what, which scenes, with how many processes.

    `repair` looks at the contents of what is there as well, not at names and sizes only. Of a `shard`, what is its own
    comes first, then help with those that others have begun. Scenes that were set aside are left so unless `retry`.
    `cluster` is the address of a Ray cluster that makes them, "" for the one that is found. The
    dataset lies at an `address`, if that is given, and `root` is where it is worked on.
    """

    root: Path
    config: DatasetConfig
    indices: tuple[int, ...]
    workers: int
    limits: Limits
    asset_folders: tuple[Path, ...] = ()
    repair: bool = False
    shard: Shard | None = None
    retry: bool = False
    cluster: str | None = None
    address: str = ""

    @property
    def place(self) -> str:
        """Where the dataset lies, in words."""
        return without_password(self.address or self.root)


@dataclass(frozen=True)
class Work:
    """Scenes in the making, and what is learned meanwhile: broken assets, where the time goes, what was drawn anew.

    `gpu` says that what is rendered needs one; `there` gets the scenes that are made, `made` the number and the bytes
    of their views, `tried_again` a line for each try that failed and was not the last.
    """

    plan: Plan
    renderer: RendererName
    gpu: bool
    there: Survey
    home: Home
    driver: Driver
    report: Report
    broken: dict[str, str] = field(default_factory=dict)
    made: dict[int, tuple[int, int]] = field(default_factory=dict)
    changed: list[int] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    thrown_away: list[str] = field(default_factory=list)
    tried_again: list[str] = field(default_factory=list)
    retried: list[str] = field(default_factory=list)

    def take(self, told: WorkerReport) -> None:
        """Count a scene in that was made."""
        index = told.row["index"]
        if self.there.stated.get(index, told.row["record_sha256"]) != told.row["record_sha256"]:
            self.changed.append(index)
        self.there.add(told.row, told.credits)
        self.made[index] = told.row["views"], told.row["bytes"]
        self.broken.update(told.broken)
        self.thrown_away.extend(told.thrown_away)
        self.retried.extend(told.retried)
        for reason in told.retried:
            event("request tried again", scene=index, reason=reason)
        event(
            "scene made", scene=index, views=told.row["views"], bytes=told.row["bytes"], seconds=told.seconds,
            thrown_away=told.thrown_away,
        )  # fmt: skip
        for stage, seconds in told.seconds.items():
            self.seconds[stage] = self.seconds.get(stage, 0.0) + seconds


def run_scenes(work: Work, missing: Sequence[int], further: Sequence[int]) -> None:
    """Make the scenes that are missing, then help with further ones; those that cannot be made are set aside.

    Ends when the missing ones are there or set aside, whoever did that.
    """
    plan = work.plan
    count = min(plan.workers, max(1, len(missing) + len(further)))
    threads = max(1, len(os.sched_getaffinity(0)) // count)
    setup = WorkerSetup(
        plan.config, work.renderer, plan.root, plan.asset_folders, threads, os.getpid(), work.driver.token, plan.address
    )
    workers: Workers
    if plan.cluster is None:
        workers = Crew(setup, plan.limits, count)
    else:
        from multilight.datagen.production.cluster import Cluster  # imports ray, which few need

        workers = Cluster(setup, plan.limits, count, plan.cluster, gpu=work.gpu)
    try:
        _collect(work, _Hand(work, deque(missing), deque(further)), workers)
        workers.stop(at_once=False)
    except BaseException:
        workers.stop(at_once=True)
        # Half-made scenes are of no use to anyone, and on a full disk they are in the way.
        _clear(work, "*")
        raise


def _clear(work: Work, scene: str) -> None:
    """Throw away what is half made."""
    for path in work.plan.root.glob(f"work/{scene}-*-{work.driver.token}"):
        shutil.rmtree(path, ignore_errors=True)


class _Hand:
    """The scenes that are still to be made, and which of them this run may take in hand."""

    def __init__(self, work: Work, own: deque[int], further: deque[int]) -> None:
        self._work, self.own, self._further = work, own, further
        self._before = {index: work.home.state(index) for index in work.there.damaged}
        self._not_before = 0.0

    def next(self) -> int | None:
        """Claim a scene; None where all that are left are in others' hands."""
        if time.monotonic() < self._not_before:
            return None
        found = self._claimed(self.own)
        found = found if found is not None else self._claimed(self._further)
        if found is None:
            self._not_before = time.monotonic() + self._work.home.pause
        return found

    def made(self, index: int) -> bool:
        """Whether a scene is there that was not, or was damaged, when this run began."""
        return self._work.home.state(index) not in (None, self._before.get(index))

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
            if self.made(index) or why_aside(self._work.plan.root, index):
                continue
            if driver.claim(index):
                if not self.made(index):
                    return index
                driver.release(index)
            else:
                left.append(index)
        return None


def _collect(work: Work, hand: _Hand, workers: Workers) -> None:
    """Have scenes made, few ahead of the workers; report the views on disk, and finish now and then.

    The views of a draw that is thrown away stay counted till they are made anew.
    """
    plan, driver = work.plan, work.driver
    failed: Counter[int] = Counter()
    aside = 0
    waiting: dict[Future[object], int] = {}
    begun = finished = time.monotonic()
    total, done = len(hand.own) * plan.config.views, 0
    driver.tells(lambda: state_here(
        plan.root, begun, workers=workers.count, made=len(work.made), in_work=tuple(waiting.values())
    ).model_dump_json())  # fmt: skip
    while True:
        while len(waiting) < AHEAD * workers.count and (index := hand.next()) is not None:
            waiting[workers.start(index, index in work.there.damaged)] = index
        if not waiting and not hand.own:
            return
        if waiting:
            over, _ = wait(waiting, timeout=0.2, return_when=FIRST_COMPLETED)
        else:  # all that is left is in others' hands
            over = set()
            time.sleep(0.5)
        for future in over:
            index = waiting.pop(future)
            told = workers.told(index, future)
            if isinstance(told, WorkerReport):
                work.take(told)
                take_up(plan.root, index)
            elif not hand.made(index):
                _clear(work, f"{index:06d}")
                failed[index] += 1
                event("scene failed", scene=index, reason=told.reason, tries=failed[index])
                if told.again and failed[index] < TRIES:
                    work.tried_again.append(f"scene {index}: {told.reason}")
                    hand.own.append(index)
                else:
                    set_aside(plan.root, index, told.reason)
                    aside += 1
            driver.release(index)
        if time.monotonic() - finished > BETWEEN:
            with work.home.held():
                work.home.finish(work.there)
            event("index written", scenes=len(work.there.sound))
            finished = time.monotonic()
        # Not pathlib's glob, which fails where a folder goes away meanwhile.
        in_work = len(glob.glob(f"work/*-{driver.token}/views/*.exr", root_dir=plan.root))
        done = max(done, min((len(work.made) + aside) * plan.config.views + in_work, total))
        counts = {"drawn anew": len(work.thrown_away), "tried again": len(work.tried_again)}
        said = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
        work.report(done, total, ("rendering" if done else "starting and drawing") + f" ({said})" * bool(said))
