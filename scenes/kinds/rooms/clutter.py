"""What lies about in a room: objects on every surface, books on shelves, and those that are to be inserted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.kinds.rooms.finish import unlit
from multilight.scenes.kinds.rooms.footing import footing_of, shelves_of
from multilight.scenes.kinds.rooms.layouts import RoomType
from multilight.scenes.kinds.rooms.plan import LIFT, PlacedPiece, Plan
from multilight.scenes.kinds.rooms.shelves import Shelf
from multilight.scenes.materials import body_materials
from multilight.scenes.poses import about_z, apply_pose, pose_at
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.still_life.placement import PlacementError
from multilight.scenes.still_life.selection import draw_by_category

# Measures of what lies about [m, m²], and how often [probability].
EDGE = 0.008  # smallest distance of a footprint to the edge of its surface
HEADROOM = 0.01  # air below the board above
ASKEW, ASKEW_BOOKS = 0.6, 0.02  # deviation [rad] of objects' fronts from that of the furniture; of rows of books
TRIES = 24  # poses of an object on one surface, places for it on the floor
MOST = 36  # objects in a room, besides books and those inserted
CROWD, CROWDED = 6.0, 0.8  # objects a square metre, besides one on each surface; area beyond which no more come
GLOWING = 1 / 3  # an inserted object glows in any case
INSERTED_LAMP_LIT, LAMP_LIT = 0.5, 0.4  # any other inserted lamp; one that lies about
REACH = 1.1  # within which the inserted objects lie from each other
INSERTED, FLOOR_INSERTED, THIN = (0.15, 0.5), (0.24, 0.95), 0.05  # their longest sides; their second, at least
SURFACES, OPEN = (0.25, 1.35), 0.2  # heights of surfaces that objects are inserted on, and what is free above
FOCUS, NEAR = (0.09, 0.6), 0.05  # area of the first of them: at least, and what makes it no likelier; of those near
LITTER, FLOOR_LITTER = (0.03, 0.5), (0.12, 0.8)  # longest sides of what else lies about
_BEARERS = frozenset({
    "table", "round", "rectangular", "trestle", "bistro", "coffee_table", "coffee", "desk", "sideboard",
    "nightstand", "counter", "chest", "bookcase", "shelf", "base_unit_a", "base_unit_b", "sink_unit_a",
    "sink_unit_b", "bench", "piano", "radiator", "washer", "fireplace", "workbench",
})  # fmt: skip
_SHELVED = frozenset({"bookcase", "shelf"})
_COMMON = ("plant", "vase", "bowl", "book", "lamp", "box", "clock", "figurine", "jar", "fruit", "candle", "frame")
_HABITS: dict[RoomType, tuple[str, ...]] = {
    "living": ("toy", "electronics", "glasses", "camera", "ashtray", "ball", "cup", "tray", "pawn", "orb", "ring"),
    "kitchen": (
        "food", "bottle", "appliance", "cup", "mug", "plate", "glass", "kettle", "utensil", "jug", "pan", "board",
        "shaker", "teapot", "tray", "can", "tumbler",
    ),
    "bedroom": ("cosmetics", "jewellery", "watch", "glasses", "hat", "bag", "ball", "toy", "ring"),
    "study": ("stationery", "electronics", "paper", "glasses", "camera", "mug", "watch", "pawn", "tool", "die"),
}  # fmt: skip
_GLOWING = ("lamp", "candle", "lantern", "night light", "monitor", "electronics", "tablet", "sign", "neon", "bulb")
_ON_FLOOR = frozenset({
    "ball", "bag", "shoe", "box", "plant", "toy", "vase", "floor_plant", "bin", "basket", "suitcase", "speaker",
    "guitar", "animal", "rocking_horse", "trunk", "stool", "pouf", "large_vase",
})  # fmt: skip


@dataclass(frozen=True)
class Spot:
    """A surface of a piece of furniture; its centre in the world (3,) [m]."""

    owner: PlacedPiece
    shelf: Shelf
    centre: Float64

    @property
    def area(self) -> float:
        """Free area [m²]."""
        return self.shelf.surface.area


class Objects:
    """Puts objects on the surfaces of a room."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.used: set[str] = set()

    def spots(self) -> list[Spot]:
        """List the surfaces of all furniture that bears things."""
        found = []
        for placed in self.plan.placed.values():
            if placed.piece.info.category in _BEARERS:
                for shelf in shelves_of(placed.piece.mesh):
                    local = np.append(shelf.surface.centres.mean(axis=0), shelf.surface.height)
                    found.append(Spot(placed, shelf, apply_pose(placed.pose, local)))
        return found

    def draw(self, rng: Rng, infos: Sequence[AssetInfo]) -> AssetInfo | None:
        """Draw a category, then one of its assets that is not in the room yet; None where there is none."""
        fresh = [info for info in infos if info.id not in self.used]
        return draw_by_category(rng, fresh) if fresh else None

    def put(self, rng: Rng, info: AssetInfo, spot: Spot, *, glows: bool = False) -> str | None:
        """Stand an object somewhere on a surface, most with their front to the room; None where it does not fit."""
        piece = self.plan.piece(info)
        footing = None if piece is None else footing_of(piece.mesh)
        if footing is None or footing.height > spot.shelf.headroom - HEADROOM:
            return None
        surface, owner = spot.shelf.surface, spot.owner
        for _ in range(TRIES):
            yaw = float(rng.normal(0.0, ASKEW_BOOKS if info.category == "books" else ASKEW))
            outline = footing.footprint @ about_z(yaw)[:2, :2].T
            place = surface.centres[int(rng.integers(len(surface.centres)))]
            if not surface.supports(outline + place, EDGE):
                continue
            level = surface.height - footing.lowest + float(rng.uniform(0.0, LIFT))
            name = self._add(rng, info, owner.pose @ pose_at(place, level, yaw), apart_from=(owner.name,), glows=glows)
            if name is not None:
                return name
        return None

    def put_on_floor(self, rng: Rng, info: AssetInfo, near: Float64, reach: float) -> str | None:
        """Stand an object on the floor, or wholly on a rug, within `reach` [m] of a point (2,)."""
        piece = self.plan.piece(info)
        footing = None if piece is None else footing_of(piece.mesh)
        if piece is None or footing is None:
            return None
        for _ in range(TRIES):
            angle = float(rng.uniform(0.0, 2 * np.pi))
            place = near + reach * np.sqrt(rng.uniform(0.05, 1.0)) * np.array([np.cos(angle), np.sin(angle)])
            pose = pose_at(place, -footing.lowest + LIFT, float(rng.uniform(0.0, 2 * np.pi)))
            low, high = self.plan.box(piece, pose)
            touched = [self.plan.placed[name] for name in self.plan.touched(low, high)]
            rugs = [placed for placed in touched if placed.piece.info.category == "rug"]
            if rugs:
                rug = rugs[0]
                if (low[:2] < rug.low[:2]).any() or (high[:2] > rug.high[:2]).any():
                    continue
                pose[2, 3] += rug.high[2]
            name = self._add(rng, info, pose, apart_from=[rug.name for rug in rugs])
            if name is not None:
                return name
        return None

    def _add(
        self, rng: Rng, info: AssetInfo, pose: Float64, *, apart_from: Sequence[str], glows: bool = False
    ) -> str | None:
        piece = self.plan.piece(info)
        if piece is None or not self.plan.is_free(*self.plan.box(piece, pose), apart_from=apart_from, zones=False):
            return None
        materials = body_materials(rng, self.plan.library, info, piece.mesh, glows=glows)
        self.used.add(info.id)
        made = materials if glows else tuple(unlit(material) for material in materials)
        return self.plan.put(piece, pose, made, role="object").name


