"""The command `export`: a dataset written out in a layout that others read, one sub-command a format."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from multilight.datagen.commands import export_others
from multilight.datagen.commands.export_usd import Usd
from multilight.datagen.text import plain

Part = Literal["2d-train", "2d-eval", "3d-train", "3d-eval", "all"]


@dataclass
class DtcMultilight:
    """MV-CoLight's own layouts: DTC-MultiLight-2D, -3D, -2DEval, -3DEval, with train.json and test.json."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path = field(kw_only=True)
    """Folder to write the roots into; made where it is missing, continued where it is there."""
    part: Part = "all"
    """Which roots to write: scenes of split train go to the training roots, all others to the evaluation roots."""
    conditions: int | None = None
    """Lightings a training scene: the first of its own conditions (default: all of them, 12 usually)."""
    exposures: int = 4
    """Exposures a lighting, half a stop (in natural logarithm) apart."""
    size: int = 256
    """Pixels a side of the pictures, no larger than the rendered views, which are shrunk and cropped."""
    map_size: int = 256
    """Cells a side of the 3D maps: a scene gets as many Gaussians as there are cells."""
    workers: int | None = None
    """Worker processes (default: one a core)."""

    def run(self) -> int:
        """Write the roots and return the exit code: 1 where a scene failed."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.export.dtc.export import DtcExport, export_dtc

        request = DtcExport(
            self.dir, self.out, self.part, self.conditions, self.exposures, self.size, self.map_size, self.workers
        )
        with progress("views") as report:
            outcome = export_dtc(request, report)
        for index, reason in outcome.failures.items():
            print(plain(f"failed: scene {index}: {reason}"), file=sys.stderr)
        print(f"{self.out}: written {outcome.written}, kept {outcome.kept}, failed {len(outcome.failures)}")
        return 1 if outcome.failures else 0


Format = (
    Annotated[DtcMultilight, tyro.conf.subcommand("dtc-multilight", prefix_name=False)]
    | Annotated[Usd, tyro.conf.subcommand("usd", prefix_name=False)]
    | export_others.Formats
)


@dataclass
class Export:
    """Write a dataset out in a layout that others read."""

    format: Format

    def run(self) -> int:
        """Run the format's own command and return the exit code."""
        return self.format.run()
