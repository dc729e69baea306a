"""The shell of a room: floor, ceiling, walls with openings, skirting, windows and doors.

The room's frame: origin on the floor at its centre, +Z up, metres; it reaches from -width/2 to width/2 in x and
from -depth/2 to depth/2 in y. Walls, floor and ceiling overshoot each other, so that no light leaks in at edges.
"""

from dataclasses import dataclass, field

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.joinery import CASING, DOOR_PROUD, EAR, LINING, SILL, WINDOW_PROUD
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.kinds.rooms.finish import Palette
from multilight.scenes.materials import painted_wall, pick_texture, sample_material, textured
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Body, Material
from multilight.scenes.still_life.planes import downward_pose, level_pose, plane, skirting, upright_pose

OVERSHOOT = 0.3
"""How far [m] walls, floor and ceiling run on behind each other."""
DOOR_ZONE = 0.95
"""What is kept free before a door [m]."""
SKIRTING = (0.12, 0.017)
"""Greatest height and thickness [m] of skirting boards, the latter with a hair's breadth to spare."""
# Measures of buildings [m], and how often they have what [probability].
HEIGHTS, HEADS = (2.5, 3.0), (2.12, 2.28)  # of rooms, new and old; of the tops of windows
TWO_SIDED, PAIRED, CORNER_DOOR = 0.4, 0.6, 0.75  # windows in a second wall; two in one wall; a door next to a corner
BETWEEN = (0.25, 0.5)  # two windows, as a fraction of what they leave of the wall
ACCENT = 0.5  # one wall differs
_FLOORS = ("wood", "wood", "wood", "tiles", "stone", "concrete", "fabric")
_KITCHEN_FLOORS = ("tiles", "tiles", "stone", "wood", "concrete")
_FINISH = {"fabric": "fabric", "concrete": "rough stone", "stone": "stone", "tiles": "stone"}


@dataclass(frozen=True)
class Wall:
    """One wall: its midpoint on the floor (2,) [m], the unit vector into the room (2,), and its length [m]."""

    name: str
    centre: Float64
    inward: Float64
    length: float

    @property
    def right(self) -> Float64:
        """The direction along the wall that is to the right as seen from inside, (2,)."""
        return np.array([-self.inward[1], self.inward[0]])

    @property
    def angle(self) -> float:
        """The yaw [rad] of an asset with its back (+Y) to the wall."""
        return float(np.arctan2(self.inward[0], -self.inward[1]))

    def point(self, along: float, out: float) -> Float64:
        """Return the place (2,) `along` the wall from its midpoint and `out` into the room [m]."""
        return self.centre + along * self.right + out * self.inward

    def along(self, place: Float64) -> float:
        """Return how far along the wall a place (x, y) lies from its midpoint [m]."""
        return float((place - self.centre) @ self.right)


@dataclass(frozen=True)
class Opening:
    """A window or door in a wall: the hole's midpoint along the wall, its width and heights [m], and what fills it."""

    wall: Wall
    along: float
    width: float
    bottom: float
    top: float
    info: AssetInfo
    proud: float

    @property
    def is_door(self) -> bool:
        """Whether it reaches the floor and people go through."""
        return self.info.category == "door"


@dataclass
class Shell:
    """A room without furniture."""

    width: float
    depth: float
    height: float
    walls: tuple[Wall, ...]
    openings: list[Opening] = field(default_factory=list)

    def free(self, wall: Wall) -> bool:
        """Tell whether a wall has neither window nor door."""
        return all(opening.wall is not wall for opening in self.openings)


def sample_shell(rng: Rng, library: AssetLibrary, *, span: tuple[tuple[float, float], tuple[float, float]]) -> Shell:
    """Draw a room's size, its windows on one or two walls and its door on another.

    `span` gives the least and greatest length of the longer and of the shorter side [m].
    """
    sides = [float(rng.uniform(*span[0])), float(rng.uniform(*span[1]))]
    width, depth = sides if rng.random() < 0.5 else sides[::-1]
    walls = (
        Wall("south", np.array([0.0, -depth / 2]), np.array([0.0, 1.0]), width),
        Wall("east", np.array([width / 2, 0.0]), np.array([-1.0, 0.0]), depth),
        Wall("north", np.array([0.0, depth / 2]), np.array([0.0, -1.0]), width),
        Wall("west", np.array([-width / 2, 0.0]), np.array([1.0, 0.0]), depth),
    )
    shell = Shell(width, depth, float(rng.uniform(*HEIGHTS)), walls)
    order = [walls[int(i)] for i in rng.permutation(4)]
    _windows(rng, library, shell, order[0])
    if rng.random() < TWO_SIDED:
        _windows(rng, library, shell, order[1])
    doors = [info for info in library.list("surrounding") if info.category == "door"]
    info = pick(rng, doors)
    width = _size(info)[0] - 2 * CASING + LINING
    slack = order[2].length / 2 - width / 2 - CASING - 0.06
    side = float(rng.choice([-1.0, 1.0]))
    along = side * slack * (1.0 if rng.random() < CORNER_DOOR else float(rng.uniform(0.0, 1.0)))
    top = _size(info)[2] - CASING + LINING / 2
    shell.openings.append(Opening(order[2], along, width, 0.0, top, info, DOOR_PROUD))
    return shell


