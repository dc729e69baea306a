"""`multilight train`: learn from a dataset."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass
class Train:
    """Train the 2D stage as a TOML file says; the same command goes on where it was stopped.

    On several GPUs: torchrun --nproc-per-node N -m multilight train CONFIG
    """

    config: tyro.conf.Positional[Path]
    """TOML file; its keys are those of `model.config.TrainingConfig`."""
    out: Path | None = None
    """Folder of checkpoints, logs and weights (over the file's `out`)."""
    data: str | None = None
    """Dataset to learn from: a folder or an address (over the file's `data.train`)."""
    minutes: float | None = None
    """Length of the training (over the file's `minutes`)."""
    fresh: bool = False
    """Start anew, removing what an earlier call left in the folder."""

    def run(self) -> int:
        """Train and return the exit code."""
        from model.config import load_training_config
        from model.training import train

        given = {"out": self.out, "data.train": self.data, "minutes": self.minutes}
        train(load_training_config(self.config, given), fresh=self.fresh)
        return 0
