"""Parts of a dataset, one for each job of an array: scenes whose number leaves the part's own over the count."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from multilight.datagen.errors import UserError

ARRAYS = (
    ("SLURM_ARRAY_TASK_ID", "SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_COUNT"),
    ("AWS_BATCH_JOB_ARRAY_INDEX", "", "AWS_BATCH_JOB_ARRAY_SIZE"),
    ("JOB_COMPLETION_INDEX", "", ""),
)
"""Variables by which schedulers tell a job its number, the first job's number, and how many there are."""


@dataclass(frozen=True)
class Shard:
    """Part `number` of `count`, counted from 0."""

    number: int
    count: int

    def has(self, scene: int) -> bool:
        """Whether a scene is of this part."""
        return scene % self.count == self.number

    def of(self, scene: int) -> "Shard":
        """Return the part that a scene is of."""
        return Shard(scene % self.count, self.count)


def parse_shard(text: str, environment: Mapping[str, str]) -> Shard:
    """Understand `I/N`, `auto` or `auto/N`: the variables of an array of jobs say the rest; raises `UserError`."""
    found = re.fullmatch(r"(auto|[0-9]{1,9})(?:/([0-9]{1,9}))?", text)
    if found is None or (found[2] is None and found[1] != "auto"):
        raise UserError(f"--shard {text}: say I/N, part I of N counted from 0 (2/8, say), auto, or auto/N")
    number, count = found[1], found[2]
    if number == "auto":
        number, stated = _job(text, environment)
        count = count or stated
    shard = Shard(int(number), int(count))
    if shard.number >= shard.count:
        raise UserError(f"--shard {text}: part {number} of {count}: parts are counted from 0 to {shard.count - 1}")
    return shard


def _job(text: str, environment: Mapping[str, str]) -> tuple[str, str]:
    for own, first, count in ARRAYS:
        if own not in environment:
            continue
        try:
            number = int(environment[own]) - int(environment.get(first, "0"))
        except ValueError:
            raise UserError(f"--shard {text}: {own} = {environment[own]!r} is no number") from None
        if "/" not in text and count not in environment:
            raise UserError(f"--shard {text}: {own} does not say of how many; give --shard auto/N")
        return str(number), environment.get(count, "")
    raise UserError(f"--shard {text}: none of {', '.join(own for own, _, _ in ARRAYS)} is set; say I/N")
