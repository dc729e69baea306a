"""What stands around the table: open ground, the corner of a room, or a photographer's seamless backdrop.

Everything is laid out in a frame whose origin lies on the floor below the table, with the cameras' side towards
-Y; walls stand behind (+Y) and beside the table.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.builtin.backdrops import STUDIO, SWEEP_ID
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import matrix4
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials import painted_wall, pick_texture, textured
from multilight.scenes.spec import Body, Material, MeshAsset, Rectangle

SurroundingKind = Literal["ground", "corner", "backdrop"]
KINDS: tuple[SurroundingKind, ...] = ("ground", "corner", "backdrop")
SHARES = (0.2, 0.5, 0.3)

_FLOORS = {
    "ground": frozenset({"wood", "concrete", "stone"}),
    "corner": frozenset({"wood", "tile", "tiles", "concrete", "carpet", "parquet", "terrazzo", "fabric", "marble"}),
}
_WALLS = frozenset({"plaster", "brick", "concrete", "wallpaper"})
_PAPERS = ("f4f2ee", "d9d6d0", "a7a9ab", "58595b", "232325", "dcc9b0", "b9c7c3", "6f8a94", "c7a29a", "87917a", "e6cfa5")


@dataclass(frozen=True)
class Surrounding:
    """Bodies around the table, and where cameras may stand: within `opening` [rad] of azimuth `front` [rad]."""

    kind: SurroundingKind
    bodies: tuple[Body, ...]
    front: float
    opening: float


def sample_surrounding(
    rng: np.random.Generator, library: AssetLibrary, *, kind: SurroundingKind, table: Float64
) -> Surrounding:
    """Build a surrounding about a table whose lowest and highest corner are `table` (2, 3) [m]."""
    match kind:
        case "ground":
            floor = _floor(rng, library, "ground", size=60.0)
            return Surrounding(kind, (floor,), front=-np.pi / 2, opening=np.pi)
        case "corner":
            return _corner(rng, library, table)
        case "backdrop":
            return _backdrop(rng, library, table)


def upright(position: tuple[float, float, float], inward: tuple[float, float]) -> Float64:
    """Return the pose (4, 4) of an upright rectangle centred at `position` that faces along `inward`."""
    normal = np.array([*inward, 0.0])
    pose = np.eye(4)
    pose[:3, 0] = np.cross([0.0, 0.0, 1.0], normal)
    pose[:3, 1] = [0.0, 0.0, 1.0]
    pose[:3, 2] = normal
    pose[:3, 3] = position
    return pose


def plane(name: str, size: tuple[float, float], material: Material, pose: Float64) -> Body:
    """Make a rectangular body of the surrounding."""
    return Body(
        name=name,
        role="surrounding",
        category=name.split("_")[0],
        geometry=Rectangle(width=size[0], height=size[1]),
        materials=(material,),
        world_from_body=matrix4(pose),
    )


def _floor(rng: np.random.Generator, library: AssetLibrary, place: str, *, size: float) -> Body:
    """Make a square floor at z = 0 of a library texture (plain concrete grey where there is none)."""
    info = pick_texture(rng, library, _FLOORS[place], laid=True)
    if info is None:
        material = Material(name="concrete", base_color=linear_from_hex("9a958c"), roughness=0.7)
    else:
        finish = {"carpet": "fabric", "fabric": "fabric", "concrete": "stoneware", "brick": "stoneware"}
        material = textured(rng, info, finish.get(info.category, "floor"))
    pose = np.eye(4)
    if rng.random() < 0.5:
        pose[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return plane("floor", (size, size), material, pose)


def _wall_material(rng: np.random.Generator, library: AssetLibrary) -> Material:
    """Draw paint (most walls) or a wall texture."""
    info = pick_texture(rng, library, _WALLS, laid=True) if rng.random() < 0.45 else None
    return painted_wall(rng) if info is None else textured(rng, info, "wall")


def _corner(rng: np.random.Generator, library: AssetLibrary, table: Float64) -> Surrounding:
    """Build a floor and two or three walls with skirting boards; the front, the top and maybe a side are open."""
    height = rng.uniform(2.5, 3.2)
    back = float(table[1, 1]) + 0.03 + 0.9 * rng.beta(1.0, 2.0)
    side = float(rng.choice([-1.0, 1.0]))
    reach = float(np.abs(table[:, 0]).max())
    near = reach + 0.05 + 1.3 * rng.beta(1.3, 1.5)
    far = reach + rng.uniform(1.6, 3.0)
    deep = rng.uniform(3.5, 5.0)
    three = rng.random() < 0.4
    wall, accent = _wall_material(rng, library), _wall_material(rng, library)
    board = _skirting_material(rng)
    beside = wall if rng.random() < 0.6 else accent
    bodies = [_floor(rng, library, "corner", size=30.0)]
    width = near + far
    plan = [("back", (side * (near - far) / 2, back), (0.0, -1.0), width, wall)]
    plan.append(("near", (side * near, back - deep / 2), (-side, 0.0), deep, beside))
    if three:
        plan.append(("far", (-side * far, back - deep / 2), (side, 0.0), deep, beside))
    thickness, board_height = rng.uniform(0.01, 0.02), rng.uniform(0.06, 0.13)
    for name, (x, y), inward, length, material in plan:
        bodies.append(plane(f"wall_{name}", (length, height), material, upright((x, y, height / 2), inward)))
        face = (x + inward[0] * thickness, y + inward[1] * thickness)
        pose = upright((*face, board_height / 2), inward)
        bodies.append(plane(f"skirting_{name}", (length, board_height), board, pose))
        ledge = np.eye(4)
        ledge[:3, 0], ledge[:3, 1] = pose[:3, 0], -pose[:3, 2]
        ledge[:3, 3] = [x + inward[0] * thickness / 2, y + inward[1] * thickness / 2, board_height]
        bodies.append(plane(f"skirting_{name}_top", (length, thickness), board, ledge))
    front = -np.pi / 2 - side * (0.15 if three else rng.uniform(0.25, 0.6))
    return Surrounding("corner", tuple(bodies), front=float(front), opening=0.9 if three else 1.1)


def _skirting_material(rng: np.random.Generator) -> Material:
    """Draw the paint or stain of skirting boards."""
    colour = linear_from_hex(str(rng.choice(["f4f1ea", "f4f1ea", "e4ddd0", "6b4a32", "3a2b21", "8b8d8f"])))
    return Material(name="skirting", base_color=colour, roughness=float(rng.uniform(0.25, 0.5)))


def _backdrop(rng: np.random.Generator, library: AssetLibrary, table: Float64) -> Surrounding:
    """Hang a seamless paper behind and below the table, on a studio floor."""
    paper = linear_from_hex(str(rng.choice(_PAPERS)))
    scale = float(rng.uniform(0.9, 1.3))
    pose = np.eye(4) * scale
    behind = float(table[1, 1]) + scale * rng.uniform(0.9, 1.4)
    pose[:, 3] = [0.0, behind - scale * STUDIO.depth / 2, 0.0003, 1.0]
    mesh = library.mesh(SWEEP_ID)
    sweep = Body(
        name="backdrop",
        role="surrounding",
        category="backdrop",
        geometry=MeshAsset(asset=SWEEP_ID, mesh_sha256=mesh.sha256(), parts=len(mesh.parts)),
        materials=(Material(name="paper", base_color=paper, roughness=float(rng.uniform(0.75, 0.95))),),
        world_from_body=matrix4(pose),
    )
    floor = Material(name="concrete", base_color=linear_from_hex("77736c"), roughness=float(rng.uniform(0.4, 0.8)))
    ground = plane("floor", (60.0, 60.0), floor, np.eye(4))
    return Surrounding("backdrop", (ground, sweep), front=-np.pi / 2, opening=0.75)
