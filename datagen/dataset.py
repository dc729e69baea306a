"""Make or continue a dataset: plan, worker processes, index; resumable after any kill."""

import contextlib
import importlib.metadata
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import TimeoutError as FutureTimeout
from dataclasses import dataclass
from pathlib import Path

from pebble import ProcessExpired, ProcessFuture, ProcessPool

from datagen.backends import RendererName, resolve_renderer
from datagen.backends.variants import choose_variant
from datagen.background import check_background
from datagen.config import DatasetConfig
from datagen.errors import RunStoppedError, UserError, full_disk_told
from datagen.index import write_index
from datagen.locks import locked
from datagen.records import DatasetRecord
from datagen.store import read_dataset, read_scene, scene_dir, scene_indices, write_text
from datagen.worker import WorkerSetup, log_path, run_scene
from scenes.assets.library import AssetError, AssetLibrary

SCENES_A_WORKER = 25  # then a fresh process: a long-lived Blender grows
SECONDS_A_MEGASAMPLE = 60.0  # a hundred times what a slow core needs; only a hung scene exceeds it
LEAST_TIMEOUT = 600.0
VERSIONS = ("multilight", "bpy", "mitsuba", "drjit", "mitsuba-oidn", "OpenEXR", "trimesh", "numpy", "colour-science")


SCALAR = "scalar_rgb"


@dataclass(frozen=True)
class Plan:
    """A run: where, what, which scenes, with how many processes."""

    root: Path
    config: DatasetConfig
    indices: tuple[int, ...]
    workers: int
    asset_folders: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What a run did; `failures` maps a scene, `broken` an asset that was passed over, to one line of reason.

    `seconds` maps each stage of the scenes that were made to the time it took, over all workers.
    """

    made: tuple[int, ...]
    kept: int
    failures: dict[int, str]
    broken: dict[str, str]
    seconds: dict[str, float]


Report = Callable[[float, float], None]
"""Called now and then with the views finished and the views planned."""


@dataclass(frozen=True)
class _Watch:
    """What is learned while the workers run: progress, broken assets, and where the time goes."""

    report: Report
    broken: dict[str, str]
    seconds: dict[str, float]


def make_dataset(plan: Plan, report: Report) -> Outcome:
    """Make what is missing of the plan's scenes.

    Raises `UserError` where the folder cannot be written, holds a dataset of another configuration or renderer,
    is being made by another run, or is full.
    """
    renderer = resolve_renderer(plan.config.renderer)
    _check_kind(plan.config, renderer)
    check_background(plan.config)
    with locked(plan.root), full_disk_told(plan.root):
        _open_record(plan, renderer)
        for leftover in ("work", "logs"):
            shutil.rmtree(plan.root / leftover, ignore_errors=True)
        done = set(scene_indices(plan.root))
        missing = tuple(i for i in plan.indices if i not in done)
        kept = len(plan.indices) - len(missing)
        if not missing:
            if not (plan.root / "index.parquet").is_file():
                write_index(plan.root)
            return Outcome((), kept, {}, {}, {})
        watch = _Watch(report, _broken_models(plan.asset_folders), {})
        failures = _run(plan, renderer, missing, watch)
        _finish(plan.root)
        made = tuple(i for i in missing if i not in failures)
        return Outcome(made, kept, failures, watch.broken, dict(watch.seconds))


def default_workers(scenes: int) -> int:
    """Return one process a core, but no more than there are scenes."""
    return max(1, min(len(os.sched_getaffinity(0)), scenes))


def _check_kind(config: DatasetConfig, renderer: RendererName) -> None:
    if renderer == "analytic" and config.kind not in ("spheres", "imported"):
        raise UserError(
            f"renderer 'analytic' is a closed form for spheres on a plane and cannot render kind {config.kind!r}; "
            "use --kind spheres, or --renderer cycles"
        )


def _open_record(plan: Plan, renderer: RendererName) -> None:
    """Write `dataset.json`, or check that what is there was made with the same configuration and renderer."""
    path = plan.root / "dataset.json"
    variant = choose_variant().variant if renderer == "mitsuba" else ""
    if not path.exists():
        if any(not p.name.startswith(".") for p in plan.root.iterdir()):
            raise UserError(f"output folder {plan.root} holds other files and no dataset; choose an empty --out")
        versions = {package: importlib.metadata.version(package) for package in VERSIONS}
        record = DatasetRecord(config=plan.config, renderer=renderer, variant=variant, versions=versions)
        write_text(path, record.model_dump_json(indent=1))
        return
    record = read_dataset(plan.root)
    if record.renderer != renderer:
        raise UserError(
            f"{plan.root} was made with renderer {record.renderer!r} and cannot be continued with {renderer!r}; "
            f"use --renderer {record.renderer} or another --out"
        )
    if (record.variant == SCALAR) != (variant == SCALAR):
        raise UserError(
            f"{plan.root} was made with Mitsuba's variant {record.variant!r} and cannot be continued with {variant!r}, "
            "whose surfaces look different; see `multilight doctor`, or use another --out"
        )
    old, new = record.config.model_dump(), plan.config.model_dump()
    for key in sorted(set(old) - {"scenes", "renderer"}):
        if old[key] != new[key]:
            raise UserError(
                f"{plan.root} was made with {key} = {old[key]!r}, not {new[key]!r}; "
                "use the same value to continue it, or another --out"
            )
    if plan.config.scenes > record.config.scenes:
        grown = record.config.model_copy(update={"scenes": plan.config.scenes})
        write_text(path, record.model_copy(update={"config": grown}).model_dump_json(indent=1))


def _broken_models(folders: tuple[Path, ...]) -> dict[str, str]:
    """Name the models of the user's folders that cannot be used, with the reason."""
    if not folders:
        return {}
    library = AssetLibrary(folders=folders)
    for info in (*library.list("object"), *library.list("table")):
        if info.size is None:
            with contextlib.suppress(AssetError):
                library.mesh(info.id)
    return library.broken


