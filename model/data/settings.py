"""What a sample should be."""

from dataclasses import dataclass
from typing import Literal, get_args

from multilight.datagen.errors import UserError
from multilight.datagen.text import did_you_mean
from multilight.scenes.assets.splits import Split


@dataclass(frozen=True)
class SampleSettings:
    """What training draws from a dataset.

    `size` is the side of the square pictures in pixels; `views` the number of views of one scene in a sample; `length`
    the samples an epoch. `split` and the SQL expression `where` over the dataset's index choose the scenes.
    `lighting` "random" draws gains and colours anew and meters them, "stored" takes two of the scene's own conditions.
    `augment` varies exposure, white balance, camera response, crop and direction. Objects that cover fewer than
    `visible` pixels of a view are passed over. With `repeat` an epoch may be longer than there are different tuples.
    """

    size: int = 256
    views: int = 1
    seed: int = 0
    split: Split | None = "train"
    where: str | None = None
    lighting: Literal["random", "stored"] = "random"
    length: int = 1000
    augment: bool = True
    visible: float = 30.0
    repeat: bool = False

    def __post_init__(self) -> None:
        for name, least in (("size", 1), ("views", 1), ("length", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise UserError(f"{name} {value} must be a whole number from {least} up")
        for name, words in (("split", get_args(Split)), ("lighting", ("random", "stored"))):
            value = getattr(self, name)
            if value not in words and not (name == "split" and value is None):
                raise UserError(f"{name} {value!r}: {did_you_mean(str(value), words)}there are {', '.join(words)}")

    def filter(self) -> str | None:
        """Return one SQL expression for `split` and `where`."""
        parts = [f"split = '{self.split}'"] if self.split else []
        parts += [f"({self.where})"] if self.where else []
        return " AND ".join(parts) or None
