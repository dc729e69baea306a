"""What runs inside a worker process: one renderer, one scene after the other, output into a log per scene."""

import atexit
import contextlib
import dataclasses
import os
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.protocol import LARGE, BackendError
from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.errors import RunStoppedError, UserError
from multilight.datagen.production.library import open_library
from multilight.datagen.production.remote import Remote, send_scene
from multilight.datagen.production.scene import Made, SceneMaker, make_scene
from multilight.datagen.storage.index import Row, index_row
from multilight.datagen.storage.records import AssetCredit
from multilight.scenes.assets.cache import tell_thrown_away

SCENES_A_WORKER: dict[RendererName, int] = {"cycles": 25, "mitsuba": 50, "analytic": 1000}
"""Then a fresh process: a long-lived Blender grows. A fresh one has to read its meshes and textures anew, which is
little beside a scene of large pictures: of such each has a process to itself."""


def scenes_a_worker(renderer: RendererName, config: DatasetConfig) -> int:
    """Return how many scenes a process makes."""
    return 1 if config.width * config.height > LARGE else SCENES_A_WORKER[renderer]


@dataclass(frozen=True)
class WorkerSetup:
    """What a worker needs to start; picklable, renderer-free."""

    config: DatasetConfig
    renderer: RendererName
    root: Path
    asset_folders: tuple[Path, ...]
    threads: int
    parent: int
    token: str
    address: str = ""
    """Where finished scenes go, if that is not `root`."""


def log_path(root: Path, index: int) -> Path:
    """Return where a scene's log lies while it is made, and stays if it fails."""
    return root / "logs" / f"{index:06d}.log"


@cache
def _maker(setup: WorkerSetup) -> SceneMaker:
    """Open the renderer, once for all scenes of this process; raises `RunStoppedError` where it cannot start."""
    threading.Thread(target=_die_with, args=(setup.parent,), daemon=True).start()
    library = open_library(setup.config, setup.asset_folders)
    try:
        # Never closed: the renderer lives as long as the process.
        backend = open_backend(setup.renderer, library).__enter__()
    except BackendError as error:
        raise RunStoppedError(str(error)) from error
    # Blender's own clean-up at exit now and then waits for ever on its sound thread; all that matters is on disk.
    atexit.register(os._exit, 0)
    return SceneMaker(setup.config, setup.renderer, setup.root, library, backend, setup.threads, token=setup.token)


@dataclass(frozen=True)
class WorkerReport:
    """What a worker tells of a scene: its row of the index, its credits, why draws were thrown away, seconds a stage.

    `broken` are the broken assets that the worker has met so far (id → reason); `retried` has a word on each request
    that was tried again to send it.
    """

    row: Row
    credits: tuple[AssetCredit, ...]
    thrown_away: tuple[str, ...]
    seconds: dict[str, float]
    broken: dict[str, str]
    retried: tuple[str, ...] = ()


def report_of(made: Made, broken: dict[str, str]) -> WorkerReport:
    """Sum up a finished scene."""
    record = made.record
    return WorkerReport(index_row(record), record.assets, record.thrown_away, made.seconds, broken)


@cache
def _remote(address: str) -> Remote:
    return Remote(address)


def _sent(setup: WorkerSetup, told: WorkerReport, *, replace: bool) -> WorkerReport:
    """Send a finished scene to where the dataset lies."""
    remote, begun = _remote(setup.address), time.perf_counter()
    send_scene(remote, setup.root, told.row, told.credits, replace=replace)
    seconds = told.seconds | {"send": time.perf_counter() - begun}
    retried = tuple(remote.retried)
    remote.retried.clear()
    return dataclasses.replace(told, seconds=seconds, retried=retried)


def run_scene(setup: WorkerSetup, index: int, replace: bool) -> WorkerReport:
    """Make one scene in this worker; what it prints goes to the scene's log, which stays only on failure."""
    path = log_path(setup.root, index)
    path.parent.mkdir(parents=True, exist_ok=True)
    with _output_to(path):
        try:
            maker = _maker(setup)
            made = make_scene(maker, index, replace=replace)
            told = report_of(made, maker.library.broken)
            if setup.address:
                told = _sent(setup, told, replace=replace)
        except UserError:
            raise
        except BaseException:
            traceback.print_exc()
            raise
    tell_thrown_away()
    path.unlink(missing_ok=True)
    return told


def _die_with(parent: int) -> None:
    """End this process soon after its parent has gone: an orphan must not go on writing."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


@contextlib.contextmanager
def _output_to(path: Path) -> Iterator[None]:
    """Send file descriptors 1 and 2 to a file: renderers print from native code."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = os.dup(1), os.dup(2)
    with path.open("w", encoding="utf-8") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for target, source in enumerate(saved, start=1):
            os.dup2(source, target)
            os.close(source)
