"""Groups of furniture round what one does: eat, cook, sleep, write, read."""

import numpy as np

from multilight.scenes.kinds.rooms.groups import TABLES, along_walls, keep_way, lamp_on
from multilight.scenes.kinds.rooms.plan import BACK, HUNG, Piece, Placed, Plan, pose_at
from multilight.scenes.kinds.rooms.shell import Wall

JOINT = 0.002
"""Distance [m] between kitchen units."""
WALL_UNITS = 1.45
"""Height [m] of the underside of wall units."""


def dining(rng: np.random.Generator, plan: Plan) -> None:
    """Stand a table where chairs fit round it, and hang a pendant over it; smaller tables where larger do not fit."""
    for longest in (1.9, 1.9, 1.5, 1.2, 1.0):
        table = plan.choose(rng, *TABLES, largest=(longest, 1.05, 0.82))
        if table is None:
            return
        for attempt in range(30):
            margin = 0.75 if attempt < 20 else 0.45
            placed = _stand_free(rng, plan, table, margin)
            if placed is not None:
                _chairs(rng, plan, placed, float(np.arctan2(placed.pose[1, 0], placed.pose[0, 0])))
                _pendant_over(rng, plan, placed)
                return


def _stand_free(rng: np.random.Generator, plan: Plan, table: Piece, margin: float) -> Placed | None:
    """Try to stand a table somewhere, `margin` [m] free all round."""
    angle = float(rng.choice([0.0, np.pi / 2]))
    reach = (table.size[:2] if angle == 0.0 else table.size[1::-1]) / 2 + margin
    half = np.array([plan.shell.width / 2, plan.shell.depth / 2])
    if (reach > half).any():
        return None
    place = rng.uniform(reach - half, half - reach) * 0.9
    if not plan.is_free(np.append(place - reach, 0.05), np.append(place + reach, 1.9), zones=False):
        return None
    return plan.add(rng, table, pose_at(place, 0.0002, angle), role="support")


def _chairs(rng: np.random.Generator, plan: Plan, table: Placed, angle: float) -> None:
    """Stand chairs of one kind round a table, tucked in as far as they go, some drawn out."""
    chair = plan.choose(rng, "chair", "stool", largest=(0.65, 0.7, 1.2))
    if chair is None:
        return
    width, depth = (float(v) for v in table.piece.size[:2])
    seats: list[tuple[float, float, float]] = []
    number = max(1, int(width / 0.62))
    for side in (-1.0, 1.0):
        seats += [((i + 0.5) / number * width - width / 2, side * depth / 2, side) for i in range(number)]
    places = [(np.array([x, y]), np.array([0.0, s]), 0.0 if s > 0 else np.pi) for x, y, s in seats]
    if width > 1.15 or width < 0.95:
        ends = [(np.array([s * width / 2, 0.0]), np.array([s, 0.0]), -s * np.pi / 2) for s in (-1.0, 1.0)]
        places += ends[: int(rng.integers(1, 3))]
    spin = table.pose[:2, :2]
    for edge, way, yaw in places:
        if rng.random() < 0.12:
            continue
        drawn = float(rng.exponential(0.06))
        for tuck in (0.26, 0.12, 0.0, -0.08):
            out = float(chair.size[1]) / 2 - tuck + drawn
            spot = spin @ (edge + way * out) + table.pose[:2, 3]
            pose = pose_at(spot, 0.0002, angle + yaw + float(rng.normal(0.0, 0.05)))
            low, high = plan.box(chair, pose)
            if plan.is_free(low, high, apart_from=(table.name,)) and plan.clear_of(chair, pose, table):
                plan.add(rng, chair, pose, apart_from=(table.name,))
                break


def _pendant_over(rng: np.random.Generator, plan: Plan, table: Placed) -> None:
    """Hang a pendant over the middle of a table, low enough to be over it and high enough to see across."""
    tall = plan.shell.height - float(table.high[2]) - 0.6
    piece = plan.choose(rng, "pendant", largest=(0.7, 0.7, tall))
    if piece is not None:
        place = (table.low[:2] + table.high[:2]) / 2
        plan.add(rng, piece, pose_at(place, plan.shell.height - HUNG - float(piece.size[2]), 0.0), lit=True)


