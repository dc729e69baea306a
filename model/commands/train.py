"""`multilight train`: learn from a dataset."""

import os
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import tyro


@dataclass
class Train:
    """Train as a TOML file says: the 2D stage, or the 3D stage where it names `weights_2d`.

    Ready-made configurations go by name: slim, slim3d, paper. To save one with what each key means, and edit it:
    multilight train slim --show > mine.toml; multilight train mine.toml

    The same command goes on where it was stopped.

    On several GPUs: torchrun --nproc-per-node N -m multilight train CONFIG
    """

    config: tyro.conf.Positional[str]
    """TOML file, or the name of a ready-made one."""
    out: Path | None = None
    """Folder of checkpoints, logs and weights (over the file's `out`)."""
    data: str | None = None
    """Dataset to learn from: a folder or an address (over the file's `data.train`)."""
    start: str | None = None
    """Finished weights to learn on from: a file, or ready-made ones by name (over the file's `start`)."""
    minutes: float | None = None
    """Length of the training (over the file's `minutes`)."""
    fresh: bool = False
    """Start anew, removing what an earlier call left in the folder."""
    show: bool = False
    """Only this: print the configuration as TOML, each key with its meaning and range."""

    def run(self) -> int:
        """Train and return the exit code."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.config.loading import read_values, validated
        from multilight.datagen.config.table import as_toml
        from multilight.datagen.files.outputs import check_folder
        from multilight.datagen.report import Report, silent
        from multilight.model.configs.checks import check_training
        from multilight.model.configs.ready_made import config_file
        from multilight.model.configs.stage2d import TrainingConfig
        from multilight.model.configs.stage3d import SceneTrainingConfig

        path = config_file(self.config)
        values = read_values(path)
        kind = SceneTrainingConfig if "weights_2d" in values else TrainingConfig
        given = {"out": self.out, "start": self.start, "data.train": self.data, "minutes": self.minutes}
        config = validated(values, kind, path, given)
        if self.show:
            print(as_toml(config))
            return 0
        check_folder(config.out)
        check_training(config)
        first = os.environ.get("RANK", "0") == "0"  # of torchrun's processes
        shown: AbstractContextManager[Report] = progress("steps", "starting") if first else nullcontext(silent)
        with shown as report:
            if isinstance(config, SceneTrainingConfig):
                from multilight.model.training.stage3d import train_scenes

                train_scenes(config, fresh=self.fresh, report=report)
            else:
                from multilight.model.training.stage2d import train

                train(config, fresh=self.fresh, report=report)
        return 0
