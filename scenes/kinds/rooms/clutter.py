"""What lies about in a room: objects on every surface, books on shelves, and those that are to be inserted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.kinds.rooms.footing import Standing, standing_of
from multilight.scenes.kinds.rooms.layouts import RoomType
from multilight.scenes.kinds.rooms.plan import Placed, Plan, pose_at
from multilight.scenes.kinds.rooms.shelves import Shelf
from multilight.scenes.materials import GLOW, body_materials
from multilight.scenes.spec import Material
from multilight.scenes.still_life.placement import PlacementError

EDGE = 0.008
"""Smallest distance [m] of a footprint to the edge of its surface."""
TRIES = 24
MOST = 36
"""Objects that lie about a room at most, besides books and those inserted."""
EMISSIVE_SHARE = 1 / 3
REACH = 1.1
"""Distance [m] within which the inserted objects lie from each other."""
INSERTED = (0.15, 0.5)
"""Longest side [m] of objects inserted on furniture."""
FLOOR_INSERTED = (0.24, 0.95)
"""Longest side [m] of objects inserted on the floor."""
THIN = 0.05
_BEARERS = frozenset(
    {
        "table", "round", "rectangular", "trestle", "bistro", "coffee_table", "coffee", "desk", "sideboard",
        "nightstand", "counter", "chest", "bookcase", "shelf", "base_unit_a", "base_unit_b", "sink_unit_a",
        "sink_unit_b", "bench", "piano", "radiator", "washer", "fireplace", "workbench",
    }
)  # fmt: skip
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
_ON_FLOOR = frozenset(
    {
        "ball", "bag", "shoe", "box", "plant", "toy", "vase", "floor_plant", "bin", "basket", "suitcase", "speaker",
        "guitar", "animal", "rocking_horse", "trunk", "stool", "pouf", "large_vase",
    }
)  # fmt: skip


@dataclass(frozen=True)
class Spot:
    """A surface of a piece of furniture; its middle in the world (3,) [m]."""

    owner: Placed
    shelf: Shelf
    middle: Float64


class Objects:
    """Puts objects on the surfaces of a room."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.used: set[str] = set()

    def spots(self) -> list[Spot]:
        """List the surfaces of all furniture that bears things."""
        found = []
        for placed in list(self.plan.placed.values()):
            if placed.piece.info.category in _BEARERS:
                for shelf in self.plan.shelves(placed):
                    local = np.append(shelf.surface.centres.mean(axis=0), shelf.surface.height)
                    found.append(Spot(placed, shelf, placed.pose[:3, :3] @ local + placed.pose[:3, 3]))
        return found

    def standing(self, info: AssetInfo) -> Standing | None:
        """Return how an asset stands as it comes, None where it falls over or is broken."""
        piece = self.plan.piece(info)
        return None if piece is None else standing_of(piece.mesh)

    def put(self, rng: np.random.Generator, info: AssetInfo, spot: Spot, *, glows: bool = False) -> str | None:
        """Stand an object somewhere on a surface, most with their front to the room; None where it does not fit."""
        item = self.standing(info)
        if item is None or item.height > spot.shelf.headroom - 0.01:
            return None
        surface, owner = spot.shelf.surface, spot.owner
        cells = surface.centres
        neat = info.category == "books"
        for _ in range(TRIES):
            yaw = float(rng.normal(0.0, 0.02 if neat else 0.6))
            turn = pose_at((0.0, 0.0), 0.0, yaw)
            outline = item.footprint @ turn[:2, :2].T
            place = cells[int(rng.integers(len(cells)))]
            if not surface.supports(outline + place, EDGE):
                continue
            pose = owner.pose @ pose_at(place, surface.height - item.lowest + float(rng.uniform(0.0, 0.0002)), yaw)
            name = self._add(rng, info, pose, apart_from=(owner.name,), glows=glows)
            if name is not None:
                return name
        return None

    def put_on_floor(self, rng: np.random.Generator, info: AssetInfo, near: Float64, reach: float) -> str | None:
        """Stand an object on the floor, or wholly on a rug, within `reach` [m] of a point (2,)."""
        item = self.standing(info)
        if item is None:
            return None
        for _ in range(TRIES):
            angle = float(rng.uniform(0.0, 2 * np.pi))
            place = near + reach * np.sqrt(rng.uniform(0.05, 1.0)) * np.array([np.cos(angle), np.sin(angle)])
            pose = pose_at(place, -item.lowest + 0.0002, float(rng.uniform(0.0, 2 * np.pi)))
            low, high = self.plan.box(self.plan.piece(info), pose)  # type: ignore[arg-type]
            rugs = [
                name for name in self.plan.touched(low, high) if self.plan.placed[name].piece.info.category == "rug"
            ]
            base = self.plan.placed[rugs[0]] if rugs else None
            if base is not None:
                if (low[:2] < base.low[:2]).any() or (high[:2] > base.high[:2]).any():
                    continue
                pose[2, 3] += base.high[2]
            name = self._add(rng, info, pose, apart_from=rugs)
            if name is not None:
                return name
        return None

    def _add(
        self,
        rng: np.random.Generator,
        info: AssetInfo,
        pose: Float64,
        *,
        apart_from: Sequence[str],
        glows: bool = False,
    ) -> str | None:
        piece = self.plan.piece(info)
        if piece is None:
            return None
        low, high = self.plan.box(piece, pose)
        if not self.plan.is_free(low, high, apart_from=apart_from, zones=False):
            return None
        materials = body_materials(rng, self.plan.library, info, piece.mesh, glows=glows)
        if not glows:
            materials = tuple(_unlit(material) for material in materials)
        self.used.add(info.id)
        return self.plan.put(piece, pose, materials, role="object").name


