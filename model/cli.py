"""The model's commands, by name; nothing here imports torch before a command runs."""

from multilight.model.commands.ablate import Ablate
from multilight.model.commands.evaluate import Evaluate
from multilight.model.commands.harmonize import Harmonize
from multilight.model.commands.insert import Insert
from multilight.model.commands.study import Study
from multilight.model.commands.train import Train

COMMANDS: dict[str, type] = {
    "train": Train,
    "evaluate": Evaluate,
    "ablate": Ablate,
    "study": Study,
    "harmonize": Harmonize,
    "insert": Insert,
}
"""Each command's name and its options, as a dataclass whose `run` returns the exit code."""