def kitchen_row(rng: np.random.Generator, plan: Plan) -> None:
    """Line up units of one make along a wall: fridge or tall unit, base units, sink, cooker; wall units above."""
    family = str(rng.choice(["a", "b"]))
    for most in (4.2, 3.3, 2.5):
        for wall in plan.walls_by_room(rng):
            row = _draw_row(rng, plan, family, min(wall.length - 0.1, most))
            width = sum(float(piece.size[0]) + JOINT for piece in row)
            slack = wall.length / 2 - 0.03 - width / 2
            for start in (-slack, slack, 0.0):
                mark = plan.mark()
                placed = _line_up(rng, plan, wall, row, start - width / 2)
                if row and len(placed) == len(row):
                    for unit in placed:
                        keep_way(plan, unit, wall)
                    _above(rng, plan, wall, family, placed)
                    return
                plan.back_to(mark)


def _draw_row(rng: np.random.Generator, plan: Plan, family: str, room: float) -> list[Piece]:
    """Draw units that fit a wall: sink and cooker first, base units between, something tall at one end."""
    names = [f"sink_unit_{family}", "stove" if rng.random() < 0.7 else "washer"]
    names += [f"base_unit_{family}"] * 6
    tall = plan.choose(rng, "fridge", "fridge", *(["tall_unit_a"] if family == "a" else []))
    row: list[Piece] = []
    left = room - (0.0 if tall is None else float(tall.size[0]) + JOINT)
    for name in names:
        piece = plan.choose(rng, name)
        if piece is not None and float(piece.size[0]) + JOINT <= left:
            row.append(piece)
            left -= float(piece.size[0]) + JOINT
    row = [row[int(i)] for i in rng.permutation(len(row))]
    if tall is not None and row:
        row.insert(0 if rng.random() < 0.5 else len(row), tall)
    return row


def _line_up(rng: np.random.Generator, plan: Plan, wall: Wall, row: list[Piece], start: float) -> list[Placed]:
    """Stand units side by side from `start` along a wall; what is in the way leaves a gap."""
    placed: list[Placed] = []
    here = start
    for piece in row:
        wide = float(piece.size[0])
        out = float(piece.size[1]) / 2 + BACK
        pose = pose_at(wall.point(here + wide / 2, out), 0.0002, wall.angle)
        names = [p.name for p in placed]
        done = plan.add(rng, piece, pose, role="support", apart_from=names)
        placed += [] if done is None else [done]
        here += wide + JOINT
    return placed


def _above(rng: np.random.Generator, plan: Plan, wall: Wall, family: str, row: list[Placed]) -> None:
    """Hang a hood over the cooker and wall units over the base units, where neither window nor shelf is."""
    for unit in row:
        if unit.high[2] > 1.3:
            continue
        along = float((unit.pose[:2, 3] - wall.centre) @ wall.right)
        if unit.piece.info.category == "stove":
            hood = plan.choose(rng, "hood")
            if hood is not None:
                plan.against_wall(
                    rng, hood, wall, along=along, z=min(1.6, plan.shell.height - float(hood.size[2]) - 0.02)
                )
        elif rng.random() < 0.75:
            wide = float(unit.piece.size[0])
            piece = plan.choose(
                rng, f"wall_unit_{family}", largest=(wide + 0.004, 0.5, plan.shell.height - WALL_UNITS - 0.02)
            )
            if piece is not None:
                plan.against_wall(rng, piece, wall, along=along, z=WALL_UNITS)


