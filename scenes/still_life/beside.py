"""Large pieces beside and behind a still life that stands on the floor: furniture, planters."""

import numpy as np
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.still_life.placement import Arrangement, PlacementError, Stage, Standing

GAP = 0.05
"""Smallest distance [m] between the convex hulls of a piece and of anything else."""
SWING = 1.4
"""How far [rad] from straight behind the still life a piece may stand, seen from its middle."""
_TRIES = 24


def put_beside(
    rng: np.random.Generator, pieces: tuple[Standing, ...], group: Arrangement, stage: Stage
) -> list[Float64]:
    """Put each piece behind or beside the group, as near as it goes or a little further; add it to the group.

    Returns `world_from_body` (4, 4) of each. Raises `PlacementError` where one finds no place.
    """
    poses = []
    footprints = np.concatenate(group.footprints)
    middle = (footprints.min(axis=0) + footprints.max(axis=0)) / 2
    back = float(np.arctan2(-stage.front[1], -stage.front[0]))
    for number, piece in enumerate(pieces):
        probe = CollisionManager()
        probe.add_object("probe", piece.hull)
        spot = _spot(rng, piece, probe, group, stage, middle=middle, back=back)
        group.solids.add_object(f"beside {number}", piece.hull, spot)
        lift = np.eye(4)
        lift[:3, :3], lift[2, 3] = piece.turn, piece.lift
        poses.append(spot @ lift)
    return poses


def _spot(
    rng: np.random.Generator,
    piece: Standing,
    probe: CollisionManager,
    group: Arrangement,
    stage: Stage,
    *,
    middle: Float64,
    back: float,
) -> Float64:
    """Draw directions, and in each go outwards until the piece stands free."""
    for _ in range(_TRIES):
        azimuth = back + rng.uniform(-SWING, SWING)
        way = np.array([np.cos(azimuth), np.sin(azimuth)])
        # Most face the still life, as if somebody had just put the things down there.
        yaw = azimuth - np.pi / 2 + rng.normal(0.0, 0.7)
        spare = rng.exponential(0.12)
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        pose[2, 3] = stage.height
        for distance in np.arange(0.15, 2.0, 0.05):
            pose[:2, 3] = middle + (distance + spare) * way
            probe.set_transform("probe", pose)
            if group.solids.min_distance_other(probe) >= GAP:
                if stage.supports(piece.footprint @ pose[:2, :2].T + pose[:2, 3]):
                    return pose
                break
    raise PlacementError(f"no free place for {piece.info.id} beside the still life")
