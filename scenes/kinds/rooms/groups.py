"""Groups of furniture that belong together, and single pieces along walls, in corners, on walls and under ceilings."""

import numpy as np

from multilight.scenes.assets.builtin.furnishings import CURTAIN_HEIGHT
from multilight.scenes.assets.builtin.joinery import LINING as _LINING
from multilight.scenes.assets.builtin.joinery import SILL
from multilight.scenes.kinds.rooms.finish import furniture_materials
from multilight.scenes.kinds.rooms.plan import HUNG, Placed, Plan, pose_at
from multilight.scenes.kinds.rooms.shell import Wall

TABLES = ("table", "round", "rectangular", "trestle", "bistro")
"""Categories of tables to dine at."""
WALKWAY = 0.6
"""Free floor [m] before furniture with doors and drawers."""


def place_openings(rng: np.random.Generator, plan: Plan) -> None:
    """Put windows and doors into their holes."""
    for opening in plan.shell.openings:
        piece = plan.piece(opening.info)
        if piece is None:
            continue
        out = float(piece.low[1]) + opening.proud
        z = 0.0 if opening.is_door else opening.bottom + _LINING / 2 - SILL
        pose = pose_at(opening.wall.point(opening.along, out), z, opening.wall.angle)
        materials = tuple(
            plan.palette.joinery if part.material.name in ("joinery", "leaf") else part.material
            for part in piece.mesh.parts
        )
        plan.put(piece, pose, materials, role="surrounding")


def curtains(rng: np.random.Generator, plan: Plan, *, share: float) -> None:
    """Hang curtains before windows where there is room; all alike, or none."""
    if rng.random() >= share or plan.shell.height < CURTAIN_HEIGHT + 0.02:
        return
    chosen = int(rng.integers(2))
    for opening in plan.shell.openings:
        key = opening.info.id.split("-")
        if opening.is_door or key[0] != "builtin/window":
            continue
        name = f"builtin/curtains-{key[1]}-{1 + chosen:02d}"
        piece = plan.piece(plan.library.info(name))
        if piece is not None:
            own = [placed.name for placed in plan.placed.values() if placed.piece.info.category == "window"]
            out = piece.size[1] / 2 + HUNG
            pose = pose_at(opening.wall.point(opening.along, float(out)), 0.001, opening.wall.angle)
            if plan.is_free(*plan.box(piece, pose), apart_from=own, boards=False):
                materials = furniture_materials(rng, plan.palette, piece.info, piece.mesh)
                plan.put(piece, pose, materials, role="surrounding")


def ceiling_light(rng: np.random.Generator, plan: Plan) -> None:
    """Hang a lamp in the middle of the ceiling: a pendant where it hangs high enough or over a table."""
    if any(placed.piece.info.category == "pendant" for placed in plan.placed.values()):
        return
    tall = plan.shell.height - 2.0
    piece = plan.choose(rng, "pendant", largest=(0.7, 0.7, tall)) if rng.random() < 0.5 else None
    piece = piece or plan.choose(rng, "ceilinglamp", "ceiling_lamp")
    if piece is not None:
        place = rng.uniform(-0.3, 0.3, 2)
        plan.add(rng, piece, pose_at(place, plan.shell.height - HUNG - float(piece.size[2]), 0.0), lit=True)


def along_walls(rng: np.random.Generator, plan: Plan, *categories: str, share: float) -> Placed | None:
    """Stand one piece with its back to some wall, with a free way before it, in a share of the rooms."""
    if rng.random() >= share:
        return None
    for _ in range(3):
        piece = plan.choose(rng, *categories, largest=(2.6, 0.8, plan.shell.height - 0.1))
        if piece is None:
            return None
        for wall in plan.walls_by_room(rng):
            done = plan.against_wall(rng, piece, wall)
            if done is not None:
                keep_way(plan, done, wall)
                return done
    return None


def keep_way(plan: Plan, placed: Placed, wall: Wall) -> None:
    """Keep a walkway free before a piece at a wall."""
    step = np.append(wall.inward * WALKWAY, 0.0)
    low, high = np.minimum(placed.low, placed.low + step), np.maximum(placed.high, placed.high + step)
    front = np.append(wall.inward, 0.0)
    inner_low = np.where(front > 0, placed.high, low)
    inner_high = np.where(front < 0, placed.low, high)
    low, high = np.where(front != 0, inner_low, placed.low), np.where(front != 0, inner_high, placed.high)
    high[2], low[2] = 1.8, 0.05
    plan.keep_free(np.minimum(low, high), np.maximum(low, high))


