"""Where furniture goes, by room type: sofas face a screen, chairs stand at tables, beds have their head at a wall."""

from collections.abc import Callable
from typing import Literal

from multilight.scenes.kinds.rooms import groups, workplaces
from multilight.scenes.kinds.rooms.plan import Plan
from multilight.scenes.streams import Rng

RoomType = Literal["living", "kitchen", "bedroom", "study"]
Span = tuple[tuple[float, float], tuple[float, float]]

SPANS: dict[RoomType, Span] = {
    "living": ((4.6, 6.4), (3.9, 5.2)),
    "kitchen": ((3.9, 5.4), (3.3, 4.4)),
    "bedroom": ((3.9, 5.2), (3.5, 4.4)),
    "study": ((3.4, 4.8), (3.0, 4.0)),
}
"""Least and greatest length [m] of the longer and of the shorter side."""


def _living(rng: Rng, plan: Plan) -> None:
    """A seating group that faces a screen or a fire; shelves, a sideboard and plants along the walls."""
    groups.seating(rng, plan)
    groups.ceiling_light(rng, plan)
    groups.curtains(rng, plan, probability=0.6)
    groups.along_walls(rng, plan, "bookcase", probability=0.9)
    groups.along_walls(rng, plan, "sideboard", "chest", probability=0.8)
    groups.along_walls(rng, plan, "piano", probability=0.15)
    groups.along_walls(rng, plan, "bookcase", probability=0.4)
    groups.in_corners(rng, plan, "floorlamp", "floor_lamp", count=int(rng.integers(1, 3)))
    groups.in_corners(rng, plan, "floor_plant", "large_vase", count=int(rng.integers(1, 4)))
    groups.along_walls(rng, plan, "radiator", probability=0.3)
    groups.on_walls(rng, plan, shelves=int(rng.integers(0, 3)), pictures=int(rng.integers(3, 8)))


def _kitchen(rng: Rng, plan: Plan) -> None:
    """A row of units along a wall, and a dining table with chairs under a pendant."""
    workplaces.kitchen_row(rng, plan)
    workplaces.dining(rng, plan)
    groups.ceiling_light(rng, plan)
    groups.curtains(rng, plan, probability=0.2)
    groups.along_walls(rng, plan, "sideboard", "counter", probability=0.6)
    groups.along_walls(rng, plan, "bookcase", probability=0.3)
    groups.in_corners(rng, plan, "bin", count=1)
    groups.in_corners(rng, plan, "floor_plant", "basket", count=int(rng.integers(1, 3)))
    groups.along_walls(rng, plan, "radiator", probability=0.3)
    groups.on_walls(rng, plan, shelves=int(rng.integers(1, 3)), pictures=int(rng.integers(2, 5)))


def _bedroom(rng: Rng, plan: Plan) -> None:
    """A bed between nightstands, a wardrobe, a chest, something to sit on."""
    workplaces.bed(rng, plan)
    groups.ceiling_light(rng, plan)
    groups.curtains(rng, plan, probability=0.8)
    groups.along_walls(rng, plan, "wardrobe", probability=1.0)
    groups.along_walls(rng, plan, "chest", "sideboard", probability=0.9)
    workplaces.desk(rng, plan, probability=0.4)
    groups.along_walls(rng, plan, "bookcase", probability=0.4)
    groups.in_corners(rng, plan, "armchair", "pouf", "chair", count=1)
    groups.in_corners(rng, plan, "floorlamp", "floor_lamp", count=int(rng.integers(0, 2)))
    groups.in_corners(rng, plan, "floor_plant", "basket", count=int(rng.integers(1, 3)))
    groups.along_walls(rng, plan, "radiator", probability=0.3)
    groups.on_walls(rng, plan, shelves=int(rng.integers(0, 3)), pictures=int(rng.integers(3, 7)))


def _study(rng: Rng, plan: Plan) -> None:
    """A desk with its chair, bookcases, an armchair to read in."""
    workplaces.desk(rng, plan, probability=1.0)
    groups.ceiling_light(rng, plan)
    groups.curtains(rng, plan, probability=0.5)
    groups.along_walls(rng, plan, "bookcase", probability=1.0)
    groups.along_walls(rng, plan, "bookcase", probability=0.6)
    groups.along_walls(rng, plan, "sideboard", "chest", probability=0.8)
    workplaces.reading_corner(rng, plan)
    groups.in_corners(rng, plan, "floor_plant", "large_vase", count=int(rng.integers(1, 3)))
    groups.in_corners(rng, plan, "bin", "basket", count=1)
    groups.along_walls(rng, plan, "radiator", probability=0.3)
    groups.on_walls(rng, plan, shelves=int(rng.integers(1, 4)), pictures=int(rng.integers(3, 7)))


FURNISH: dict[RoomType, Callable[[Rng, Plan], None]] = {
    "living": _living,
    "kitchen": _kitchen,
    "bedroom": _bedroom,
    "study": _study,
}
