"""Groups of furniture that belong together, and single pieces along walls, in corners, on walls and under ceilings."""

import numpy as np

from multilight.scenes.assets.builtin.furnishings import CURTAIN_HEIGHT
from multilight.scenes.assets.builtin.joinery import LINING, SILL
from multilight.scenes.kinds.rooms.plan import HUNG, PlacedPiece, Plan
from multilight.scenes.kinds.rooms.shell import Wall
from multilight.scenes.poses import pose_at

TABLES = ("table", "round", "rectangular", "trestle", "bistro")
"""Categories of tables to dine at."""
# Measures of homes [m], and how often they have what [probability].
WALKWAY = 0.6  # free floor before furniture with doors and drawers
PENDANT, UNDER_LAMP = (0.7, 0.7), 2.0  # its width and depth at most; the height that one walks under
EYE_LEVEL, SHELF_LEVEL = (1.35, 1.7), (1.25, 1.75)  # centres of pictures and the like; wall shelves
MIRROR, CLOCK = 0.35, 0.2  # one on a wall
SIT_APART = (1.9, 2.8)  # from a screen or a fire to a sofa, from which one watches it
AT_TABLE = (0.35, 0.5)  # from a sofa to the coffee table: knees fit, arms reach
BEHIND_SOFA = 0.75  # in which one can walk; where there is less, the sofa stands at the wall
ARMCHAIR_ASIDE = (1.15, 1.3, 1.5)  # from the coffee table's centre, by try
FIRE, TV, WALL_TV = 0.2, 0.55, 0.7  # a fireplace instead of a screen; a screen on a board; one on the wall if not
NO_RUG = 0.15  # under a coffee table


def place_openings(plan: Plan) -> None:
    """Put windows and doors into their holes."""
    for opening in plan.shell.openings:
        piece = plan.piece(opening.info)
        if piece is None:
            continue
        out = float(piece.low[1]) + opening.proud
        z = 0.0 if opening.is_door else opening.bottom + LINING / 2 - SILL
        pose = pose_at(opening.wall.point(opening.along, out), z, opening.wall.angle)
        materials = tuple(
            plan.palette.joinery if part.material.name in ("joinery", "leaf") else part.material
            for part in piece.mesh.parts
        )
        plan.put(piece, pose, materials, role="surrounding")


def curtains(plan: Plan, *, probability: float) -> None:
    """Hang curtains before windows where there is room; all alike, or none."""
    if plan.rng.random() >= probability or plan.shell.height < CURTAIN_HEIGHT + 0.02:
        return
    chosen = int(plan.rng.integers(2))
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
            plan.add(piece, pose, apart_from=own, boards=False)


def ceiling_light(plan: Plan) -> None:
    """Hang a lamp at the centre of the ceiling: a pendant where it hangs high enough or over a table."""
    if any(placed.piece.info.category == "pendant" for placed in plan.placed.values()):
        return
    tall = plan.shell.height - UNDER_LAMP
    piece = plan.choose("pendant", largest=(*PENDANT, tall)) if plan.rng.random() < 0.5 else None
    piece = piece or plan.choose("ceilinglamp", "ceiling_lamp")
    if piece is not None:
        plan.hang(piece, plan.rng.uniform(-0.3, 0.3, 2))


def along_walls(plan: Plan, *categories: str, probability: float) -> PlacedPiece | None:
    """Stand one piece with its back to some wall, a free walkway before it, in some of the rooms."""
    if plan.rng.random() >= probability:
        return None
    for _ in range(3):
        piece = plan.choose(*categories, largest=(2.6, 0.8, plan.shell.height - 0.1))
        if piece is None:
            return None
        for wall in plan.walls_by_room():
            done = plan.against_wall(piece, wall)
            if done is not None:
                keep_walkway(plan, done, wall)
                return done
    return None


def keep_walkway(plan: Plan, placed: PlacedPiece, wall: Wall) -> None:
    """Keep a walkway free before a piece at a wall."""
    step = wall.inward * WALKWAY
    low = np.where(wall.inward > 0, placed.high[:2], placed.low[:2]) + np.minimum(step, 0.0)
    high = np.where(wall.inward < 0, placed.low[:2], placed.high[:2]) + np.maximum(step, 0.0)
    plan.keep_free(np.append(low, 0.05), np.append(high, 1.8))


