"""What stands around the table: open ground, the corner of a room, or a photographer's seamless backdrop.

Everything is laid out in a frame whose origin lies on the floor below the table, with the cameras' side towards
-Y; walls stand behind (+Y) and beside the table.
"""

from typing import Literal

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.backdrops import STUDIO, SWEEP_ID
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials import painted_wall, pick_texture, textured
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Body, Material
from multilight.scenes.still_life.planes import level_pose, plane, skirting, upright_pose
from multilight.scenes.still_life.setting import make_body

SurroundingKind = Literal["ground", "corner", "backdrop"]
PROBABILITIES: dict[SurroundingKind, float] = {"ground": 0.2, "corner": 0.5, "backdrop": 0.3}
_FLOORS = {
    "ground": frozenset({"wood", "concrete", "stone"}),
    "corner": frozenset({"wood", "tile", "tiles", "concrete", "carpet", "parquet", "terrazzo", "fabric", "marble"}),
}
_FINISH = {"carpet": "fabric", "fabric": "fabric", "concrete": "stoneware", "brick": "stoneware"}
_WALLS = frozenset({"plaster", "brick", "concrete", "wallpaper"})
_PAPERS = ("f4f2ee", "d9d6d0", "a7a9ab", "58595b", "232325", "dcc9b0", "b9c7c3", "6f8a94", "c7a29a", "87917a", "e6cfa5")
_SKIRTINGS = ("f4f1ea", "f4f1ea", "e4ddd0", "6b4a32", "3a2b21", "8b8d8f")

# Measures of rooms and backdrops [m, rad], and how often they have what [probability].
GROUND, FLOOR = 60.0, 30.0  # sides: a ground's edge is far off, a floor ends behind walls
HEIGHT = (2.5, 3.2)  # of rooms, new and old
BEHIND, BEHIND_MORE = 0.03, 0.9  # from a table to the wall behind: a hand's breadth, and what may come to it
BESIDE, BESIDE_MORE = 0.05, 1.3  # the same to the nearer wall beside it: one walks there
OPPOSITE = (1.6, 3.0)  # to the other wall beside it, in a small room and a large one
SIDE_WALL = (3.5, 5.0)  # length of the walls beside: they end behind the most distant camera
BOARD = ((0.01, 0.02), (0.06, 0.13))  # thickness and height of skirting boards, as sold
THREE_WALLS, ONE_FINISH, TEXTURED_WALL = 0.4, 0.6, 0.45  # the rest: a corner; an accent wall; paint
BEFORE_TWO_WALLS, BEFORE_THREE, BEFORE_SWEEP = 1.1, 0.9, 0.75  # half the angle in which there is wall or paper behind
ASKEW, ASKEW_OF_THREE = (0.25, 0.6), 0.15  # the cameras' side, from straight before the table away from the near wall
SWEEP_SCALE, SWEEP_BEHIND = (0.9, 1.3), (0.9, 1.4)  # against the studio's own; its wall, beyond the bend
SWEEP_LIFT = 0.0003  # air below the paper, so that no two surfaces coincide


Surrounding = tuple[tuple[Body, ...], float, float]
"""Bodies around the table, and where cameras may stand: the azimuth of their front, and how far to its sides [rad]."""


def sample_surrounding(rng: Rng, library: AssetLibrary, *, kind: SurroundingKind, table: Float64) -> Surrounding:
    """Build a surrounding about a table whose lowest and highest corner are `table` (2, 3) [m]."""
    match kind:
        case "ground":
            return (_floor(rng, library, "ground", size=GROUND),), -np.pi / 2, np.pi
        case "corner":
            return _corner(rng, library, table)
        case "backdrop":
            return _backdrop(rng, library, table)


def _floor(rng: Rng, library: AssetLibrary, place: str, *, size: float) -> Body:
    """Make a square floor at z = 0 of a library texture (plain concrete grey where there is none)."""
    info = pick_texture(rng, library, _FLOORS[place], laid=True)
    material = Material(name="concrete", base_color=linear_from_hex("9a958c"), roughness=0.7)
    if info is not None:
        material = textured(rng, info, _FINISH.get(info.category, "floor"))
    return plane("floor", (size, size), material, level_pose(rng))


def _wall_material(rng: Rng, library: AssetLibrary) -> Material:
    """Draw paint or a wall texture."""
    info = pick_texture(rng, library, _WALLS, laid=True) if rng.random() < TEXTURED_WALL else None
    return painted_wall(rng) if info is None else textured(rng, info, "wall")


def _corner(rng: Rng, library: AssetLibrary, table: Float64) -> Surrounding:
    """Build a floor and two or three walls with skirting boards; the front, the top and maybe a side are open."""
    height = rng.uniform(*HEIGHT)
    back = float(table[1, 1]) + BEHIND + BEHIND_MORE * rng.beta(1.0, 2.0)
    side = float(rng.choice([-1.0, 1.0]))
    reach = float(np.abs(table[:, 0]).max())
    near = reach + BESIDE + BESIDE_MORE * rng.beta(1.3, 1.5)
    far = reach + rng.uniform(*OPPOSITE)
    deep = rng.uniform(*SIDE_WALL)
    three = rng.random() < THREE_WALLS
    wall, accent = _wall_material(rng, library), _wall_material(rng, library)
    stain = linear_from_hex(str(rng.choice(_SKIRTINGS)))
    board = Material(name="skirting", base_color=stain, roughness=float(rng.uniform(0.25, 0.5)))
    beside = wall if rng.random() < ONE_FINISH else accent
    bodies = [_floor(rng, library, "corner", size=FLOOR)]
    plan = [("back", (side * (near - far) / 2, back), (0.0, -1.0), near + far, wall)]
    plan.append(("near", (side * near, back - deep / 2), (-side, 0.0), deep, beside))
    if three:
        plan.append(("far", (-side * far, back - deep / 2), (side, 0.0), deep, beside))
    thickness, board_height = (rng.uniform(*span) for span in BOARD)
    for name, foot, inward, length, material in plan:
        bodies.append(plane(f"wall_{name}", (length, height), material, upright_pose((*foot, height / 2), inward)))
        bodies += skirting(f"skirting_{name}", foot, inward, (length, board_height, thickness), board)
    front = -np.pi / 2 - side * (ASKEW_OF_THREE if three else rng.uniform(*ASKEW))
    return tuple(bodies), float(front), BEFORE_THREE if three else BEFORE_TWO_WALLS


def _backdrop(rng: Rng, library: AssetLibrary, table: Float64) -> Surrounding:
    """Hang a seamless paper behind and below the table, on a studio floor."""
    colour = linear_from_hex(str(rng.choice(_PAPERS)))
    scale = float(rng.uniform(*SWEEP_SCALE))
    pose = np.eye(4) * scale
    behind = float(table[1, 1]) + scale * rng.uniform(*SWEEP_BEHIND)
    pose[:, 3] = [0.0, behind - scale * STUDIO.depth / 2, SWEEP_LIFT, 1.0]
    paper = Material(name="paper", base_color=colour, roughness=float(rng.uniform(0.75, 0.95)))
    info, mesh = library.info(SWEEP_ID), library.mesh(SWEEP_ID)
    sweep = make_body("backdrop", "surrounding", info, mesh, (paper,), pose)
    floor = Material(name="concrete", base_color=linear_from_hex("77736c"), roughness=float(rng.uniform(0.4, 0.8)))
    ground = plane("floor", (GROUND, GROUND), floor, np.eye(4))
    sweep = sweep.model_copy(update={"category": "backdrop"})
    return (ground, sweep), -np.pi / 2, BEFORE_SWEEP
