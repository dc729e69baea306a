"""The command `pack`."""

import os
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from multilight.datagen.errors import UserError


@dataclass
class Pack:
    """Make a packed copy of a dataset for training: the same values, mapped instead of decoded."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path = field(kw_only=True)
    """Folder of the packed copy; made where it is missing, continued where it is there."""
    workers: int | None = None
    """Worker processes (default: one a core)."""

    def run(self) -> int:
        """Pack what is missing and return the exit code."""
        from multilight.datagen.commands.output import print_written, progress
        from multilight.datagen.storage.pack import pack_dataset

        if self.workers is not None and self.workers < 1:
            raise UserError(f"--workers {self.workers} must be 1 or more")
        workers = self.workers or len(os.sched_getaffinity(0))
        with progress("scenes", "packing") as report:
            packed = pack_dataset(self.dir, self.out, workers=workers, report=report)
        if not packed.made:
            print(f"{self.out}: nothing to do, all {packed.kept} scenes are there, as they were packed")
            return 0
        mean, native = packed.packed / packed.views / 1e6, packed.native / packed.views / 1e6
        print_written(self.out, f"{packed.views} views of {mean:.2f} MB (native: {native:.2f} MB)")
        return 0