def in_corners(plan: Plan, *categories: str, count: int) -> None:
    """Stand pieces near corners, their front towards the centre of the room."""
    rng = plan.rng
    for _ in range(count):
        piece = plan.choose(*categories, largest=(1.1, 1.1, plan.shell.height - 0.3))
        if piece is None:
            return
        for _ in range(16):
            reach = float(np.hypot(*piece.size[:2])) / 2 + 0.03
            half = np.array([plan.shell.width / 2, plan.shell.depth / 2]) - reach
            place = half * rng.choice([-1.0, 1.0], 2) * rng.uniform([0.0, 1.0], [1.0, 1.0])[rng.permutation(2)]
            place = np.where(rng.random(2) < 0.5, place, np.sign(place) * half)
            angle = float(np.arctan2(-place[0], place[1])) + rng.normal(0.0, 0.2)
            lit = "lamp" in piece.info.category
            if plan.stand(piece, place, angle, lit=lit) is not None:
                break


def on_walls(plan: Plan, *, shelves: int, pictures: int) -> None:
    """Hang shelves, pictures, sometimes a mirror or a clock, at eye level or above what stands there."""
    wanted = ["shelf"] * shelves + ["picture"] * pictures
    wanted += ["mirror"] * int(plan.rng.random() < MIRROR) + ["wall_clock"] * int(plan.rng.random() < CLOCK)
    for category in wanted:
        deep = 0.05 if category in ("mirror", "picture") else 0.3
        piece = plan.choose(category, largest=(1.5, deep, 1.5))
        if piece is None:
            continue
        for _ in range(10):
            wall = plan.shell.walls[int(plan.rng.integers(4))]
            tall = float(piece.size[2])
            centre = float(plan.rng.uniform(*(SHELF_LEVEL if category == "shelf" else EYE_LEVEL)))
            z = float(np.clip(centre - tall / 2, 0.5, plan.shell.height - tall - 0.15))
            if plan.against_wall(piece, wall, z=z, tries=2) is not None:
                break


def seating(plan: Plan) -> None:
    """A screen or fire at one wall, a sofa that faces it, a coffee table between them, armchairs beside."""
    for _ in range(4):
        for wall in plan.walls_by_room():
            mark = plan.mark()
            if _seated(plan, wall, along=float(plan.rng.uniform(-0.2, 0.2)) * wall.length):
                return
            plan.back_to(mark)


def _seated(plan: Plan, wall: Wall, *, along: float) -> bool:
    """Try to set up the seating group before a wall; tell whether there is a sofa or, without any, a table."""
    media = _media(plan, wall, along)
    sofa = plan.choose("sofa", largest=(min(2.4, wall.length - 1.2), 1.2, 1.3))
    table = plan.choose("coffee_table", "coffee", largest=(1.4, 0.9, 0.6))
    gap = float(plan.rng.uniform(*AT_TABLE))
    long = 0.0 if table is None else float(table.size[1])
    deep = 0.9 if sofa is None else float(sofa.size[1])
    out = _sofa_out(plan, wall, media, deep)
    centre = out - deep / 2 - gap - long / 2
    if sofa is not None:
        angle = wall.angle + np.pi
        if plan.stand(sofa, wall.point(along, out), angle, role="support") is None:
            return False
    carpet = _rug(plan, wall, along, centre, long=long, room=2 * gap + long - 0.1)
    if table is not None:
        base = 0.0 if carpet is None else float(carpet.high[2])
        names = () if carpet is None else (carpet.name,)
        angle = wall.angle + np.pi * int(plan.rng.integers(2))
        place = wall.point(along, centre)
        if plan.stand(table, place, angle, base=base, role="support", apart_from=names) is None:
            return False
    for side in plan.rng.permutation([-1.0, 1.0])[: int(plan.rng.integers(1, 3))]:
        _armchair(plan, wall, along, centre, side=float(side))
    _beside_sofa(plan, wall, along, out, sofa_wide=2.0 if sofa is None else float(sofa.size[0]))
    return True


