"""What an ablation is asked for; imports no torch."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from multilight.scenes.assets.splits import Split


@dataclass(frozen=True)
class AblationSettings:
    """What to compare, on what, for how long and how often."""

    name: Positional[Literal["head", "inputs", "lighting", "scenes", "emissive", "order"]]
    """What to vary."""
    dataset: Positional[str]
    """Dataset to train on and to evaluate on, on other scenes: a folder or an address."""
    out: Path
    """Folder to write table.md, table.json and the trainings to."""
    steps: int | None = None
    """Length of each training in steps (default: 400; lighting: 1200; order: 300)."""
    minutes: float | None = None
    """Instead: length of each training in minutes."""
    seeds: int = 2
    """Trainings of each variant."""
    size: int = 128
    """Side of the pictures in pixels; the largest power of two up to it is that of the map of Gaussians."""
    batch: int = 8
    """Pictures a step (of the 2D stage)."""
    weights_2d: Path | None = None
    """For the order of Gaussians: weights of the 2D stage, a file, or ready-made ones by name."""
    splits: tuple[Split, ...] = ("val", "test", "test_ood")
    """Splits to evaluate on; the first that has any scenes is watched during training."""
    groups: int = 32
    """Most objects a split to evaluate, each in up to four views."""
    workers: int = 1
    """Loader processes beside the training (of the 2D stage)."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train."""
