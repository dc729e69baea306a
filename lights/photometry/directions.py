"""Where lights point: the one frame of a spot that every renderer projects its gobo in."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float64

_STEEP = 1e-6
"""Where the horizontal part of a direction is shorter than this fraction of it, world up says nothing."""


def spot_frame(direction: ArrayLike, roll: float = 0.0) -> Float64:
    """Return the frame of a spot as a rotation (3, 3), world from light: columns right, up, back.

    The axes are a camera's: the light shines along -back (`direction`, any length but zero) and, seen from the
    light, right is right and up is up. Up is world +Z made perpendicular to the direction (world +Y for a spot that
    shines straight up or down), then rotated by `roll` [rad] counter-clockwise as seen from the light. A gobo's
    image spans the square round the cone in this frame: from -tan(half_angle) to tan(half_angle) in x / -z and y / -z.
    """
    towards = np.asarray(direction, np.float64)
    length = np.linalg.norm(towards)
    if not length > 0.0:
        raise ValueError(f"direction {towards.tolist()} has no length; give a vector that is not zero")
    back = -towards / length
    up = np.array([0.0, 0.0, 1.0]) if np.hypot(back[0], back[1]) > _STEEP else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    rolled_right = np.cos(roll) * right + np.sin(roll) * up
    return np.stack([rolled_right, np.cross(back, rolled_right), back], axis=1)
