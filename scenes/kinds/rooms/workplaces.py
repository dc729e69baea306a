"""Groups of furniture round what one does: eat, cook, sleep, write, read."""

from collections.abc import Iterator

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.kinds.rooms.groups import PENDANT, TABLES, along_walls, keep_walkway, lamp_on
from multilight.scenes.kinds.rooms.plan import BACK, LIFT, Piece, PlacedPiece, Plan
from multilight.scenes.kinds.rooms.shell import Wall
from multilight.scenes.poses import pose_at

# Measures of homes [m], and how often they have what [probability].
JOINT = 0.002  # between kitchen units
ROWS = (4.2, 3.3, 2.5)  # longest rows of kitchen units that are tried
WALL_UNITS, HOOD = 1.45, 1.6  # their undersides: worktops are 0.9 m high, and cookers need more air
LOW = 1.3  # units higher than this have nothing above them
STOVE, WALL_UNIT = 0.7, 0.75  # a cooker rather than a washing machine; a wall unit over a base unit
DINING_TABLES = (1.9, 1.9, 1.5, 1.2, 1.0)  # longest sides that are tried, one after the other
DINING_SPACE = (0.75,) * 20 + (0.45,) * 10  # free floor round a table, by try: room to draw out chairs, then to pass
SEAT = 0.62  # a table's edge that a diner takes
NO_HEADS = (0.95, 1.15)  # lengths of tables whose legs are in the way of seats at their ends
EMPTY_SEAT, DRAWN_OUT = 0.12, 0.06  # a seat without a chair; mean distance by which chairs are drawn out
TUCKED, TUCKED_AT_DESK = (0.26, 0.12, 0.0, -0.08), (0.2, 0.08, -0.03)  # how far chairs stand under an edge, by try
SEE_ACROSS = 0.6  # what a pendant leaves free over a table
BEDSIDE_LAMP, BED_RUG = 0.85, 0.7  # a lamp on a nightstand; a rug at the bed's foot
CORNERS = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))  # signs of x and y


def dining(plan: Plan) -> None:
    """Stand a table where chairs fit round it, and hang a pendant over it; smaller tables where larger do not fit."""
    for longest in DINING_TABLES:
        table = plan.choose(*TABLES, largest=(longest, 1.05, 0.82))
        if table is None:
            return
        for space in DINING_SPACE:
            placed = _stand_free(plan, table, space)
            if placed is not None:
                _chairs(plan, placed)
                _pendant_over(plan, placed)
                return


def _stand_free(plan: Plan, table: Piece, margin: float) -> PlacedPiece | None:
    """Try to stand a table somewhere, `margin` [m] free all round."""
    angle = float(plan.rng.choice([0.0, np.pi / 2]))
    reach = (table.size[:2] if angle == 0.0 else table.size[1::-1]) / 2 + margin
    half = np.array([plan.shell.width / 2, plan.shell.depth / 2])
    if (reach > half).any():
        return None
    place = plan.rng.uniform(reach - half, half - reach) * 0.9
    if not plan.is_free(np.append(place - reach, 0.05), np.append(place + reach, 1.9), zones=False):
        return None
    return plan.stand(table, place, angle, role="support")


def _chairs(plan: Plan, table: PlacedPiece) -> None:
    """Stand chairs of one kind round a table, tucked in as far as they go, some drawn out."""
    chair = plan.choose("chair", "stool", largest=(0.65, 0.7, 1.2))
    if chair is None:
        return
    width, depth = (float(v) for v in table.piece.size[:2])
    number = max(1, int(width / SEAT))
    along = [(i + 0.5) / number * width - width / 2 for i in range(number)]
    # Where a seat's edge is, the direction out of it, and the yaw of a chair that looks at the table.
    seats = [((x, s * depth / 2), (0.0, s), 0.0 if s > 0 else np.pi) for s in (-1.0, 1.0) for x in along]
    if not NO_HEADS[0] <= width <= NO_HEADS[1]:
        ends = [((s * width / 2, 0.0), (s, 0.0), -s * np.pi / 2) for s in (-1.0, 1.0)]
        seats += ends[: int(plan.rng.integers(1, 3))]
    for edge, outwards, yaw in seats:
        if plan.rng.random() >= EMPTY_SEAT:
            plan.tuck(chair, table, _seated(plan, chair, table, np.array(edge), np.array(outwards), yaw))


