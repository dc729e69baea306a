"""Rectangles that grounds, floors, walls, ceilings and skirting boards are made of."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float64
from multilight.scenes.poses import matrix4, pose_of
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Body, Material, Rectangle

Pair = tuple[float, float]


def plane(name: str, size: Pair, material: Material, pose: Float64) -> Body:
    """Make a rectangle of the surrounding, `size` [m] in its own x and y; its category is its name's first word."""
    return Body(
        name=name,
        role="surrounding",
        category=name.split("_")[0],
        geometry=Rectangle(width=size[0], height=size[1]),
        materials=(material,),
        world_from_body=matrix4(pose),
    )


def level_pose(rng: Rng) -> Float64:
    """Return the identity (4, 4), or a quarter of a rotation about +Z: boards and slabs run along either axis."""
    pose = np.eye(4)
    if rng.random() < 0.5:
        pose[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return pose


def downward_pose(x: float, y: float, height: float) -> Float64:
    """Return the pose (4, 4) of a ceiling: a rectangle centred at (x, y), at a height [m], that faces down."""
    return pose_of(np.diag([1.0, -1.0, -1.0]), (x, y, height))


def upright_pose(position: ArrayLike, inward: Pair | Float64) -> Float64:
    """Return the pose (4, 4) of an upright rectangle centred at `position` that faces along `inward`."""
    normal, up = np.array([*inward, 0.0]), np.array([0.0, 0.0, 1.0])
    return pose_of(np.stack([np.cross(up, normal), up, normal], axis=1), position)


def skirting(
    name: str, foot: Pair | Float64, inward: Pair | Float64, size: tuple[float, float, float], material: Material
) -> list[Body]:
    """Run a board along a wall: its face and its upper edge.

    It stands before the point `foot` (x, y) of the wall, which looks along `inward`, and is `size` (length, height,
    thickness) large, all in metres.
    """
    length, height, thickness = size
    (x, y), (across, ahead) = foot, inward
    face = upright_pose((x + across * thickness, y + ahead * thickness, height / 2), inward)
    edge = np.eye(4)
    edge[:3, 0], edge[:3, 1] = face[:3, 0], -face[:3, 2]
    edge[:3, 3] = [x + across * thickness / 2, y + ahead * thickness / 2, height]
    top = plane(f"{name}_top", (length, thickness), material, edge)
    return [plane(name, (length, height), material, face), top]
