"""Memory and core-seconds of a run of many small scenes by one worker: does either grow?

The worker is renewed as often as in any run. The last fifty scenes are the first fifty once more, since other scenes
would differ in any case. Prints means over fifties and by how much the last fifty differ from the first; writes a line
a scene, and a plot. Called again with the same file it goes on where it was stopped.

    python -m benchmarks.flat --scenes 500 --lines out/flat.txt --plot docs/flat.png
"""

import multiprocessing
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.errors import UserError
from multilight.datagen.production.library import open_library
from multilight.datagen.production.scene import SceneMaker, make_scene
from multilight.datagen.production.worker import SCENES_A_WORKER
from multilight.datagen.storage.store import scene_dir
from multilight.scenes.arrays import Float64

TOGETHER = 50
SCENES = SCENES_A_WORKER["mitsuba"]


@dataclass
class Options:
    """What to make, and where the curve goes."""

    lines: Path
    plot: Path | None = None
    scenes: int = 500
    preset: Preset = "mixed"
    size: int = 48
    spp: int = 4
    seed: int = 71


def memory() -> float:
    """Return what this process has in memory [MB]."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.split("VmRSS:")[1].split()[0]) / 1024


def work(options: Options, indices: range) -> None:
    """Make scenes as a worker does; append a line to the file for each: its index, core-seconds, memory [MB]."""
    values = {"seed": options.seed, "scenes": options.scenes, "views": 1, "spp": options.spp}
    config = load_config(None, values | {"width": options.size, "height": options.size}, options.preset)
    library = open_library(config)
    with (
        tempfile.TemporaryDirectory() as folder,
        open_backend("mitsuba", library) as backend,
        options.lines.open("a", encoding="ascii") as lines,
    ):
        maker = SceneMaker(config, "mitsuba", Path(folder), library, backend, 1, time.process_time)
        for index in indices:
            start, scene = time.process_time(), index % max(TOGETHER, options.scenes - TOGETHER)
            try:
                make_scene(maker, scene)
            except UserError as error:
                print(error, flush=True)
            print(f"{index} {time.process_time() - start:.3f} {memory():.1f}", file=lines, flush=True)
            shutil.rmtree(scene_dir(maker.root, scene), ignore_errors=True)


def curve(options: Options) -> Float64:
    """Make the scenes that the file has no line for; return core-seconds and memory [MB] of each, (N, 2)."""
    fresh = multiprocessing.get_context("spawn")
    there = len(options.lines.read_text(encoding="ascii").splitlines()) if options.lines.exists() else 0
    while there < options.scenes:
        end = min(options.scenes, there // SCENES * SCENES + SCENES)
        process = fresh.Process(target=work, args=(options, range(there, end)))
        process.start()
        process.join()
        if process.exitcode:
            raise SystemExit(f"the worker of scenes {there} to {end - 1} ended with {process.exitcode}")
        there = end
    return np.loadtxt(options.lines, ndmin=2)[:, 1:]


def draw(found: Float64, path: Path) -> None:
    """Plot both over the scenes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 1, figsize=(7, 4), sharex=True)
    for axis, column, name in zip(axes, found.T, ("core-seconds", "memory [MB]"), strict=True):
        axis.plot(column, ".", markersize=2, color="0.6")
        axis.plot([column[max(0, i - TOGETHER + 1) : i + 1].mean() for i in range(len(column))])
        axis.set_ylabel(name)
        axis.set_ylim(bottom=0)
    axes[1].set_xlabel("scene")
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main(options: Options) -> None:
    """Make the scenes, print the curve."""
    found = curve(options)
    print("scenes       core-seconds  memory [MB]")
    for start in range(0, len(found), TOGETHER):
        seconds, megabytes = found[start : start + TOGETHER].mean(axis=0)
        print(f"{start:4}-{start + TOGETHER - 1:<8} {seconds:11.2f} {megabytes:12.0f}")
    first, last = found[:TOGETHER].mean(axis=0), found[-TOGETHER:].mean(axis=0)
    more = last / first - 1
    print(f"last fifty against the first: {more[0]:+.1%} core-seconds, {more[1]:+.1%} memory")
    if options.plot is not None:
        draw(found, options.plot)


if __name__ == "__main__":
    main(tyro.cli(Options))
