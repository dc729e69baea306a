"""Things that come to rest on each other: heaps by physics, stacks by lowering, both exact on the true meshes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.geometry.contact import support_of
from multilight.scenes.geometry.overlap import boxes_meet, depth, gap, touching, way_out
from multilight.scenes.geometry.solids import Placed, Solid
from multilight.scenes.physics.fall import Region, fall
from multilight.scenes.random_streams import Rng

DEEPEST = 8e-4
"""No two bodies that were settled lie deeper in each other than this [m]; `geometry.contact` allows a millimetre."""
CLOSE = 2e-4
"""A body is lowered until it is this close [m] to what it rests on."""
STEPS = 60
"""Moves after which a search for rest is given up."""


@dataclass(frozen=True)
class Settled:
    """Where bodies came to rest: `poses` (4, 4) in the order given, None where one found no rest, and why not."""

    poses: tuple[Float64 | None, ...]
    dropped: dict[int, str]


def settle(rng: Rng, movers: Sequence[Solid], fixed: Sequence[Placed], region: Region, *, spread: float) -> Settled:
    """Let bodies fall in turn onto what is fixed, within `spread` [m] of the region's centre, and come to rest.

    What physics leaves is corrected against the true meshes: no body lies deeper than `DEEPEST` in another, and all
    are carried (`geometry.contact.support_of`). Bodies for which that cannot be had, and those that rolled out of the
    region, are dropped. The same generator state gives the same poses on one machine.
    """
    fallen = fall(rng, movers, fixed, region, spread=spread)
    loose = [Placed(mover, pose) for mover, pose in zip(movers, fallen, strict=True)]
    poses: list[Float64 | None] = [None] * len(movers)
    dropped: dict[int, str] = {}
    standing = list(fixed)
    # From below upwards: what carries comes before what is carried.
    for index in sorted(range(len(loose)), key=lambda i: float(loose[i].box[0][2])):
        item = loose[index]
        if np.abs(item.pose[:2, 3] - region.centre).max() > region.half:
            dropped[index] = "rolled out of the region"
            continue
        firm = _made_firm(item, standing)
        if isinstance(firm, str):
            dropped[index] = firm
            continue
        poses[index] = firm.pose
        standing.append(firm)
    return Settled(tuple(poses), dropped)


def _made_firm(item: Placed, standing: Sequence[Placed]) -> Placed | str:
    """Push a body out of others, lower it onto them, and see that it is carried; else say what is wrong."""
    for _ in range(3):
        freed = _freed(item, standing)
        if freed is None:
            return "lies in another body"
        near = _near(freed, standing)
        if support_of(freed, _contacts(freed, near)) is not None:
            return freed
        item = lowered(freed, near)
        if support_of(item, _contacts(item, near)) is not None and _deepest(item, near) <= DEEPEST:
            return item
    return "is not carried"


def _near(item: Placed, others: Sequence[Placed], reach: float = 0.05) -> list[Placed]:
    return [other for other in others if boxes_meet(item, other, reach)]


def _contacts(item: Placed, others: Sequence[Placed]) -> list[tuple[Placed, Float64]]:
    found = ((other, touching(item, other)) for other in others)
    return [(other, points) for other, points in found if len(points)]


def _deepest(item: Placed, others: Sequence[Placed]) -> float:
    return max((depth(item, other, ignore=DEEPEST) for other in others), default=0.0)


def _freed(item: Placed, standing: Sequence[Placed]) -> Placed | None:
    """Push a body out of what it lies in, in the shortest direction; None where it stays stuck."""
    for _ in range(STEPS):
        near = _near(item, standing)
        deep = [other for other in near if depth(item, other, ignore=DEEPEST) > DEEPEST]
        if not deep:
            return item
        shifts = [way_out(item, other) for other in deep]
        item = item.moved(sum(shifts, start=np.zeros(3)) * (0.7 if len(shifts) > 1 else 0.9))
    return None


def lowered(item: Placed, others: Sequence[Placed]) -> Placed:
    """Lower a body until it is `CLOSE` to another, without ever crossing one."""
    if not others:
        return item
    # A gap shrinks no faster than the body sinks: only the smallest needs to be measured anew.
    bounds = np.array([gap(item, other) for other in others])
    for _ in range(STEPS):
        nearest = int(np.argmin(bounds))
        bounds[nearest] = gap(item, others[nearest])
        if nearest != int(np.argmin(bounds)):
            continue
        if bounds[nearest] <= CLOSE:
            return item
        step = bounds[nearest] - CLOSE / 2
        item = item.moved(np.array([0.0, 0.0, -step]))
        bounds -= step
    return item


def stack(movers: Sequence[Solid], poses: Sequence[Float64], fixed: Sequence[Placed]) -> Settled:
    """Lower bodies one after the other, in their given rotation and place, onto what is fixed and onto each other.

    Their heights do not count: each comes from above. Ends with the first that would not be carried there.
    """
    standing = list(fixed)
    result: list[Float64 | None] = [None] * len(movers)
    for index, (mover, pose) in enumerate(zip(movers, poses, strict=True)):
        item = Placed(mover, pose)
        low, high = item.box
        below = [other for other in standing if (other.box[0] <= high)[:2].all() and (other.box[1] >= low)[:2].all()]
        top = max(float(other.box[1][2]) for other in below) if below else 0.0
        item = item.moved(np.array([0.0, 0.0, top - float(low[2]) + 1e-3]))
        item = lowered(item, below)
        below = [other for other in below if gap(item, other) < 2e-3]
        if support_of(item, _contacts(item, below)) is None or _deepest(item, below) > DEEPEST:
            return Settled(tuple(result), dict.fromkeys(range(index, len(movers)), "would not be carried"))
        result[index] = item.pose
        standing.append(item)
    return Settled(tuple(result), {})
