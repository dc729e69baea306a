"""Where lights point: the one frame of a spot that every renderer projects its gobo in."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float64

_STEEP = 1e-6
"""Where the horizontal part of a direction is shorter than this share of it, world up says nothing."""


def spot_frame(direction: ArrayLike, roll: float = 0.0) -> Float64:
    """Return the frame of a spot as a rotation (3, 3), world from light: columns right, up, back.

    The axes are a camera's: the light shines along -back (`direction`, any length but zero) and, seen from the
    light, right is right and up is up. Up is world +Z made perpendicular to the direction (world +Y for a spot that
    shines straight up or down), then turned by `roll` [rad] counter-clockwise as seen from the light. A gobo's
    image spans the square round the cone in this frame; see `gobo_coordinates`.
    """
    way = np.asarray(direction, np.float64)
    length = np.linalg.norm(way)
    if not length > 0.0:
        raise ValueError(f"direction {way.tolist()} has no length; give a vector that is not zero")
    back = -way / length
    up = np.array([0.0, 0.0, 1.0]) if np.hypot(back[0], back[1]) > _STEEP else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    turned_right = np.cos(roll) * right + np.sin(roll) * up
    return np.stack([turned_right, np.cross(back, turned_right), back], axis=1)


def gobo_coordinates(frame: Float64, half_angle: float, offsets: Float64) -> Float64:
    """Return where in a spot's gobo the rays to points lie: (..., 2) with (0, 0) bottom left, (1, 1) top right.

    `frame` is `spot_frame`'s; `offsets` (..., 3) run from the light to the points, in front of it; the cone's
    edge at `half_angle` [rad] touches the middle of the image's sides.
    """
    local = offsets @ frame
    return np.asarray(0.5 + 0.5 * local[..., :2] / (-local[..., 2:] * np.tan(half_angle)))
