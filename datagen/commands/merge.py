"""The command `merge`."""

import sys
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from multilight.datagen.text import plain, ranges


@dataclass
class Merge:
    """Put parts of a dataset, made with `--shard` in folders of their own, together into the one they are of.

    The parts stay as they are; files are shared with them by hard links where both lie on one file system.
    """

    parts: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the parts, in any order; they may overlap."""
    out: Path = field(kw_only=True)
    """Folder of the whole; made where it is missing, continued where it is there."""

    def run(self) -> int:
        """Merge and return the exit code: 1 where scenes are missing."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.production.merging import merge_parts

        with progress("scenes", "looking at the parts") as report:
            merged = merge_parts(self.parts, self.out, report)
        for part, damaged in merged.damaged.items():
            for scene, reason in damaged.items():
                print(plain(f"{part}: scene {scene} is damaged: {reason}"), file=sys.stderr)
        total = merged.placed + merged.kept + len(merged.missing)
        print(plain(
            f"{self.out}: {merged.placed + merged.kept} of {total} scenes, {merged.placed} of them new"
        ))  # fmt: skip
        if merged.missing:
            missing = ranges(merged.missing)
            print(plain(f"missing: {missing}; made by: multilight dataset --out {self.out}"), file=sys.stderr)
        return 1 if merged.missing else 0