def _seated(
    plan: Plan, chair: Piece, table: PlacedPiece, edge: Float64, outwards: Float64, yaw: float
) -> Iterator[Float64]:
    """Draw poses of a chair at a table's edge, the first furthest under it; `edge`, `outwards` in the table's frame."""
    angle = float(np.arctan2(table.pose[1, 0], table.pose[0, 0]))
    drawn = float(plan.rng.exponential(DRAWN_OUT))
    for tuck in TUCKED:
        out = float(chair.size[1]) / 2 - tuck + drawn
        place = table.pose[:2, :2] @ (edge + outwards * out) + table.pose[:2, 3]
        yield pose_at(place, LIFT, angle + yaw + float(plan.rng.normal(0.0, 0.05)))


def _pendant_over(plan: Plan, table: PlacedPiece) -> None:
    """Hang a pendant over the centre of a table, low enough to be over it and high enough to see across."""
    tall = plan.shell.height - float(table.high[2]) - SEE_ACROSS
    piece = plan.choose("pendant", largest=(*PENDANT, tall))
    if piece is not None:
        plan.hang(piece, (table.low[:2] + table.high[:2]) / 2)


def kitchen_row(plan: Plan) -> None:
    """Line up units of one make along a wall: fridge or tall unit, base units, sink, cooker; wall units above."""
    family = str(plan.rng.choice(["a", "b"]))
    for most in ROWS:
        for wall in plan.walls_by_room():
            row = _draw_row(plan, family, min(wall.length - 0.1, most))
            width = sum(float(piece.size[0]) + JOINT for piece in row)
            slack = wall.length / 2 - 0.03 - width / 2
            for start in (-slack, slack, 0.0):
                mark = plan.mark()
                placed = _line_up(plan, wall, row, start - width / 2)
                if row and len(placed) == len(row):
                    for unit in placed:
                        keep_walkway(plan, unit, wall)
                    _above(plan, wall, family, placed)
                    return
                plan.back_to(mark)


def _draw_row(plan: Plan, family: str, room: float) -> list[Piece]:
    """Draw units that fit a wall: sink and cooker first, base units between, something tall at one end."""
    names = [f"sink_unit_{family}", "stove" if plan.rng.random() < STOVE else "washer"]
    names += [f"base_unit_{family}"] * 6
    tall = plan.choose("fridge", "fridge", *(["tall_unit_a"] if family == "a" else []))
    row: list[Piece] = []
    left = room - (0.0 if tall is None else float(tall.size[0]) + JOINT)
    for name in names:
        piece = plan.choose(name)
        if piece is not None and float(piece.size[0]) + JOINT <= left:
            row.append(piece)
            left -= float(piece.size[0]) + JOINT
    row = [row[int(i)] for i in plan.rng.permutation(len(row))]
    if tall is not None and row:
        row.insert(0 if plan.rng.random() < 0.5 else len(row), tall)
    return row


def _line_up(plan: Plan, wall: Wall, row: list[Piece], start: float) -> list[PlacedPiece]:
    """Stand units side by side from `start` along a wall; where one is not free there is a gap."""
    placed: list[PlacedPiece] = []
    here = start
    for piece in row:
        wide = float(piece.size[0])
        place = wall.point(here + wide / 2, float(piece.size[1]) / 2 + BACK)
        names = [p.name for p in placed]
        done = plan.stand(piece, place, wall.angle, role="support", apart_from=names)
        placed += [] if done is None else [done]
        here += wide + JOINT
    return placed


def _above(plan: Plan, wall: Wall, family: str, row: list[PlacedPiece]) -> None:
    """Hang a hood over the cooker and wall units over the base units, where neither window nor shelf is."""
    for unit in row:
        if unit.high[2] > LOW:
            continue
        if unit.piece.info.category == "stove":
            piece = plan.choose("hood")
            z = HOOD if piece is None else min(HOOD, plan.shell.height - float(piece.size[2]) - 0.02)
        elif plan.rng.random() < WALL_UNIT:
            largest = (float(unit.piece.size[0]) + 0.004, 0.5, plan.shell.height - WALL_UNITS - 0.02)
            piece, z = plan.choose(f"wall_unit_{family}", largest=largest), WALL_UNITS
        else:
            continue
        if piece is not None:
            plan.against_wall(piece, wall, along=wall.along(unit.pose[:2, 3]), z=z)


