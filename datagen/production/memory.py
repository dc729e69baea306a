"""How much memory a worker takes, and how many of them fit into what there is."""

import contextlib
import os
import sys
from pathlib import Path

from multilight.datagen.backends.protocol import LARGE
from multilight.datagen.config.dataset import DatasetConfig

BASE = 2_000_000_000
"""Bytes of a worker that has made some dozens of small scenes: libraries, meshes and textures that are kept."""
LIGHTS = 6
"""Lights that most scenes have at most, where the configuration allows more."""
COPIES, COPIES_LARGE = 4.0, 1.3
"""How often all layers of a view (float32) are in memory at most: usually, and where they wait on disk."""
CONTAINERS = (
    ("/sys/fs/cgroup/", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Where a control group of version 2 or 1 says what it allows, what is used, and what of that is but a cache."""


def worker_bytes(config: DatasetConfig) -> int:
    """Predict the most memory that a worker takes, in bytes."""
    pixels = config.width * config.height
    layers = 12 * pixels * min(LIGHTS, config.lights[1]) * (1 + 2 * config.insertable)
    copies = (COPIES_LARGE if pixels > LARGE else COPIES) + config.keep_raw
    return BASE + int(copies * layers)


def free_bytes() -> int:
    """Return the memory that is free for use, within what a container is allowed."""
    free = [_table("/proc/meminfo")["MemAvailable:"] * 1024]
    for folder, allowed, used, cache in CONTAINERS:
        with contextlib.suppress(OSError, ValueError):  # none, or without a limit
            most, now = (int(Path(folder + name).read_text(encoding="ascii")) for name in (allowed, used))
            free.append(most - now + _table(folder + "memory.stat")[cache])
    return max(0, min(free))


def resident_bytes(process: int) -> int:
    """Return the memory that a process has in use; raises `OSError` where there is no such process."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _table(file: str) -> dict[str, int]:
    """Read a file of names and numbers, a line each."""
    lines = (line.split() for line in Path(file).read_text(encoding="ascii").splitlines())
    return {name: int(number) for name, number, *_ in lines}


def used_bytes() -> int:
    """Return the memory that this process and its children take."""
    children = (path.read_text(encoding="ascii").split() for path in Path("/proc/self/task").glob("*/children"))
    total = 0
    for process in (os.getpid(), *(int(child) for told in children for child in told)):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            total += resident_bytes(process)
    return total


def default_workers(scenes: int, config: DatasetConfig) -> int:
    """Return one process a core, but no more than there are scenes, or than memory is free for; that is said."""
    wanted = max(1, min(len(os.sched_getaffinity(0)), scenes))
    each, free = worker_bytes(config), free_bytes()
    fit = max(1, min(wanted, free // each))
    if fit < wanted:
        print(
            f"{fit} instead of {wanted} workers: each may take {each / 1e9:.1f} GB at {config.width} x {config.height} "
            f"pixels, and {free / 1e9:.1f} GB are free; --workers overrides that",
            file=sys.stderr,
        )
    return fit