def bed(rng: np.random.Generator, plan: Plan) -> None:
    """Stand a bed with its head at a wall, a nightstand with a lamp on each side, a rug at its foot."""
    for wall in plan.walls_by_room(rng):
        piece = plan.choose(rng, "bed", largest=(wall.length - 1.1, 2.4, 1.4))
        if piece is None:
            continue
        placed = plan.against_wall(rng, piece, wall, along=float(rng.uniform(-0.15, 0.15)) * wall.length)
        placed = placed or plan.against_wall(rng, piece, wall)
        if placed is None:
            continue
        along = float((placed.pose[:2, 3] - wall.centre) @ wall.right)
        stand = plan.choose(rng, "nightstand", largest=(0.65, 0.6, 0.8))
        for side in (-1.0, 1.0):
            if stand is None:
                break
            here = along + side * (float(piece.size[0] + stand.size[0]) / 2 + 0.04)
            done = plan.against_wall(rng, stand, wall, along=here, role="support")
            if done is not None and rng.random() < 0.85:
                lamp_on(rng, plan, done)
        rug = plan.choose(rng, "rug", largest=(2.2, 1.5, 0.1))
        if rug is not None and rng.random() < 0.7:
            out = float(piece.size[1]) + 0.1 + float(rug.size[1]) / 2
            plan.add(rng, rug, pose_at(wall.point(along, out), 0.0, wall.angle), zones=False)
        return


def desk(rng: np.random.Generator, plan: Plan, *, share: float) -> None:
    """Stand a desk at a wall, under a window as well, and a chair at it."""
    if rng.random() >= share:
        return
    piece = plan.choose(rng, "desk", *TABLES[-2:], largest=(1.8, 0.95, 0.8))
    chair = plan.choose(rng, "office_chair", "office_chair", "chair", largest=(0.7, 0.7, 1.2))
    if piece is None:
        return
    for i in rng.permutation(4):
        wall = plan.shell.walls[int(i)]
        placed = plan.against_wall(rng, piece, wall, role="support", tries=6)
        if placed is None:
            continue
        if chair is not None:
            along = float((placed.pose[:2, 3] - wall.centre) @ wall.right) + float(rng.uniform(-0.15, 0.15))
            for tuck in (0.2, 0.08, -0.03):
                out = BACK + float(piece.size[1] + chair.size[1] / 2) - tuck + 0.05
                pose = pose_at(wall.point(along, out), 0.0002, wall.angle + np.pi + float(rng.normal(0.0, 0.3)))
                low, high = plan.box(chair, pose)
                if plan.is_free(low, high, apart_from=(placed.name,)) and plan.clear_of(chair, pose, placed):
                    plan.add(rng, chair, pose, apart_from=(placed.name,))
                    break
        return


def reading_corner(rng: np.random.Generator, plan: Plan) -> None:
    """Stand an armchair in a corner, a lamp behind it and a small table beside it."""
    chair = plan.choose(rng, "armchair", largest=(1.1, 1.1, 1.2))
    if chair is None:
        along_walls(rng, plan, "chair", share=1.0)
        return
    half = np.array([plan.shell.width / 2, plan.shell.depth / 2])
    for i in rng.permutation(4):
        sign = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)][int(i)])
        place = sign * (half - float(np.hypot(*chair.size[:2])) / 2 - 0.35)
        angle = float(np.arctan2(-place[0], place[1])) + float(rng.normal(0.0, 0.1))
        placed = plan.add(rng, chair, pose_at(place, 0.0002, angle), role="support")
        if placed is None:
            continue
        lamp = plan.choose(rng, "floorlamp", "floor_lamp")
        if lamp is not None:
            out = np.array([half[0] - lamp.size[0] / 2 - 0.03, half[1] - lamp.size[1] / 2 - 0.03])
            plan.add(rng, lamp, pose_at(sign * out, 0.0002, 0.0), lit=True)
        small = plan.choose(rng, "nightstand", "table", "bistro", largest=(0.6, 0.6, 0.7))
        if small is not None:
            for step in (np.array([-sign[0], 0.0]), np.array([0.0, -sign[1]])):
                spot = place + step * (float(np.hypot(*chair.size[:2])) / 2 + float(small.size[0]) / 2 + 0.02)
                if plan.add(rng, small, pose_at(spot, 0.0002, 0.0), role="support") is not None:
                    break
        return
