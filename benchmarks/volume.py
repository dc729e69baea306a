"""Core-seconds that a scene takes, stage by stage, beside its floor and beside a render for each lighting condition.

Scenes are made as a worker makes them, on one thread, in this process; seconds are user and system time of all its
threads, so that other work on the machine counts little. Each setting begins without meshes or textures in memory. What
is imported late, and kernels, are loaded by a scene that is not counted: they are part of the start of a worker, which
the scenes that it makes share.

`structures` is putting the scene on the device: acceleration structures, tables, textures. `floor` is tracing and
denoising alone, `over` the whole over that. `singly` is what one picture for every condition, with everything and
without each object, takes to trace and to denoise.

A run may be made in pieces: name presets, sizes and numbers of views. `--large` makes one tabletop view a size, each in
a process of its own, and prints the most memory that it took beside the core-seconds.

    python -m benchmarks.volume --presets mixed --sizes 128 --views 1 4
    python -m benchmarks.volume --presets tabletop --sizes 256 --views 1    # a view at default size
    python -m benchmarks.volume --presets --large 512 1024 2048
"""

import multiprocessing
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Literal

import numpy as np
import tyro

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig, load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.production.denoise import denoise_all
from multilight.datagen.production.library import open_library
from multilight.datagen.production.scene import SceneMaker, make_scene
from multilight.datagen.production.worker import SCENES_A_WORKER
from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.storage.store import read_scene, scene_dir

STAGES = ("draw", "contacts", "structures", "tracing", "denoise", "write", "verify", "rest")
FLOOR = ("tracing", "denoise")
SHARED = SCENES_A_WORKER["mitsuba"]
"""Scenes that share the start of a worker."""
IMPORTED = time.process_time()
"""Core-seconds that imports took."""


@dataclass
class Options:
    """What to measure."""

    presets: tuple[Preset, ...] = ("mixed",)
    sizes: tuple[int, ...] = (64, 128, 256)
    views: tuple[int, ...] = (1, 4, 16)
    scenes: int = 8
    spp: int = 16
    seed: int = 55
    large: tuple[int, ...] = ()
    """Sizes of single tabletop views of which memory is measured."""
    clock: Literal["cores", "wall"] = "cores"
    """Seconds of all cores, or those of the clock: what counts on a GPU."""

    def seconds(self) -> float:
        """Return what the clock shows."""
        return time.process_time() if self.clock == "cores" else time.perf_counter()


class Syncing:
    """A Mitsuba backend of which the time that scenes take to get on to the device is counted."""

    name = "mitsuba"

    def __init__(self, backend: Backend, clock: Callable[[], float]) -> None:
        self._backend, self.seconds, self._clock = backend, 0.0, clock

    def prepare(self, job: RenderJob) -> None:
        """Put a scene on the device."""
        start = self._clock()
        self._backend.prepare(job)  # type: ignore[attr-defined]
        self.seconds += self._clock() - start

    def render(self, job: RenderJob) -> LayerStack:
        """Render a scene that is on the device, or is put there first."""
        self.prepare(job)
        return self._backend.render(job)


def measured(options: Options, config: DatasetConfig, *, first: bool = False) -> tuple[dict[str, float], float]:
    """Make scenes; return the seconds of each stage, and those of a render a condition, a scene."""
    library = open_library(config)
    spent: dict[str, float] = defaultdict(float)
    with tempfile.TemporaryDirectory() as folder, open_backend("mitsuba", library) as opened:
        backend = Syncing(opened, options.seconds)
        maker = SceneMaker(config, "mitsuba", Path(folder), library, backend, 1, options.seconds)
        for index in [0] if first else range(options.scenes):
            for stage, seconds in make_scene(maker, index).seconds.items():
                spent[stage] += seconds
        spent["structures"] = backend.seconds
        spent["tracing"] = spent.pop("render") - backend.seconds
        chosen = () if first else range(0, options.scenes, 4)
        singly = [one_by_one(maker, backend, index) for index in chosen]
    count = 1 if first else options.scenes
    return {stage: spent[stage] / count for stage in STAGES}, sum(singly) / max(1, len(singly))


def one_by_one(maker: SceneMaker, backend: Syncing, index: int) -> float:
    """Return what tracing and denoising a picture for every view, condition and variant of a scene would take."""
    record = read_scene(scene_dir(maker.root, index))
    plain = record.scene.model_copy(
        update={"bodies": tuple(body.model_copy(update={"insertable": False}) for body in record.scene.bodies)}
    )
    job = RenderJob(plain, record.rig, RenderSettings(spp=maker.config.spp, threads=1), 0)
    backend.prepare(job)
    start = maker.clock()
    stack = backend.render(job)
    denoise_all(replace(stack, lights=("all",), radiance=np.asarray(stack.combined)[None]), threads=1)
    pictures = len(record.conditions) * (1 + len(record.scene.insertable)) * len(record.scene.cameras)
    return (maker.clock() - start) * pictures


def config_of(options: Options, preset: Preset, size: int, views: int) -> DatasetConfig:
    """Return the configuration of a row."""
    values = {"seed": options.seed, "scenes": options.scenes, "views": views, "spp": options.spp}
    return load_config(None, values | {"width": size, "height": size}, preset)


def large_view(options: Options, size: int, answer: Connection) -> None:
    """Make one tabletop view in this process; send the seconds of each stage, and the most memory [GB]."""
    spent, _ = measured(options, config_of(options, "tabletop", size, 1), first=True)
    answer.send((spent, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9))


def print_large(options: Options) -> None:
    """Print a row for each large picture."""
    print(f"one tabletop view, {options.spp} spp, kernels and all loaded anew; core-seconds, and memory of the process")
    print(" size " + " ".join(f"{name:>10}" for name in (*STAGES, "sum", "us/pixel", "GB", "bytes/px")))
    fresh = multiprocessing.get_context("spawn")
    for size in options.large:
        receiver, sender = fresh.Pipe(duplex=False)
        process = fresh.Process(target=large_view, args=(options, size, sender))
        process.start()
        spent, memory = receiver.recv()
        process.join()
        total = sum(spent.values())
        row = (*spent.values(), total, total / size**2 * 1e6, memory, memory * 1e9 / size**2)
        print(f"{size:5} " + " ".join(f"{value:10.2f}" for value in row), flush=True)


def main(options: Options) -> None:
    """Measure every setting and print tables."""
    for preset in options.presets:
        print_preset(options, preset)
    if options.large:
        print_large(options)


def print_preset(options: Options, preset: Preset) -> None:
    """Print a row for each size and number of views."""
    smallest = config_of(options, preset, min(options.sizes), min(options.views))
    imported = IMPORTED
    cold, _ = measured(options, smallest, first=True)
    warm, _ = measured(options, smallest, first=True)
    start = imported + max(0.0, sum(cold.values()) - sum(warm.values()))
    print(f"start of a worker: {start:.1f} core-seconds, {start / SHARED:.2f} a scene of {SHARED}")
    print(f"preset {preset}, {options.spp} spp, {options.scenes} scenes a setting; core-seconds a scene")
    print(" size views " + " ".join(f"{name:>10}" for name in (*STAGES, "start", "sum", "floor", "over", "singly")))
    for size in options.sizes:
        for views in options.views:
            spent, singly = measured(options, config_of(options, preset, size, views))
            total, floor = sum(spent.values()) + start / SHARED, sum(spent[stage] for stage in FLOOR)
            row = (*spent.values(), start / SHARED, total, floor, total / floor, singly)
            print(f"{size:5} {views:5} " + " ".join(f"{value:10.2f}" for value in row), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
