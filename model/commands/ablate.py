"""`multilight ablate`: train variants that differ in one thing, and compare them on the same pictures."""

from typing import TYPE_CHECKING

from multilight.datagen.errors import UserError
from multilight.model.ablations.settings import AblationSettings

if TYPE_CHECKING:
    from multilight.model.evaluation.run import Evaluation

TITLES = {
    "head": "What the 2D network predicts",
    "inputs": "What the 2D network is shown",
    "lighting": "Lighting of the training samples: drawn for each, or stored conditions",
    "scenes": "How many scenes to train on",
    "emissive": "With and without things that glow",
    "order": "How the 3D network sees the Gaussians",
}


class Ablate(AblationSettings):
    """Train variants of a model that differ in one thing, equally long, and write a table of what each is worth.

    head: gains, a residual or the picture itself. inputs: without background, depth. lighting: drawn, stored, or stored
    of so few scenes that each condition may be a render. scenes: how many. emissive: with and without what
    glows. order: of the Gaussians on the map, or no map (3D stage).
    The same command goes on where it was stopped.
    """

    def run(self) -> int:
        """Train, evaluate, write and print the table, and return the exit code."""
        self.check()
        from multilight.datagen.commands.output import print_written, progress

        with progress("parts", "starting") as report:
            from multilight.model.ablations.run import ablate, base_values
            from multilight.model.ablations.table import write_tables

            runs, found = ablate(self, base_values(self), report)
        print(write_tables(TITLES[self.name], runs, found, self._about(found), self.out))
        print_written(self.out, f"table.md, table.json; {len(runs)} trainings, {len(found.frames)} frames compared")
        return 0

    def check(self) -> None:
        """Raise `UserError` for whatever can be known to be wrong before the work."""
        from multilight.datagen.files.outputs import check_folder
        from multilight.model.configs.checks import LEAST_SIDE, MOST_SIDE, check_range, check_splits
        from multilight.model.configs.ready_made import weights_config
        from multilight.model.configs.stage2d import NetworkConfig

        if self.steps is not None and self.minutes is not None:
            raise UserError("say either --steps or --minutes")
        for name in ("steps", "minutes", "seeds", "batch", "groups"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise UserError(f"--{name} {value} must be more than 0")
        check_range("--size", self.size, LEAST_SIDE, MOST_SIDE)
        check_range("--workers", self.workers, 0, 256)
        if self.weights_2d is not None:
            weights_config(self.weights_2d, NetworkConfig)
        elif self.name == "order":
            raise UserError("order is compared on top of the 2D stage: give --weights-2d slim, or weights of your own")
        check_splits(self.dataset, ("train",))
        check_splits(self.dataset, self.splits)
        check_folder(self.out)

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
