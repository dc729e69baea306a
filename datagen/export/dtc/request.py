"""What an export to DTC-MultiLight is asked for; light to import, since the command line shows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class DtcExport:
    """What to export: a dataset's address, where to, which roots, and how."""

    address: Positional[str]
    """Folder or address of the dataset."""
    out: Path
    """Folder to write the roots into; made where it is missing, continued where it is there."""
    where: str | None = None
    """Which scenes: an SQL expression over the index, as in `multilight query`."""
    on_broken: Literal["raise", "skip"] = "raise"
    """What to do about a scene that cannot be read: stop with its file and the reason, or pass it over and count it."""
    part: Literal["2d-train", "2d-eval", "3d-train", "3d-eval", "all"] = "all"
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