def _run(plan: Plan, renderer: RendererName, missing: Sequence[int], watch: _Watch) -> dict[int, str]:
    workers = min(plan.workers, len(missing))
    threads = max(1, len(os.sched_getaffinity(0)) // workers)
    setup = WorkerSetup(plan.config, renderer, plan.root, plan.asset_folders, threads, os.getpid())
    pool = ProcessPool(
        max_workers=workers,
        max_tasks=SCENES_A_WORKER,
        context=multiprocessing.get_context("spawn"),
    )
    limit = _timeout(plan.config)
    futures = {pool.schedule(run_scene, args=(setup, index), timeout=limit): index for index in missing}
    try:
        failures = _collect(plan, futures, watch)
        pool.close()
        pool.join()
    except BaseException:
        pool.stop()
        pool.join()
        # Half-made scenes are of no use to anyone, and on a full disk they are in the way.
        shutil.rmtree(plan.root / "work", ignore_errors=True)
        raise
    return failures


def _timeout(config: DatasetConfig) -> float:
    renders = config.views * (1 + 2 * config.insertable)
    megasamples = config.width * config.height * config.spp * renders / 1e6
    return LEAST_TIMEOUT + SECONDS_A_MEGASAMPLE * megasamples


def _collect(plan: Plan, futures: dict[ProcessFuture, int], watch: _Watch) -> dict[int, str]:
    """Wait for all scenes, reporting progress by the views that lie on disk."""
    failures: dict[int, str] = {}
    waiting = dict(futures)
    total = len(futures) * plan.config.views
    while waiting:
        time.sleep(0.2)
        for future in [f for f in waiting if f.done()]:
            index = waiting.pop(future)
            if (reason := _failure(plan, index, future, watch)) is not None:
                failures[index] = reason
        finished = (len(futures) - len(waiting)) * plan.config.views
        in_work = sum(1 for _ in (plan.root / "work").glob("*/views/*.exr"))
        watch.report(min(finished + in_work, total), total)
    return failures


def _failure(plan: Plan, index: int, future: ProcessFuture, watch: _Watch) -> str | None:
    """Return why a scene was not made, or None; what stops every scene (a full disk) is raised."""
    where = f"seed {plan.config.seed}, log {log_path(plan.root, index)}"
    try:
        report = future.result()
        watch.broken.update(report.broken)
        for stage, seconds in report.seconds.items():
            watch.seconds[stage] = watch.seconds.get(stage, 0.0) + seconds
    except FutureTimeout:
        return f"took longer than {_timeout(plan.config):.0f} s and was stopped ({where})"
    except ProcessExpired as error:
        return f"the worker died with exit code {error.exitcode} ({where})"
    except RunStoppedError:
        raise
    except UserError as error:
        return f"{error} ({where})"
    except Exception as error:
        return f"{type(error).__name__}: {error} ({where})"
    return None


def _finish(root: Path) -> None:
    """Bring the index and the list of assets up to date with the scenes that are there."""
    shutil.rmtree(root / "work", ignore_errors=True)
    logs = root / "logs"
    if logs.is_dir() and not any(logs.iterdir()):
        logs.rmdir()
    write_index(root)
    credits = {c.id: c for index in scene_indices(root) for c in read_scene(scene_dir(root, index)).assets}
    record = read_dataset(root)
    assets = tuple(credits[name] for name in sorted(credits))
    write_text(root / "dataset.json", record.model_copy(update={"assets": assets}).model_dump_json(indent=1))
