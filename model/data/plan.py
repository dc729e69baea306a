"""Which place of the dataset each sample of an epoch shows: a pure function of seed, epoch and index."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import polars as pl

from multilight.datagen.errors import UserError
from multilight.model.data.settings import SampleSettings
from multilight.scenes.arrays import Int64


@dataclass(frozen=True)
class Place:
    """An insertable object of a scene and the views to choose from, those where it is seen well first."""

    scene: int
    object: str
    seen: tuple[int, ...]
    others: tuple[int, ...] = ()


@dataclass(frozen=True)
class Draw:
    """One sample: a place, its views, the stored (insert, base) conditions where lighting is, and its own generator."""

    place: Place
    views: tuple[int, ...]
    conditions: tuple[int, int] | None
    rng: np.random.Generator


def places_of(visible: pl.DataFrame, settings: SampleSettings) -> tuple[Place, ...]:
    """List the places: one for each view and object, or for each object where samples are groups of views.

    Of a group's views at least half must show the object. Raises `UserError` where nothing is left.
    """
    rows = visible.sort("scene", "object", "view")
    if settings.views == 1:
        rows = rows.filter(pl.col("pixels") >= settings.visible)
        found = [Place(s, o, (v,)) for s, v, o in rows.select("scene", "view", "object").iter_rows()]
    else:
        found = []
        for (scene, name), group in rows.group_by("scene", "object", maintain_order=True):
            seen = group["pixels"] >= settings.visible
            views = group["view"]
            place = Place(int(scene), str(name), tuple(views.filter(seen)), tuple(views.filter(~seen)))
            if len(views) >= settings.views and 2 * len(place.seen) >= settings.views:
                found.append(place)
    if not found:
        raise UserError(
            f"no scene with split {settings.split!r} and where {settings.where!r} shows an insertable object on "
            f"{settings.visible:g} pixels of {settings.views} view(s){'; split None takes all' * bool(settings.split)}"
        )
    return tuple(found)


def generator(*key: int) -> np.random.Generator:
    """Return a generator that depends on nothing but its key."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))


@dataclass(frozen=True)
class Plan:
    """The epochs' order: every round goes once through all places, each time in another order."""

    places: tuple[Place, ...]
    settings: SampleSettings
    conditions: int
    """Stored conditions of every scene."""

    def __post_init__(self) -> None:
        room = len(self.places) * self.pairs
        settings = self.settings
        if settings.lighting == "stored" and settings.length > room and not settings.repeat:
            raise UserError(
                f"length {settings.length}: with stored lighting there are {room} different tuples "
                f"({len(self.places)} places x {self.pairs} pairs of conditions); "
                "ask for no more, or for repeat"
            )

    @property
    def pairs(self) -> int:
        """Ordered pairs of two different stored conditions; 1, of the only one with itself, where there is one."""
        return max(1, self.conditions * (self.conditions - 1))

    def place(self, epoch: int, index: int) -> int:
        """Return the number of the place that a sample shows."""
        lap, slot = divmod(index, len(self.places))
        return int(_order(self.settings.seed, epoch, lap, len(self.places))[slot])

    def draw(self, epoch: int, index: int) -> Draw:
        """Draw a sample's place, views and, with stored lighting, its (insert, base) conditions."""
        seed, number = self.settings.seed, self.place(epoch, index)
        place, lap = self.places[number], index // len(self.places)
        rng = generator(seed, epoch, index, 1)
        pair = None
        if self.settings.lighting == "stored":
            pair = self._pair(int(generator(seed, epoch, number, 2).permutation(self.pairs)[lap % self.pairs]))
        return Draw(place, _views(place, self.settings.views, rng), pair, rng)

    def _pair(self, number: int) -> tuple[int, int]:
        insert, base = divmod(number, max(1, self.conditions - 1))
        return insert, min(base + (base >= insert), self.conditions - 1)


def _views(place: Place, count: int, rng: np.random.Generator) -> tuple[int, ...]:
    seen = rng.permutation(place.seen)[:count]
    others = rng.permutation(place.others)[: count - len(seen)]
    return tuple(int(v) for v in rng.permutation(np.concatenate([seen, others])))


@lru_cache(maxsize=8)
def _order(seed: int, epoch: int, lap: int, count: int) -> Int64:
    return generator(seed, epoch, lap, 0).permutation(count)
