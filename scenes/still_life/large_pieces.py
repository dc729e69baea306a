"""Large pieces beside and behind a still life that stands on the floor: furniture, planters."""

import numpy as np
from trimesh.collision import CollisionManager

from multilight.scenes.arrays import Float64
from multilight.scenes.poses import box_centre, pose_at
from multilight.scenes.random_streams import Rng
from multilight.scenes.still_life.placement import Arrangement, PlacementError, Stage, Standing

# How large pieces stand [m, rad].
GAP = 0.05  # smallest distance between the convex hulls of a piece and of anything else
SWING = 1.4  # from straight behind the still life, seen from its centre
FACING = 0.7  # deviation of a piece's front from the still life: as if somebody had just put the things down there
DISTANCES, SPARE = np.arange(0.15, 2.0, 0.05), 0.12  # from the centre, outwards; further off than it must, on average
TRIES = 24


def place_large_pieces(rng: Rng, pieces: tuple[Standing, ...], group: Arrangement, stage: Stage) -> list[Float64]:
    """Put each piece behind or beside the group, as near as it goes or a little further; add it to the group.

    Returns `world_from_body` (4, 4) of each. Raises `PlacementError` where one finds no place.
    """
    poses = []
    footprints = np.concatenate(group.footprints)
    centre = box_centre(footprints)
    back = float(np.arctan2(-stage.front[1], -stage.front[0]))
    for number, piece in enumerate(pieces):
        probe = CollisionManager()
        probe.add_object("probe", piece.hull)
        spot = _spot(rng, piece, probe, group, stage, centre=centre, back=back)
        group.solids.add_object(f"large piece {number}", piece.hull, spot)
        poses.append(spot @ piece.standing_from_body)
    return poses


def _spot(
    rng: Rng,
    piece: Standing,
    probe: CollisionManager,
    group: Arrangement,
    stage: Stage,
    *,
    centre: Float64,
    back: float,
) -> Float64:
    """Draw directions, and in each go outwards until the piece stands free."""
    for _ in range(TRIES):
        azimuth = back + rng.uniform(-SWING, SWING)
        outwards = np.array([np.cos(azimuth), np.sin(azimuth)])
        yaw = azimuth - np.pi / 2 + rng.normal(0.0, FACING)
        spare = rng.exponential(SPARE)
        for distance in DISTANCES:
            pose = pose_at(centre + (distance + spare) * outwards, stage.height, yaw)
            probe.set_transform("probe", pose)
            if group.solids.min_distance_other(probe) >= GAP:
                if stage.supports(piece.footprint @ pose[:2, :2].T + pose[:2, 3]):
                    return pose
                break
    raise PlacementError(f"no free place for {piece.info.id} beside the still life")
