"""What a sample should be."""

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from multilight.datagen.errors import UserError
from multilight.datagen.text import did_you_mean
from multilight.lights.spec import LightingCondition
from multilight.model.configs.stage2d import FAULTS, Fault, Lighting
from multilight.scenes.assets.splits import Split

RIGHT = 0.1
"""Probability, where samples are augmented, that the object is lit rightly already, so that leaving alone is learnt."""
MOST_ENLARGED = 6
"""Times that pictures are enlarged at most; more is a slip of the pen, and fills the memory."""


@dataclass(frozen=True)
class SampleSettings:
    """What training draws from a dataset.

    `size` is the side of the square pictures in pixels; `views` the number of views of one scene in a sample; `length`
    the samples an epoch. `split` and the SQL expression `where` over the dataset's index choose the scenes.
    `lighting` "random" draws gains and colours anew, such as the dataset's own conditions have, and meters them; "wild"
    does so in saturated colours, whatever the dataset is; "stored" takes two of the scene's own conditions.
    `augment` varies exposure, white balance, camera response, crop and direction. Objects that cover fewer than
    `visible` pixels of a view are passed over. `right` is the probability that the object is lit rightly already (None:
    `RIGHT` where samples are augmented, else 0). With a probability of `faults` a sample has one of the faults `kinds`,
    as users' inputs have. Where given, `condition` lights background and target, `insert_condition` the object in the
    composite: files that the mixer or `multilight mix --save-condition` wrote, for scenes with lights of those names;
    the latter goes before `right`. With `repeat` an epoch may be longer than there are different tuples.
    """

    size: int = 256
    views: int = 1
    seed: int = 0
    split: Split | None = "train"
    where: str | None = None
    lighting: Lighting = "random"
    length: int = 1000
    augment: bool = True
    visible: float = 30.0
    right: float | None = None
    faults: float = 0.0
    kinds: tuple[Fault, ...] = FAULTS
    condition: Path | str | LightingCondition | None = None
    insert_condition: Path | str | LightingCondition | None = None
    repeat: bool = False

    def __post_init__(self) -> None:
        for name in ("size", "views", "length"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 1:
                raise UserError(f"{name} {value!r} must be a whole number from 1 up")
        if self.seed < 0:
            raise UserError(f"seed {self.seed} must be 0 or more")
        if not 0 <= self.visible < math.inf:
            raise UserError(f"visible {self.visible} must be a number of pixels, 0 or more")
        for name in ("right", "faults"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value <= 1.0:
                raise UserError(f"{name} {value} must be a probability, from 0 to 1")
        choices = {"split": (*get_args(Split), None), "lighting": get_args(Lighting)}
        for name, known in choices.items():
            value = getattr(self, name)
            if value not in known:
                close = did_you_mean(str(value), filter(None, known))
                raise UserError(f"{name} {value!r}: {close}it must be one of {', '.join(map(repr, known))}")

    def check_size(self, side: int) -> None:
        """Say where pictures whose shorter side has `side` pixels are enlarged; raises `UserError` where beyond use."""
        if self.size > MOST_ENLARGED * side:
            raise UserError(
                f"size {self.size} is too large: the pictures' shorter side has {side} pixels, and they are enlarged "
                f"at most {MOST_ENLARGED} times; ask for {side}"
            )
        if self.size > side:
            print(f"size {self.size}: the pictures' shorter side has {side} pixels, they are enlarged", file=sys.stderr)

    def filter(self) -> str | None:
        """Return one SQL expression for `split` and `where`."""
        parts = [f"split = '{self.split}'"] if self.split else []
        parts += [f"({self.where})"] if self.where else []
        return " AND ".join(parts) or None