def bed(plan: Plan) -> None:
    """Stand a bed with its head at a wall, a nightstand with a lamp on each side, a rug at its foot."""
    for wall in plan.walls_by_room():
        piece = plan.choose("bed", largest=(wall.length - 1.1, 2.4, 1.4))
        if piece is None:
            continue
        placed = plan.against_wall(piece, wall, along=float(plan.rng.uniform(-0.15, 0.15)) * wall.length)
        placed = placed or plan.against_wall(piece, wall)
        if placed is None:
            continue
        along = wall.along(placed.pose[:2, 3])
        _nightstands(plan, wall, along, float(piece.size[0]))
        rug = plan.choose("rug", largest=(2.2, 1.5, 0.1))
        if rug is not None and plan.rng.random() < BED_RUG:
            out = float(piece.size[1]) + 0.1 + float(rug.size[1]) / 2
            plan.add(rug, pose_at(wall.point(along, out), 0.0, wall.angle), zones=False)
        return


def _nightstands(plan: Plan, wall: Wall, along: float, bed_wide: float) -> None:
    """Stand two alike at the sides of a bed, most with a lamp."""
    stand = plan.choose("nightstand", largest=(0.65, 0.6, 0.8))
    if stand is None:
        return
    for side in (-1.0, 1.0):
        here = along + side * ((bed_wide + float(stand.size[0])) / 2 + 0.04)
        done = plan.against_wall(stand, wall, along=here, role="support")
        if done is not None and plan.rng.random() < BEDSIDE_LAMP:
            lamp_on(plan, done)


def desk(plan: Plan, *, probability: float) -> None:
    """Stand a desk at a wall, under a window as well, and a chair at it."""
    if plan.rng.random() >= probability:
        return
    piece = plan.choose("desk", *TABLES[-2:], largest=(1.8, 0.95, 0.8))
    chair = plan.choose("office_chair", "office_chair", "chair", largest=(0.7, 0.7, 1.2))
    if piece is None:
        return
    for i in plan.rng.permutation(4):
        wall = plan.shell.walls[int(i)]
        placed = plan.against_wall(piece, wall, role="support", tries=6)
        if placed is not None:
            if chair is not None:
                plan.tuck(chair, placed, _at_desk(plan, chair, placed, wall))
            return


def _at_desk(plan: Plan, chair: Piece, desk: PlacedPiece, wall: Wall) -> Iterator[Float64]:
    """Draw poses of a chair at a desk, the first furthest under it."""
    along = wall.along(desk.pose[:2, 3]) + float(plan.rng.uniform(-0.15, 0.15))
    for tuck in TUCKED_AT_DESK:
        out = BACK + float(desk.piece.size[1] + chair.size[1] / 2) - tuck + 0.05
        yield pose_at(wall.point(along, out), LIFT, wall.angle + np.pi + float(plan.rng.normal(0.0, 0.3)))


def reading_corner(plan: Plan) -> None:
    """Stand an armchair in a corner, a lamp behind it and a small table beside it."""
    chair = plan.choose("armchair", largest=(1.1, 1.1, 1.2))
    if chair is None:
        along_walls(plan, "chair", probability=1.0)
        return
    half = np.array([plan.shell.width / 2, plan.shell.depth / 2])
    reach = float(np.hypot(*chair.size[:2])) / 2
    for i in plan.rng.permutation(4):
        sign = np.array(CORNERS[int(i)])
        place = sign * (half - reach - 0.35)
        angle = float(np.arctan2(-place[0], place[1])) + float(plan.rng.normal(0.0, 0.1))
        if plan.stand(chair, place, angle, role="support") is None:
            continue
        lamp = plan.choose("floorlamp", "floor_lamp")
        if lamp is not None:
            plan.stand(lamp, sign * (half - lamp.size[:2] / 2 - 0.03), 0.0, lit=True)
        small = plan.choose("nightstand", "table", "bistro", largest=(0.6, 0.6, 0.7))
        if small is not None:
            for step in (np.array([-sign[0], 0.0]), np.array([0.0, -sign[1]])):
                spot = place + step * (reach + float(small.size[0]) / 2 + 0.02)
                if plan.stand(small, spot, 0.0, role="support") is not None:
                    break
        return
