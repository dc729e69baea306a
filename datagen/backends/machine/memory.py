"""How much memory this machine has, and its container allows; how much is free, and what processes take."""

import contextlib
import os
from pathlib import Path

CONTAINERS = (
    ("/sys/fs/cgroup/", "memory.max", "memory.current", "inactive_file"),
    ("/sys/fs/cgroup/memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
)
"""Where a control group of version 2 or 1 says what it allows, what is used, and what of that is but a cache."""


def free_bytes() -> int:
    """Return the memory that is free for use, within what a container is allowed."""
    free = [_table("/proc/meminfo")["MemAvailable:"] * 1024]
    for folder, allowed, used, cache in CONTAINERS:
        with contextlib.suppress(OSError, ValueError):  # none, or without a limit
            free.append(_number(folder + allowed) - _number(folder + used) + _table(folder + "memory.stat")[cache])
    return max(0, min(free))


def whole_bytes() -> int:
    """Return the memory that this process may use in all: the machine's, or what its container is allowed."""
    whole = [_table("/proc/meminfo")["MemTotal:"] * 1024]
    for folder, allowed, _, _ in CONTAINERS:
        with contextlib.suppress(OSError, ValueError):
            whole.append(_number(folder + allowed))
    return min(whole)


def resident_bytes(process: int) -> int:
    """Return the memory that a process has in use; raises `OSError` where there is no such process."""
    pages = int(Path(f"/proc/{process}/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def used_bytes() -> int:
    """Return the memory that this process and its children take."""
    children = (path.read_text(encoding="ascii").split() for path in Path("/proc/self/task").glob("*/children"))
    total = 0
    for process in (os.getpid(), *(int(child) for told in children for child in told)):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            total += resident_bytes(process)
    return total


def _number(file: str) -> int:
    return int(Path(file).read_text(encoding="ascii"))


def _table(file: str) -> dict[str, int]:
    """Read a file of names and numbers, a line each."""
    lines = (line.split() for line in Path(file).read_text(encoding="ascii").splitlines())
    return {name: int(number) for name, number, *_ in lines}
