"""`multilight train`: learn from a dataset."""

from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass
class Train:
    """Train as a TOML file says: the 2D stage, or the 3D stage where it names `weights_2d`.

    The same command goes on where it was stopped.

    On several GPUs: torchrun --nproc-per-node N -m multilight train CONFIG
    """

    config: tyro.conf.Positional[Path]
    """TOML file; its keys are those of `TrainingConfig` or `SceneTrainingConfig` in `model.configs`."""
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
        from multilight.datagen.config.loading import read_values, validated
        from multilight.model.configs.stage2d import TrainingConfig
        from multilight.model.configs.stage3d import SceneTrainingConfig

        values = read_values(self.config)
        given = {"out": self.out, "data.train": self.data, "minutes": self.minutes}
        if "weights_2d" in values:
            from multilight.model.training.stage3d import train_scenes

            train_scenes(validated(values, SceneTrainingConfig, self.config, given), fresh=self.fresh)
        else:
            from multilight.model.training.stage2d import train

            train(validated(values, TrainingConfig, self.config, given), fresh=self.fresh)
        return 0
