"""Worker processes on this machine, watched: a scene that takes too long or too much memory is ended, not the machine.

The watching is this process's own: a control group needs rights that few have, and where a limit of the process
(RLIMIT_AS, RLIMIT_DATA) refuses memory, native libraries abort without a word.
"""

import contextlib
import glob
import multiprocessing
import signal
import threading
import time
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from typing import Protocol

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from multilight.datagen.backends.machine.memory import free_bytes, resident_bytes
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import RunStoppedError, UserError
from multilight.datagen.production.worker import WorkerReport, WorkerSetup, run_scene, scenes_a_worker

SECONDS_A_MEGASAMPLE = 60.0  # a hundred times what a slow core needs; only a hung scene exceeds it
LEAST_TIMEOUT = 600.0
RESERVE = 500_000_000
"""Bytes of memory that stay free: below, the largest worker is ended before the system ends whatever it likes."""
LOOK = 0.2
"""Seconds from one look at the workers to the next."""


@dataclass(frozen=True)
class Limits:
    """What a scene may take: seconds, and bytes of its process (0: whatever the machine has)."""

    seconds: float
    memory: int = 0


def limits_for(config: DatasetConfig, minutes: float | None = None, memory: float | None = None) -> Limits:
    """Return the limits that are given, in minutes and GB; else so much time that only a hung scene exceeds it."""
    if minutes is None:
        renders = config.views * (1 + 2 * config.insertable)
        megasamples = config.width * config.height * config.spp * renders / 1e6
        return Limits(LEAST_TIMEOUT + SECONDS_A_MEGASAMPLE * megasamples, int((memory or 0) * 1e9))
    return Limits(60 * minutes, int((memory or 0) * 1e9))


@dataclass(frozen=True)
class Failed:
    """Why a scene was not made, and whether trying `again` may help."""

    reason: str
    again: bool = True


class Workers(Protocol):
    """Those who make scenes, here or elsewhere."""

    @property
    def count(self) -> int:
        """How many scenes they make at once, at present."""

    def start(self, index: int, replace: bool) -> "Future[object]":
        """Hand out a scene."""

    def told(self, index: int, future: "Future[object]") -> WorkerReport | Failed:
        """Return what came of it; what would stop every scene (a full disk) is raised."""

    def stop(self, *, at_once: bool) -> None:
        """Send them away; scenes in work are given up."""


class Crew:
    """Processes of this machine."""

    def __init__(self, setup: WorkerSetup, limits: Limits, count: int) -> None:
        self.count = count
        self._setup, self._limits = setup, limits
        self._pool = ProcessPool(
            max_workers=count,
            max_tasks=scenes_a_worker(setup.renderer, setup.config),
            context=multiprocessing.get_context("spawn"),
        )
        self._waiting: dict[int, ProcessFuture] = {}
        self._stopped: dict[int, str] = {}
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def start(self, index: int, replace: bool) -> "Future[object]":
        """Hand out a scene."""
        future = self._waiting[index] = self._pool.schedule(run_scene, args=(self._setup, index, replace))
        return future

    def told(self, index: int, future: "Future[object]") -> WorkerReport | Failed:
        """Return what came of a scene; raises `RunStoppedError` where no scene can be made."""
        del self._waiting[index]
        try:
            report = future.result()
            assert isinstance(report, WorkerReport)
            return report
        except CancelledError:
            return Failed(self._stopped.pop(index))
        except ProcessExpired as error:
            return Failed(f"the worker {_ended(error.exitcode)}")
        except RunStoppedError:
            raise
        except UserError as error:
            return Failed(str(error), again=False)
        except Exception as error:
            return Failed(f"{type(error).__name__}: {error}")

    def stop(self, *, at_once: bool) -> None:
        """End the processes, those at work as well or not."""
        self._over.set()
        if at_once:
            self._pool.stop()
        else:
            self._pool.close()
        self._pool.join()

    def _watch(self) -> None:
        since: dict[int, float] = {}
        while not self._over.wait(LOOK):
            now = time.monotonic()
            at_work = {index for index, future in [*self._waiting.items()] if future.running()}
            since = {index: since.get(index, now) for index in at_work}
            for index in (i for i in at_work if now - since[i] > self._limits.seconds):
                self._end(index, f"took longer than {self._limits.seconds:.0f} s; raise --limit-minutes or lower --spp")
            taken = self._taken(at_work)
            for index in (i for i in taken if 0 < self._limits.memory < taken[i]):
                most = f"{self._limits.memory / 1e9:.1f} GB"
                self._end(index, f"needed more than {most} of memory; lower --width or raise --limit-memory")
            if taken and not self._stopped and free_bytes() < RESERVE:
                index = max(taken, key=lambda i: taken[i])
                had = f"{taken[index] / 1e9:.1f} GB"
                self._end(index, f"memory ran out while it had {had}; lower --width or --workers")

    def _taken(self, at_work: set[int]) -> dict[int, int]:
        """Return how much memory the process of each scene takes [bytes]."""
        taken = {}
        for name in glob.glob(f"*-{self._setup.token}", root_dir=self._setup.root / "work"):
            index, pid = map(int, name.split("-")[:2])
            with contextlib.suppress(OSError):
                if index in at_work:
                    taken[index] = resident_bytes(pid)
        return taken

    def _end(self, index: int, reason: str) -> None:
        """End a scene's process; by cancelling, since one that were killed here might hold the pool's pipe."""
        self._stopped.setdefault(index, reason)
        future = self._waiting.get(index)
        if future is None or not future.cancel():  # it is over
            self._stopped.pop(index, None)


def _ended(code: int) -> str:
    """Say how a process ended; native libraries crash in many ways where memory is refused."""
    if code >= 0:
        return f"died with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}, most often for want of memory: use fewer --workers"