def _size(info: AssetInfo) -> tuple[float, float, float]:
    """Return an asset's size [m]."""
    assert info.size is not None
    return info.size


def _windows(rng: Rng, library: AssetLibrary, shell: Shell, wall: Wall) -> None:
    """Cut one window, or two alike, into a wall."""
    windows = [info for info in library.list("surrounding") if info.category == "window"]
    info = pick(rng, [info for info in windows if _size(info)[0] < wall.length - 0.5])
    outer, _, tall = _size(info)
    top = float(rng.uniform(*HEADS))
    bottom = top - (tall - SILL - CASING) - LINING
    width = outer - 2 * EAR + LINING
    if 2 * outer + 1.0 < wall.length and rng.random() < PAIRED:
        gap = float(rng.uniform(*BETWEEN)) * (wall.length - 2 * outer)
        places = [-(outer + gap) / 2, (outer + gap) / 2]
    else:
        slack = (wall.length - outer) / 2 - 0.15
        places = [float(rng.uniform(-0.5, 0.5)) * slack]
    for along in places:
        shell.openings.append(Opening(wall, along, width, bottom, top, info, WINDOW_PROUD))


def shell_bodies(rng: Rng, library: AssetLibrary, shell: Shell, palette: Palette, kind: str) -> list[Body]:
    """Build floor, ceiling, walls and skirting; windows and doors are placed as pieces."""
    x, y, over = shell.width, shell.depth, 2 * OVERSHOOT
    size = (x + over, y + over)
    flat = level_pose(rng)
    white = sample_material(rng, "wall", colour=(0.8, 0.8, 0.78), name="ceiling_paint")
    # Rotated by a quarter, the floor's own x runs along the room's y.
    bodies = [plane("floor", size if flat[0, 0] else size[::-1], _floor(rng, library, kind), flat)]
    bodies.append(plane("ceiling", size, white, downward_pose(0.0, 0.0, shell.height)))
    paint = painted_wall(rng)
    accent = _accent(rng, library) if rng.random() < ACCENT else paint
    plain = [wall for wall in shell.walls if shell.free(wall)]
    papered = pick(rng, plain) if plain else None
    board = (float(rng.uniform(0.5, 1.0)) * SKIRTING[0], float(rng.uniform(0.6, 0.95)) * SKIRTING[1])
    for wall in shell.walls:
        bodies += _wall(shell, wall, accent if wall is papered else paint)
        bodies += _skirting(shell, wall, palette.joinery, board)
    return bodies


def _floor(rng: Rng, library: AssetLibrary, kind: str) -> Material:
    """Draw a floor: boards and parquet mostly, tiles in kitchens, carpet sometimes."""
    wanted = pick(rng, _KITCHEN_FLOORS if kind == "kitchen" else _FLOORS)
    info = pick_texture(rng, library, frozenset({wanted}), laid=True)
    if info is None:
        return sample_material(rng, "wood", name="floor")
    return textured(rng, info, _FINISH.get(wanted, "floor"))


def _accent(rng: Rng, library: AssetLibrary) -> Material:
    """Draw the finish of the one wall that differs: brick, plaster, or another paint."""
    info = pick_texture(rng, library, frozenset({"brick", "plaster", "concrete"}), laid=True)
    return painted_wall(rng) if info is None or rng.random() < 0.5 else textured(rng, info, "wall")


def _wall(shell: Shell, wall: Wall, material: Material) -> list[Body]:
    """Fill a wall with rectangles round its openings."""
    low, high = -OVERSHOOT, shell.height + OVERSHOOT
    end = wall.length / 2 + OVERSHOOT
    panels: list[tuple[float, float, float, float]] = []
    here = -end
    for opening in sorted((o for o in shell.openings if o.wall is wall), key=lambda o: o.along):
        left, right = opening.along - opening.width / 2, opening.along + opening.width / 2
        panels += [(here, left, low, high), (left, right, opening.top, high)]
        if not opening.is_door:
            panels.append((left, right, low, opening.bottom))
        here = right
    panels.append((here, end, low, high))
    bodies = []
    for number, (left, right, bottom, top) in enumerate(panels):
        pose = upright_pose((*wall.point((left + right) / 2, 0.0), (bottom + top) / 2), wall.inward)
        bodies.append(plane(f"wall_{wall.name}_{number}", (right - left, top - bottom), material, pose))
    return bodies


def _skirting(shell: Shell, wall: Wall, material: Material, board: tuple[float, float]) -> list[Body]:
    """Run a board of height and thickness [m] along a wall, but not across doors and tall windows."""
    high, thick = board
    cuts = [
        (o.along - o.width / 2 - CASING, o.along + o.width / 2 + CASING)
        for o in shell.openings
        if o.wall is wall and o.bottom < high
    ]
    bodies = []
    here = -wall.length / 2
    for number, (left, right) in enumerate([*sorted(cuts), (wall.length / 2, np.inf)]):
        if left - here > 0.02:
            size, foot = (left - here, high, thick), wall.point((here + left) / 2, 0.0)
            bodies += skirting(f"skirting_{wall.name}_{number}", foot, wall.inward, size, material)
        here = right
    return bodies
