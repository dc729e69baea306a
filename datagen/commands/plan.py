"""The command `plan`: what will a dataset cost?"""

import json
import os
from dataclasses import asdict, dataclass
from typing import Annotated

from multilight.datagen.commands.dataset import Settings, config_key
from multilight.datagen.errors import UserError
from multilight.datagen.text import duration, size


@dataclass(kw_only=True)
class Plan(Settings):
    """Say what a dataset will cost before it is made: core-hours, hours, bytes, memory.

    Some of its scenes are made for it, drawn by lot, in a temporary folder, until the standard error of their mean
    cost is below 6 % or time is up.
    """

    scenes: Annotated[int | None, config_key("scenes")] = None
    machines: int = 1
    """Machines that work at it."""
    cores: int | None = None
    """Cores of each (default: of this one)."""
    memory: float | None = None
    """Memory of each [GB] (default: of this one)."""
    minutes: float = 5.0
    """How long scenes are made for it at most; those that are begun are finished."""
    json: bool = False
    """Print JSON instead of lines."""

    def run(self) -> int:
        """Measure, print, and return the exit code."""
        from multilight.datagen.backends.machine.memory import whole_bytes
        from multilight.datagen.commands.output import progress
        from multilight.datagen.production.estimate import estimate

        config, here = self.configuration({}), len(os.sched_getaffinity(0))
        cores = here if self.cores is None else self.cores
        memory = whole_bytes() if self.memory is None else int(self.memory * 1e9)
        options = {"machines": self.machines, "cores": cores, "memory": memory / 1e9, "minutes": self.minutes}
        for option, value in options.items():
            if value <= 0:
                raise UserError(f"--{option} {value} must be more than 0")
        with progress("s", "starting") as report:
            found = estimate(config, self.folders, workers=here, seconds=60 * self.minutes, report=report)
        workers, hours = found.workers(cores, memory), found.hours(self.machines, cores, memory)
        if self.json:
            whole = {"core_hours": found.core_hours(), "hours": hours, "bytes": found.scenes * found.size}
            print(json.dumps(asdict(found) | whole | {"machines": self.machines, "workers": workers}, indent=1))
            return 0
        spread = f"give or take {2 * found.error / found.core_seconds:.0%}"
        short = ", as many as the memory holds" if workers < cores else ""
        print(f"{found.scenes} scenes of {config.views} views of {config.width} x {config.height} pixels")
        print(
            f"computing  {found.core_hours():.3g} core-hours: {found.core_seconds:.3g} core-seconds a scene, {spread}"
        )
        print(f"time       {duration(3600 * hours)}: machines {self.machines}, workers on each {workers}{short}")
        print(f"disk       {size(round(found.scenes * found.size))}: {size(round(found.size))} a scene")
        print(f"memory     {size(found.memory * workers)} of {size(memory)} a machine: {size(found.memory)} a worker")
        failed = f"; {found.failed} more could not be made, and are left out" if found.failed else ""
        print(f"measured on this machine, on {found.measured} scenes{failed}")
        return 0