def _unlit(material: Material) -> Material:
    """Rename what would be taken for a lamp."""
    return material.model_copy(update={"name": "opal"}) if material.name == GLOW else material


def _infos(plan: Plan, categories: Sequence[str] | frozenset[str], sides: tuple[float, float]) -> list[AssetInfo]:
    """List the assets of some categories whose longest side lies within a range [m]."""
    infos = [*plan.library.list("object"), *plan.library.list("surrounding")]
    return [i for i in infos if i.category in categories and i.size and sides[0] <= max(i.size) <= sides[1]]


def _draw(rng: np.random.Generator, infos: list[AssetInfo], used: set[str]) -> AssetInfo | None:
    """Draw a category, then one of its assets that is not in the room yet."""
    fresh = [info for info in infos if info.id not in used]
    if not fresh:
        return None
    categories = sorted({info.category for info in fresh})
    wanted = categories[int(rng.integers(len(categories)))]
    members = [info for info in fresh if info.category == wanted]
    return members[int(rng.integers(len(members)))]


def insert(rng: np.random.Generator, objects: Objects, kind: RoomType, count: int, glows: bool) -> list[str]:
    """Place the objects whose removal is rendered: on one surface, on the floor beside it, and on surfaces near.

    Returns their names. Raises `PlacementError` where the furniture leaves no room for them.
    """
    plan = objects.plan
    spots = [s for s in objects.spots() if 0.25 <= s.middle[2] <= 1.35 and s.shelf.headroom > 0.2]
    wide = [s for s in spots if s.shelf.surface.area > 0.09 and s.owner.piece.info.category != "radiator"]
    if not wide:
        raise PlacementError(f"no surface for inserted objects among {len(spots)} in a {kind} room")
    shares = np.array([min(s.shelf.surface.area, 0.6) for s in wide])
    focus = wide[int(rng.choice(len(wide), p=shares / shares.sum()))]
    near = [s for s in spots if 0.0 < np.linalg.norm(s.middle - focus.middle) < REACH and s.shelf.surface.area > 0.05]
    small = [
        i
        for i in _infos(plan, (*_COMMON, *_HABITS[kind]), INSERTED)
        if i.size is not None and sorted(i.size)[1] >= THIN
    ]
    large = _infos(plan, _ON_FLOOR, FLOOR_INSERTED)
    lamps = [i for i in _infos(plan, _GLOWING, INSERTED) if i.emissive_part]
    names: list[str] = []
    for attempt in range(60 * count):
        if len(names) == count:
            return names
        turn = (len(names) + attempt // 20) % 3
        lit = glows and not names and bool(lamps)
        info = _draw(rng, lamps if lit else large if turn == 1 else small, objects.used)
        if info is None:
            continue
        if turn == 1 and not lit:
            name = objects.put_on_floor(rng, info, focus.middle[:2], REACH)
        else:
            spot = near[int(rng.integers(len(near)))] if turn == 2 and near else focus
            name = objects.put(rng, info, spot, glows=lit or (info.category == "lamp" and rng.random() < 0.5))
        names += [] if name is None else [name]
    raise PlacementError(f"only {len(names)} of {count} objects found a place in a {kind} room")


def litter(rng: np.random.Generator, objects: Objects, kind: RoomType) -> None:
    """Put books on shelves and something on every surface that has room."""
    plan = objects.plan
    spots = objects.spots()
    rows = [info for info in plan.library.list("surrounding") if info.category == "books"]
    for spot in spots:
        if spot.owner.piece.info.category in _SHELVED and rows:
            for _ in range(int(rng.integers(1, 4))):
                objects.put(rng, rows[int(rng.integers(len(rows)))], spot)
    pool = _infos(plan, (*_COMMON, *_HABITS[kind]), (0.03, 0.5))
    left = MOST
    for i in rng.permutation(len(spots)):
        spot = spots[int(i)]
        side = 0.9 * np.sqrt(spot.shelf.surface.area)
        fitting = [
            info
            for info in pool
            if info.size and max(info.size[:2]) < side and info.size[2] < spot.shelf.headroom - 0.01
        ]
        wanted = min(left, 1 + int(rng.poisson(6.0 * min(spot.shelf.surface.area, 0.8))))
        for _ in range(2 * wanted):
            info = _draw(rng, fitting, objects.used)
            lit = info is not None and info.category == "lamp" and rng.random() < 0.4
            if wanted and info is not None and objects.put(rng, info, spot, glows=lit) is not None:
                left, wanted = left - 1, wanted - 1
    floor = _infos(plan, _ON_FLOOR, (0.12, 0.8))
    for _ in range(int(rng.integers(1, 4))):
        info = _draw(rng, floor, objects.used)
        if info is not None:
            half = min(plan.shell.width, plan.shell.depth) / 2
            objects.put_on_floor(rng, info, rng.uniform(-0.4, 0.4, 2) * half, half)
