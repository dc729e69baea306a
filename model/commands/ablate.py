"""`multilight ablate`: train variants that differ in one thing, and compare them on the same pictures."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from multilight.datagen.errors import UserError
from multilight.scenes.assets.splits import Split

if TYPE_CHECKING:
    from multilight.model.ablations.run import AblationSettings
    from multilight.model.evaluation.run import Evaluation

TITLES = {
    "head": "What the 2D network predicts",
    "inputs": "What the 2D network is shown",
    "lighting": "Lighting of the training samples: drawn for each, or stored conditions",
    "scenes": "How many scenes to train on",
    "emissive": "With and without things that glow",
    "order": "How the 3D network sees the Gaussians",
}


@dataclass
class Ablate:
    """Train variants of a model that differ in one thing, equally long, and write a table of what each is worth.

    head: gains, a residual or the picture itself. inputs: without background, depth. lighting: drawn, stored, or stored
    of so few scenes that each condition may be a render. scenes: how many. emissive: with and without what
    glows. order: of the Gaussians on the map, or no map (3D stage).
    The same command goes on where it was stopped.
    """

    name: tyro.conf.Positional[Literal["head", "inputs", "lighting", "scenes", "emissive", "order"]]
    """What to vary."""
    dataset: tyro.conf.Positional[str]
    """Dataset to train on and to evaluate on, on other scenes: a folder or an address."""
    out: Path = field(kw_only=True)
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
    """Weights of the 2D stage, for the order of Gaussians."""
    splits: tuple[Split, ...] = ("val", "test", "test_ood")
    """Splits to evaluate on; the first that has any scenes is watched during training."""
    groups: int = 32
    """Most objects a split to evaluate, each in up to four views."""
    workers: int = 1
    """Loader processes beside the training (of the 2D stage)."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where to train."""

    def run(self) -> int:
        """Train, evaluate, write and print the table, and return the exit code."""
        from multilight.model.ablations.run import ablate, base_values
        from multilight.model.ablations.table import write_tables

        settings = self._settings()
        base = base_values(settings)
        runs, found = ablate(settings, base)
        print(write_tables(TITLES[self.name], runs, found, self._about(found), self.out))
        print(f"table: {self.out / 'table.md'}")
        return 0

    def _settings(self) -> "AblationSettings":
        from multilight.model.ablations.run import AblationSettings

        if self.steps is not None and self.minutes is not None:
            raise UserError("say either --steps or --minutes")
        for name in ("steps", "minutes", "seeds", "size", "batch", "groups"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise UserError(f"--{name} {value} must be more than 0")
        return AblationSettings(**vars(self))

    def _about(self, found: "Evaluation") -> dict[str, str]:
        """Say what was trained and evaluated on what."""
        import torch

        from multilight.model.ablations.run import chosen_scenes

        counts = {split: len(chosen_scenes(self.dataset, f"split = '{split}'")) for split in ("train", *self.splits)}
        batch = f"batch {self.batch}" if self.name != "order" else "one object of one scene in 3 views a step"
        seeds = ", ".join(map(str, range(self.seeds)))
        return {
            "data": self.dataset,
            "scenes": ", ".join(f"{split} {count}" for split, count in counts.items()),
            "training": f"{self.size} x {self.size} px, {batch}, seed {seeds}",
            "evaluation": f"{len(found.frames)} frames of {', '.join(self.splits)}, {self.size} x {self.size} px",
            "torch": f"{torch.__version__}, {torch.get_num_threads()} threads, device {self.device}",
        }