def _sofa_out(plan: Plan, wall: Wall, media: PlacedPiece | None, deep: float) -> float:
    """Draw how far from a wall [m] a sofa's centre stands that looks at it and is so `deep` [m]."""
    across = plan.shell.depth if abs(wall.inward[1]) > 0.5 else plan.shell.width
    depth = 0.0 if media is None else float(media.piece.size[1])
    out = depth + float(plan.rng.uniform(*SIT_APART)) + deep / 2
    if across - BEHIND_SOFA - deep > depth + 1.7:
        return min(out, across - BEHIND_SOFA - deep / 2)
    return across - 0.04 - deep / 2


def _armchair(plan: Plan, wall: Wall, along: float, out: float, *, side: float) -> None:
    """Stand an armchair beside the coffee table, its front towards it."""
    chair = plan.choose("armchair", largest=(1.1, 1.1, 1.2))
    if chair is None:
        return
    for reach in ARMCHAIR_ASIDE:
        place = wall.point(along + side * (reach + float(chair.size[1]) / 2), out + float(plan.rng.normal(0, 0.1)))
        angle = wall.angle + side * (0.25 - np.pi / 2) + float(plan.rng.normal(0.0, 0.2))
        if plan.stand(chair, place, angle, role="support") is not None:
            return


def _media(plan: Plan, wall: Wall, along: float) -> PlacedPiece | None:
    """Stand a fireplace, or a low board for a television, at a wall."""
    fire = plan.choose("fireplace") if plan.rng.random() < FIRE else None
    if fire is not None:
        return plan.against_wall(fire, wall, along=along, lit=True)
    board = plan.choose("sideboard", "bench", "chest", largest=(1.9, 0.6, 0.95))
    stand = None if board is None else plan.against_wall(board, wall, along=along, role="support")
    screen = plan.choose("wall_tv")
    if stand is not None and plan.rng.random() < TV:
        set_ = plan.choose("tv", largest=(float(stand.piece.size[0]), float(stand.piece.size[1]) + 0.1, 0.8))
        if set_ is not None and plan.on_top(set_, stand, angle=wall.angle, lit=True) is not None:
            return stand
    if screen is not None and plan.rng.random() < WALL_TV:
        base = 0.9 if stand is None else max(0.95, float(stand.high[2]) + 0.25)
        plan.against_wall(screen, wall, along=along, z=base, lit=True)
    return stand


def _rug(plan: Plan, wall: Wall, along: float, out: float, *, long: float, room: float) -> PlacedPiece | None:
    """Lay a rug that a table so `long` [m] stands on wholly, and that leaves the sofa's feet on the floor."""
    for _ in range(4):
        piece = plan.choose("rug", largest=(2.8, room + 0.55, 0.1))
        if piece is None or plan.rng.random() < NO_RUG:
            return None
        if piece.size[0] > 1.3 and piece.size[1] > long + 0.04:
            shift = max(0.0, float(piece.size[1]) - room) / 2
            done = plan.add(piece, pose_at(wall.point(along, out - shift), 0.0, wall.angle), zones=False)
            if done is not None:
                return done
    return None


def _beside_sofa(plan: Plan, wall: Wall, along: float, out: float, *, sofa_wide: float) -> None:
    """Stand a small table with a lamp, or a floor lamp, beside the sofa."""
    side = float(plan.rng.choice([-1.0, 1.0]))
    lamp = plan.choose("floorlamp", "floor_lamp") if plan.rng.random() < 0.5 else None
    if lamp is not None:
        place = wall.point(along + side * (sofa_wide / 2 + 0.08 + float(lamp.size[0]) / 2), out + 0.1)
        plan.stand(lamp, place, wall.angle, lit=True)
        side = -side
    small = plan.choose("nightstand", "table", "coffee_table", "bistro", largest=(0.62, 0.62, 0.75))
    if small is not None:
        place = wall.point(along + side * (sofa_wide / 2 + 0.06 + float(small.size[0]) / 2), out + 0.05)
        stand = plan.stand(small, place, wall.angle + np.pi, role="support")
        if stand is not None:
            lamp_on(plan, stand)


def lamp_on(plan: Plan, stand: PlacedPiece) -> PlacedPiece | None:
    """Stand a lamp on the centre of a small piece of furniture with a flat top."""
    wide = float(min(stand.piece.size[:2]))
    lamp = plan.choose("tablelamp", "big_table_lamp", largest=(wide + 0.05, wide + 0.05, 0.75))
    return None if lamp is None else plan.on_top(lamp, stand, angle=0.0, lit=True)
