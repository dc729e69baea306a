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
LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def worker_bytes(config: DatasetConfig) -> int:
    """Predict the most memory that a worker takes, in bytes."""
    pixels = config.width * config.height
    layers = 12 * pixels * min(LIGHTS, config.lights[1]) * (1 + 2 * config.insertable)
    copies = (COPIES_LARGE if pixels > LARGE else COPIES) + config.keep_raw
    return BASE + int(copies * layers)


def free_bytes() -> int:
    """Return the memory that is free for use, within what a container is allowed."""
    lines = (line.split() for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines())
    free = next(int(kib) * 1024 for name, kib, *_ in lines if name == "MemAvailable:")
    limits = (Path(name).read_text(encoding="ascii").strip() for name in LIMITS if Path(name).is_file())
    return min([free, *(int(limit) for limit in limits if limit.isdigit())])


def used_bytes() -> int:
    """Return the memory that this process and its children take."""
    children = (path.read_text(encoding="ascii").split() for path in Path("/proc/self/task").glob("*/children"))
    total = 0
    for process in ("self", *(child for told in children for child in told)):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            total += int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return total * os.sysconf("SC_PAGE_SIZE")


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