def in_corners(rng: np.random.Generator, plan: Plan, *categories: str, count: int) -> None:
    """Stand pieces near corners, their front towards the middle of the room."""
    for _ in range(count):
        piece = plan.choose(rng, *categories, largest=(1.1, 1.1, plan.shell.height - 0.3))
        if piece is None:
            return
        for _ in range(16):
            reach = float(np.hypot(*piece.size[:2])) / 2 + 0.03
            half = np.array([plan.shell.width / 2, plan.shell.depth / 2]) - reach
            place = half * rng.choice([-1.0, 1.0], 2) * rng.uniform([0.0, 1.0], [1.0, 1.0])[rng.permutation(2)]
            place = np.where(rng.random(2) < 0.5, place, np.sign(place) * half)
            angle = float(np.arctan2(-place[0], place[1])) + rng.normal(0.0, 0.2)
            lit = "lamp" in piece.info.category
            if plan.add(rng, piece, pose_at(place, 0.0002, angle), lit=lit) is not None:
                break


def on_walls(rng: np.random.Generator, plan: Plan, *, shelves: int, pictures: int) -> None:
    """Hang shelves, pictures, sometimes a mirror or a clock, at eye level or above what stands there."""
    wanted = ["shelf"] * shelves + ["picture"] * pictures
    wanted += ["mirror"] * int(rng.random() < 0.35) + ["wall_clock"] * int(rng.random() < 0.2)
    for category in wanted:
        deep = 0.05 if category in ("mirror", "picture") else 0.3
        piece = plan.choose(rng, category, largest=(1.5, deep, 1.5))
        if piece is None:
            continue
        for _ in range(10):
            wall = plan.shell.walls[int(rng.integers(4))]
            tall = float(piece.size[2])
            middle = float(rng.uniform(1.35, 1.7)) if category != "shelf" else float(rng.uniform(1.25, 1.75))
            z = float(np.clip(middle - tall / 2, 0.5, plan.shell.height - tall - 0.15))
            if plan.against_wall(rng, piece, wall, z=z, tries=2) is not None:
                break


def seating(rng: np.random.Generator, plan: Plan) -> None:
    """A screen or fire at one wall, a sofa that faces it, a coffee table between them, armchairs beside."""
    for _ in range(4):
        for wall in plan.walls_by_room(rng):
            mark = plan.mark()
            if _seated(rng, plan, wall, along=float(rng.uniform(-0.2, 0.2)) * wall.length):
                return
            plan.back_to(mark)


def _seated(rng: np.random.Generator, plan: Plan, wall: Wall, *, along: float) -> bool:
    """Try to set up the seating group before a wall; tell whether there is a sofa or, without any, a table."""
    across = plan.shell.depth if abs(wall.inward[1]) > 0.5 else plan.shell.width
    media = _media(rng, plan, wall, along)
    depth = 0.0 if media is None else float(media.piece.size[1])
    sofa = plan.choose(rng, "sofa", largest=(min(2.4, wall.length - 1.2), 1.2, 1.3))
    table = plan.choose(rng, "coffee_table", "coffee", largest=(1.4, 0.9, 0.6))
    gap = float(rng.uniform(0.35, 0.5))
    long = 0.0 if table is None else float(table.size[1])
    deep = 0.9 if sofa is None else float(sofa.size[1])
    out = depth + float(rng.uniform(1.9, 2.8)) + deep / 2
    # What would leave no way behind the sofa goes to the wall.
    out = min(out, across - 0.75 - deep / 2) if across - 0.75 - deep > depth + 1.7 else across - 0.04 - deep / 2
    middle = out - deep / 2 - gap - long / 2
    placed = None
    if sofa is not None:
        placed = plan.add(rng, sofa, pose_at(wall.point(along, out), 0.0002, wall.angle + np.pi), role="support")
        if placed is None:
            return False
    carpet = _rug(rng, plan, wall, along, middle, table_size=(1.3, long), room=2 * gap + long - 0.1)
    if table is not None:
        base = 0.0 if carpet is None else carpet.high[2]
        names = () if carpet is None else (carpet.name,)
        turn = wall.angle + np.pi * int(rng.integers(2))
        pose = pose_at(wall.point(along, middle), base + 0.0002, turn)
        if plan.add(rng, table, pose, role="support", apart_from=names) is None:
            return False
    for side in rng.permutation([-1.0, 1.0])[: int(rng.integers(1, 3))]:
        _armchair(rng, plan, wall, along, middle, side=float(side))
    _beside_sofa(rng, plan, wall, along, out, sofa_wide=2.0 if sofa is None else float(sofa.size[0]))
    return True


