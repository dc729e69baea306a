"""The model's commands, by name; nothing here imports torch before a command runs."""

from model.commands.ablate import Ablate
from model.commands.evaluate import Evaluate
from model.commands.harmonize import Harmonize
from model.commands.insert import Insert
from model.commands.train import Train

COMMANDS: dict[str, type] = {
    "train": Train,
    "evaluate": Evaluate,
    "ablate": Ablate,
    "harmonize": Harmonize,
    "insert": Insert,
}
"""Each command's name and its options, as a dataclass whose `run` returns the exit code."""
