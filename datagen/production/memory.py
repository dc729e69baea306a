"""How much memory a worker takes, and how many of them fit into what there is.

The figures are those of `python -m benchmarks.volume --presets --large 128 256 512 1024 2048` and of `benchmarks.flat`.
"""

import os
import sys

from multilight.datagen.backends.machine.memory import free_bytes
from multilight.datagen.backends.protocol import LARGE
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.denoise import MOST_MEMORY
from multilight.datagen.production.worker import scenes_a_worker

START, START_LARGE = 0.72e9, 0.55e9
"""Bytes of a worker that makes its first scene, small; those that large pictures are not rendered in are given back."""
KEPT, HALF = 2.05e9, 14
"""Bytes of meshes and textures that are kept after very many scenes, and after how many half of them are."""
FILTER = 700
"""Bytes a pixel that the denoiser takes; a picture for which that is above `MOST_MEMORY` it takes in parts."""
LIGHTS = 5
"""Lights that most scenes have at most, where the configuration allows more."""
COPIES, COPIES_LARGE = 5.2, 0.6
"""How often all layers of a view (float32) are in memory at most: usually, and where they wait on disk."""


def worker_bytes(config: DatasetConfig, scenes: int = 1) -> int:
    """Predict the most memory that a worker takes which makes so many scenes, in bytes."""
    pixels = config.width * config.height
    layers = 12 * pixels * min(LIGHTS, config.lights[1]) * (1 + 2 * config.insertable)
    start, copies = (START_LARGE, COPIES_LARGE) if pixels > LARGE else (START, COPIES)
    before = min(scenes, scenes_a_worker("mitsuba", config)) - 1
    filters = 0 if config.denoise == "off" else FILTER * pixels
    parts = 1 + filters // (MOST_MEMORY * 1_000_000)
    return int(start + KEPT * before / (before + HALF) + filters / parts + (copies + config.keep_raw) * layers)


def default_workers(scenes: int, config: DatasetConfig) -> int:
    """Return one process a core, but no more than there are scenes, or than memory is free for; that is said."""
    wanted = max(1, min(len(os.sched_getaffinity(0)), scenes))
    free = free_bytes()

    def each(workers: int) -> int:
        return worker_bytes(config, -(-scenes // workers))

    fit = next((workers for workers in range(wanted, 1, -1) if workers * each(workers) <= free), 1)
    if fit < wanted:
        print(
            f"{fit} instead of {wanted} workers: each may take {each(fit) / 1e9:.1f} GB at {config.width} x "
            f"{config.height} pixels, and {free / 1e9:.1f} GB are free; --workers overrides that",
            file=sys.stderr,
        )
    return fit