def _armchair(rng: np.random.Generator, plan: Plan, wall: Wall, along: float, middle: float, *, side: float) -> None:
    """Stand an armchair beside the coffee table, turned towards it."""
    chair = plan.choose(rng, "armchair", largest=(1.1, 1.1, 1.2))
    if chair is None:
        return
    for reach in (1.15, 1.3, 1.5):
        place = wall.point(along + side * (reach + float(chair.size[1]) / 2), middle + float(rng.normal(0, 0.1)))
        angle = wall.angle + side * (0.25 - np.pi / 2) + float(rng.normal(0.0, 0.2))
        if plan.add(rng, chair, pose_at(place, 0.0002, angle), role="support") is not None:
            return


def _media(rng: np.random.Generator, plan: Plan, wall: Wall, along: float) -> Placed | None:
    """Stand a fireplace, or a low board for a television, at a wall."""
    fire = plan.choose(rng, "fireplace") if rng.random() < 0.2 else None
    if fire is not None:
        return plan.against_wall(rng, fire, wall, along=along, lit=True)
    board = plan.choose(rng, "sideboard", "bench", "chest", largest=(1.9, 0.6, 0.95))
    stand = None if board is None else plan.against_wall(rng, board, wall, along=along, role="support")
    screen = plan.choose(rng, "wall_tv")
    if stand is not None and rng.random() < 0.55:
        set_ = plan.choose(rng, "tv", largest=(float(stand.piece.size[0]), float(stand.piece.size[1]) + 0.1, 0.8))
        if set_ is not None and plan.on_top(rng, set_, stand, angle=wall.angle, lit=True) is not None:
            return stand
    if screen is not None and rng.random() < 0.7:
        base = 0.9 if stand is None else max(0.95, float(stand.high[2]) + 0.25)
        plan.against_wall(rng, screen, wall, along=along, z=base, lit=True)
    return stand


def _rug(
    rng: np.random.Generator,
    plan: Plan,
    wall: Wall,
    along: float,
    out: float,
    *,
    table_size: tuple[float, float],
    room: float,
) -> Placed | None:
    """Lay a rug that a table stands on wholly, and that leaves the sofa's feet on the floor."""
    for _ in range(4):
        piece = plan.choose(rng, "rug", largest=(2.8, room + 0.55, 0.1))
        if piece is None or rng.random() < 0.15:
            return None
        if piece.size[0] > table_size[0] and piece.size[1] > table_size[1] + 0.04:
            shift = max(0.0, float(piece.size[1]) - room) / 2
            done = plan.add(rng, piece, pose_at(wall.point(along, out - shift), 0.0, wall.angle), zones=False)
            if done is not None:
                return done
    return None


def _beside_sofa(
    rng: np.random.Generator, plan: Plan, wall: Wall, along: float, out: float, *, sofa_wide: float
) -> None:
    """Stand a small table with a lamp, or a floor lamp, beside the sofa."""
    side = float(rng.choice([-1.0, 1.0]))
    lamp = plan.choose(rng, "floorlamp", "floor_lamp") if rng.random() < 0.5 else None
    if lamp is not None:
        place = wall.point(along + side * (sofa_wide / 2 + 0.08 + float(lamp.size[0]) / 2), out + 0.1)
        plan.add(rng, lamp, pose_at(place, 0.0002, wall.angle), lit=True)
        side = -side
    small = plan.choose(rng, "nightstand", "table", "coffee_table", "bistro", largest=(0.62, 0.62, 0.75))
    if small is not None:
        place = wall.point(along + side * (sofa_wide / 2 + 0.06 + float(small.size[0]) / 2), out + 0.05)
        stand = plan.add(rng, small, pose_at(place, 0.0002, wall.angle + np.pi), role="support")
        if stand is not None:
            lamp_on(rng, plan, stand)


def lamp_on(rng: np.random.Generator, plan: Plan, stand: Placed) -> Placed | None:
    """Stand a lamp on the middle of a small piece of furniture with a flat top."""
    wide = float(min(stand.piece.size[:2]))
    lamp = plan.choose(rng, "tablelamp", "big_table_lamp", largest=(wide + 0.05, wide + 0.05, 0.75))
    return None if lamp is None else plan.on_top(rng, lamp, stand, angle=0.0, lit=True)
