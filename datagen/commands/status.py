"""The command `status`: how far is a dataset that is being made?"""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from multilight.datagen.errors import UserError
from multilight.datagen.text import duration, plain, ranges, size


@dataclass
class Status:
    """Say how far a dataset is, from any shell or machine: scenes, failures by reason, time left, memory, disk."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    json: bool = False
    """Print JSON instead of lines."""
    prometheus: bool = False
    """Print Prometheus' text format instead."""
    out: Path | None = None
    """With --prometheus, a file to write that to, whole or not at all, as node_exporter's textfile collector wants."""

    def run(self) -> int:
        """Look, print, and return the exit code."""
        from multilight.datagen.files.outputs import check_file, written
        from multilight.datagen.production.status import prometheus, status_of

        if self.out is not None and not self.prometheus:
            raise UserError("--out goes with --prometheus")
        if self.prometheus and self.json:
            raise UserError("--json and --prometheus: give one of them")
        if self.out is not None:
            check_file(self.out)
        found = status_of(self.dir)
        if self.out is not None:
            with written(self.out) as work:
                work.write_text(prometheus(found), encoding="utf-8")
        elif self.prometheus:
            print(prometheus(found), end="")
        elif self.json:
            told = {name: getattr(found, name) for name in ("in_work", "per_hour", "seconds_left")}
            print(json.dumps(asdict(found) | told | {"runs": [run.model_dump() for run in found.runs]}, indent=1))
        else:
            failed = sum(map(len, found.failed.values()))
            print(plain(
                f"{found.address}: {found.done} of {found.scenes} scenes done, {found.in_work} in work, {failed} failed"
            ))  # fmt: skip
            for reason, scenes in found.failed.items():
                print(plain(f"failed     {len(scenes)}: {reason} (scenes {ranges(scenes)})"))
            if found.seconds_left is not None:
                print(f"time       {found.per_hour:.3g} scenes an hour, {duration(found.seconds_left)} left")
            for run in found.runs:
                print(plain(
                    f"run        {run.host}, process {run.process}: {run.made} made, workers {run.workers}, memory "
                    f"{size(run.memory)} ({size(run.free_memory)} free), disk {size(run.free_disk)} free; "
                    f"{duration(max(time.time() - run.time, 0))} ago"
                ))  # fmt: skip
            if not found.runs:
                print("no run is at work")
        return 0
