"""Where furniture goes, by room type: sofas face a screen, chairs stand at tables, beds have their head at a wall."""

from collections.abc import Callable
from typing import Literal

from multilight.scenes.kinds.rooms import groups, workplaces
from multilight.scenes.kinds.rooms.plan import Plan

RoomType = Literal["living", "kitchen", "bedroom", "study"]
Span = tuple[tuple[float, float], tuple[float, float]]

SPANS: dict[RoomType, Span] = {
    "living": ((4.6, 6.4), (3.9, 5.2)),
    "kitchen": ((3.9, 5.4), (3.3, 4.4)),
    "bedroom": ((3.9, 5.2), (3.5, 4.4)),
    "study": ((3.4, 4.8), (3.0, 4.0)),
}
"""Least and greatest length [m] of the longer and of the shorter side."""


def _living(plan: Plan) -> None:
    """A seating group that faces a screen or a fire; shelves, a sideboard and plants along the walls."""
    groups.seating(plan)
    groups.ceiling_light(plan)
    groups.curtains(plan, probability=0.6)
    groups.along_walls(plan, "bookcase", probability=0.9)
    groups.along_walls(plan, "sideboard", "chest", probability=0.8)
    groups.along_walls(plan, "piano", probability=0.15)
    groups.along_walls(plan, "bookcase", probability=0.4)
    groups.in_corners(plan, "floorlamp", "floor_lamp", count=int(plan.rng.integers(1, 3)))
    groups.in_corners(plan, "floor_plant", "large_vase", count=int(plan.rng.integers(1, 4)))
    groups.along_walls(plan, "radiator", probability=0.3)
    groups.on_walls(plan, shelves=int(plan.rng.integers(0, 3)), pictures=int(plan.rng.integers(3, 8)))


def _kitchen(plan: Plan) -> None:
    """A row of units along a wall, and a dining table with chairs under a pendant."""
    workplaces.kitchen_row(plan)
    workplaces.dining(plan)
    groups.ceiling_light(plan)
    groups.curtains(plan, probability=0.2)
    groups.along_walls(plan, "sideboard", "counter", probability=0.6)
    groups.along_walls(plan, "bookcase", probability=0.3)
    groups.in_corners(plan, "bin", count=1)
    groups.in_corners(plan, "floor_plant", "basket", count=int(plan.rng.integers(1, 3)))
    groups.along_walls(plan, "radiator", probability=0.3)
    groups.on_walls(plan, shelves=int(plan.rng.integers(1, 3)), pictures=int(plan.rng.integers(2, 5)))


def _bedroom(plan: Plan) -> None:
    """A bed between nightstands, a wardrobe, a chest, something to sit on."""
    workplaces.bed(plan)
    groups.ceiling_light(plan)
    groups.curtains(plan, probability=0.8)
    groups.along_walls(plan, "wardrobe", probability=1.0)
    groups.along_walls(plan, "chest", "sideboard", probability=0.9)
    workplaces.desk(plan, probability=0.4)
    groups.along_walls(plan, "bookcase", probability=0.4)
    groups.in_corners(plan, "armchair", "pouf", "chair", count=1)
    groups.in_corners(plan, "floorlamp", "floor_lamp", count=int(plan.rng.integers(0, 2)))
    groups.in_corners(plan, "floor_plant", "basket", count=int(plan.rng.integers(1, 3)))
    groups.along_walls(plan, "radiator", probability=0.3)
    groups.on_walls(plan, shelves=int(plan.rng.integers(0, 3)), pictures=int(plan.rng.integers(3, 7)))


def _study(plan: Plan) -> None:
    """A desk with its chair, bookcases, an armchair to read in."""
    workplaces.desk(plan, probability=1.0)
    groups.ceiling_light(plan)
    groups.curtains(plan, probability=0.5)
    groups.along_walls(plan, "bookcase", probability=1.0)
    groups.along_walls(plan, "bookcase", probability=0.6)
    groups.along_walls(plan, "sideboard", "chest", probability=0.8)
    workplaces.reading_corner(plan)
    groups.in_corners(plan, "floor_plant", "large_vase", count=int(plan.rng.integers(1, 3)))
    groups.in_corners(plan, "bin", "basket", count=1)
    groups.along_walls(plan, "radiator", probability=0.3)
    groups.on_walls(plan, shelves=int(plan.rng.integers(1, 4)), pictures=int(plan.rng.integers(3, 7)))


FURNISH: dict[RoomType, Callable[[Plan], None]] = {
    "living": _living,
    "kitchen": _kitchen,
    "bedroom": _bedroom,
    "study": _study,
}
