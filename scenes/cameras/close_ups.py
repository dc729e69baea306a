"""Views from close by: the last cameras of a path move in on one object, which then fills much of the picture."""

from collections.abc import Callable

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.cameras.pinhole import camera_from_lens, focal_length_mm, half_angle, look_at
from multilight.scenes.poses import box_centre, direction_from
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Camera

MOVES_IN = 0.6
"""Probability that the last views of a scene move in."""
SPENT = 0.7
"""Part of the views that need not show everything which moving in takes up."""
FRAMED = (1.5, 2.4)
"""Radius that the picture's shorter side holds, against that of the object, at the end and at the beginning."""
CLEAR = 0.4
"""An object that is moved in on must show this fraction of its surface, most of its near side."""
TRIES = 10


def closer_views(rng: Rng, views: int, visible: float) -> int:
    """Draw how many of the last views move in, so that the fraction `visible` of all can still show everything."""
    wanted = rng.random() < MOVES_IN
    return round(SPENT * (1.0 - visible) * views) if wanted else 0


def move_in(
    rng: Rng, cameras: tuple[Camera, ...], points: Float64, count: int, is_good: Callable[[Camera], bool]
) -> tuple[Camera, ...]:
    """Replace the last `count` cameras by ones that look at an object, given by points (N, 3), from close by.

    Each keeps its lens and, as far as `is_good` allows, its side; where none does, and where that would be no
    closer, the camera stays as it is.
    """
    centre = box_centre(points)
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    result = list(cameras)
    for step, number in enumerate(range(len(cameras) - count, len(cameras))):
        framed = radius * FRAMED[1] * (FRAMED[0] / FRAMED[1]) ** ((step + 1) / count)
        for attempt in range(TRIES):
            camera = _near(rng, cameras[number], centre, framed, jitter=attempt / TRIES)
            if camera is None:
                break
            if is_good(camera):
                result[number] = camera
                break
    return tuple(result)


def _near(rng: Rng, camera: Camera, centre: Float64, framed: float, *, jitter: float) -> Camera | None:
    """Move one camera along its line of sight, more or less, until the picture holds `framed` [m]; None if it does."""
    size, focal = (camera.width, camera.height), focal_length_mm(camera)
    offset = camera.pose()[:3, 3] - centre
    distance = framed / np.sin(half_angle(focal, size))
    if distance > 0.85 * np.linalg.norm(offset):
        return None
    azimuth = np.arctan2(offset[1], offset[0]) + jitter * rng.normal(0.0, 0.6)
    elevation = np.arctan2(offset[2], np.hypot(offset[0], offset[1])) + jitter * rng.normal(0.0, 0.35)
    towards = direction_from(azimuth, np.clip(elevation, 0.15, 1.0))
    aim = centre + 0.12 * framed * rng.uniform(-1.0, 1.0, 3)
    pose = look_at(centre + distance * towards, aim, up=(0.01 * rng.normal(), 0.01 * rng.normal(), 1.0))
    return camera_from_lens(pose, width=size[0], height=size[1], focal_length_mm=focal)