def _infos(plan: Plan, categories: Sequence[str] | frozenset[str], sides: tuple[float, float]) -> list[AssetInfo]:
    """List the assets of some categories whose longest side lies within a range [m]."""
    infos = [*plan.library.list("object"), *plan.library.list("surrounding")]
    return [i for i in infos if i.category in categories and i.size and sides[0] <= max(i.size) <= sides[1]]


def insert(rng: Rng, objects: Objects, kind: RoomType, count: int, glows: bool) -> list[str]:
    """Place the objects whose removal is rendered: on one surface, on the floor beside it, and on surfaces near.

    Returns their names. Raises `PlacementError` where the furniture leaves no room for them.
    """
    focus, near = _stage(rng, objects, kind)
    plan = objects.plan
    small = [i for i in _infos(plan, (*_COMMON, *_HABITS[kind]), INSERTED) if i.size and sorted(i.size)[1] >= THIN]
    large = _infos(plan, _ON_FLOOR, FLOOR_INSERTED)
    lamps = [info for info in _infos(plan, _GLOWING, INSERTED) if info.emissive_part]
    names: list[str] = []
    for attempt in range(60 * count):
        if len(names) == count:
            return names
        lamp = glows and not names and bool(lamps)
        # Alternately on the surface, on the floor and near by; every twenty attempts the next comes first.
        where = (len(names) + attempt // 20) % 3
        info = objects.draw(rng, lamps if lamp else large if where == 1 else small)
        if info is None:
            continue
        if where == 1 and not lamp:
            name = objects.put_on_floor(rng, info, focus.centre[:2], REACH)
        else:
            spot = pick(rng, near) if where == 2 and near else focus
            lit = lamp or (info.category == "lamp" and rng.random() < INSERTED_LAMP_LIT)
            name = objects.put(rng, info, spot, glows=lit)
        names += [] if name is None else [name]
    raise PlacementError(f"only {len(names)} of {count} objects found a place in a {kind} room")


def _stage(rng: Rng, objects: Objects, kind: RoomType) -> tuple[Spot, list[Spot]]:
    """Draw the surface that objects are inserted on, large ones more often, and list those near it."""
    spots = [s for s in objects.spots() if SURFACES[0] <= s.centre[2] <= SURFACES[1] and s.shelf.headroom > OPEN]
    wide = [s for s in spots if s.area > FOCUS[0] and s.owner.piece.info.category != "radiator"]
    if not wide:
        raise PlacementError(f"no surface for inserted objects among {len(spots)} in a {kind} room")
    focus = pick(rng, wide, [min(s.area, FOCUS[1]) for s in wide])
    near = [s for s in spots if 0.0 < np.linalg.norm(s.centre - focus.centre) < REACH and s.area > NEAR]
    return focus, near


def litter(rng: Rng, objects: Objects, kind: RoomType) -> None:
    """Put books on shelves and something on every surface that has room."""
    plan = objects.plan
    spots = objects.spots()
    rows = [info for info in plan.library.list("surrounding") if info.category == "books"]
    for spot in spots:
        if spot.owner.piece.info.category in _SHELVED and rows:
            for _ in range(int(rng.integers(1, 4))):
                objects.put(rng, pick(rng, rows), spot)
    pool = _infos(plan, (*_COMMON, *_HABITS[kind]), LITTER)
    left = MOST
    for i in rng.permutation(len(spots)):
        left -= _strew(rng, objects, spots[int(i)], pool, left)
    floor = _infos(plan, _ON_FLOOR, FLOOR_LITTER)
    for _ in range(int(rng.integers(1, 4))):
        info = objects.draw(rng, floor)
        if info is not None:
            half = min(plan.shell.width, plan.shell.depth) / 2
            objects.put_on_floor(rng, info, rng.uniform(-0.4, 0.4, 2) * half, half)


def _strew(rng: Rng, objects: Objects, spot: Spot, pool: list[AssetInfo], most: int) -> int:
    """Put objects that fit on a surface, `most` at most; return how many found a place."""
    side, height = 0.9 * np.sqrt(spot.area), spot.shelf.headroom - HEADROOM
    fitting = [info for info in pool if info.size and max(info.size[:2]) < side and info.size[2] < height]
    wanted = min(most, 1 + int(rng.poisson(CROWD * min(spot.area, CROWDED))))
    placed = 0
    for _ in range(2 * wanted):
        info = objects.draw(rng, fitting)
        lit = info is not None and info.category == "lamp" and rng.random() < LAMP_LIT
        if placed < wanted and info is not None and objects.put(rng, info, spot, glows=lit) is not None:
            placed += 1
    return placed
