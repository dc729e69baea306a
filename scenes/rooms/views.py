"""Cameras in a room: a walk from far to near, or single standpoints, that show what is inserted."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.cameras import camera_from_lens, look_at, pixel_rays
from scenes.rays import SceneRays
from scenes.spec import Camera
from scenes.trajectory import SEEN, TrajectoryError, in_frame

LENS_MM = (24.0, 50.0)
"""Focal lengths, full-frame equivalent."""
HEIGHTS = (0.85, 1.75)
"""Height of cameras over the floor [m]: a seated child's eye to a tall adult's."""
CLEARANCE = 0.15
"""Smallest distance [m] of a camera to the box of any body, and to walls."""
VISIBLE_SHARE = 0.7
"""Share of the views in which each inserted object is whole and visible."""
STANDPOINTS = 320
WALKS = 60
BLOCKED = 0.6
"""A picture is blocked where more than `BLOCKED_SHARE` of it shows things closer than this [m]."""
BLOCKED_SHARE = 0.12

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Room:
    """What cameras look at and keep clear of; world frame, metres.

    `watched` maps the index of each inserted body (as in `rays`) to points on its surface (N, 3); `low`, `high` (B, 3)
    are the boxes of all bodies; `half` (2,) and `height` say how large the room is.
    """

    watched: dict[int, Float64]
    rays: SceneRays
    low: Float64
    high: Float64
    half: Float64
    height: float

    @property
    def focus(self) -> Float64:
        """The middle of what is inserted, (3,)."""
        points = np.concatenate(list(self.watched.values()))
        return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)

    def is_free(self, eyes: Float64) -> NDArray[np.bool_]:
        """Tell for standpoints (N, 3) whether they keep clear of everything."""
        inside = (np.abs(eyes[:, :2]) < self.half - CLEARANCE).all(axis=1) & (eyes[:, 2] < self.height - CLEARANCE)
        in_box = (eyes[:, None] > self.low - CLEARANCE) & (eyes[:, None] < self.high + CLEARANCE)
        return np.asarray(inside & ~in_box.all(axis=-1).any(axis=1))

    def shares(self, eyes: Float64) -> Float64:
        """Return which share of each inserted object (M) is seen from each standpoint (N): (N, M)."""
        result = []
        for body, points in self.watched.items():
            origins = np.repeat(eyes, len(points), axis=0)
            hit, _ = self.rays.first_hit(origins, np.tile(points, (len(eyes), 1)) - origins)
            result.append((hit == body).reshape(len(eyes), -1).mean(axis=1))
        # An object hides half of itself: half of its points are all that can be seen.
        return np.stack(result, axis=1) * 2.0


def sample_views(rng: np.random.Generator, room: Room, *, width: int, height: int, views: int) -> tuple[Camera, ...]:
    """Draw cameras that stand free and show each inserted object, whole, in `VISIBLE_SHARE` of the views.

    Most scenes are a walk along a curve from far to near, the others single standpoints, far ones first. Raises
    `TrajectoryError` where the furniture hides too much.
    """
    low = np.array([*(-room.half), HEIGHTS[0]])
    eyes = rng.uniform(low, [*room.half, HEIGHTS[1]], (STANDPOINTS, 3))
    eyes = eyes[room.is_free(eyes)]
    if not len(eyes):
        raise TrajectoryError("no free standpoint in the room")
    good = eyes[(room.shares(eyes) >= SEEN).all(axis=1)]
    distance = np.linalg.norm(good - room.focus, axis=1)
    good = good[distance > 1.0][np.argsort(distance[distance > 1.0])]
    if len(good) < 8:
        raise TrajectoryError(f"only {len(good)} of {len(eyes)} standpoints see every inserted object")
    walks = rng.random() < 0.75
    for attempt in range(WALKS):
        if walks and attempt < WALKS * 2 // 3:
            path = _walk(rng, good, views)
        else:
            path = good[np.sort(rng.integers(len(good), size=views))[::-1]]
        if not room.is_free(path).all():
            continue
        cameras = _cameras(rng, room, path, (width, height))
        if _shows(room, cameras):
            return cameras
    raise TrajectoryError(f"none of {WALKS} walks shows every inserted object")


def _walk(rng: np.random.Generator, good: Float64, views: int) -> Float64:
    """Draw a curve (views, 3) from one of the farther standpoints to one of the nearer."""
    near = good[int(rng.integers(0, max(1, len(good) // 4)))]
    far = good[int(rng.integers(len(good) * 2 // 3, len(good)))]
    via = (near + far) / 2 + rng.normal(0.0, [0.35, 0.35, 0.1])
    t = np.linspace(0.0, 1.0, views)[:, None] if views > 1 else np.array([[0.8]])
    curve = (1 - t) ** 2 * far + 2 * t * (1 - t) * via + t**2 * near
    return np.asarray(curve + rng.normal(0.0, 0.01, curve.shape))


def _cameras(rng: np.random.Generator, room: Room, path: Float64, size: tuple[int, int]) -> tuple[Camera, ...]:
    """Point cameras at what is inserted: wide when far, so that the room shows, tighter when near."""
    points = np.concatenate(list(room.watched.values()))
    wide = rng.uniform(24.0, 32.0)
    full = rng.uniform(0.62, 0.85)
    reach = np.linalg.norm(path - room.focus, axis=1)
    cameras = []
    for eye, distance in zip(path, reach, strict=True):
        nearness = float(np.clip((reach.max() - distance) / max(np.ptp(reach), 0.3), 0.0, 1.0))
        towards = room.focus * [0.75, 0.75, 0.7] + [0.0, 0.0, 0.36]
        aim = (1 - nearness) * towards + nearness * room.focus + rng.normal(0.0, 0.02, 3) * distance
        way = (aim - eye) / np.linalg.norm(aim - eye)
        spread = points - eye
        cosine = spread @ way / np.linalg.norm(spread, axis=1)
        angle = min(float(np.arccos(np.clip(cosine, -1.0, 1.0)).max()), 1.3)
        tight = 18.0 * full / np.tan(angle) * min(size) / max(size)
        focal = float(np.clip(np.exp((1 - nearness) * np.log(wide) + nearness * np.log(tight)), *LENS_MM))
        focal = max(LENS_MM[0], min(focal, tight / full * 0.93))
        up = (0.01 * rng.normal(), 0.01 * rng.normal(), 1.0)
        cameras.append(camera_from_lens(look_at(eye, aim, up=up), width=size[0], height=size[1], focal_length_mm=focal))
    return tuple(cameras)


def _shows(room: Room, cameras: tuple[Camera, ...]) -> bool:
    """Tell whether each object is whole and visible in enough views, and no picture is blocked."""
    seen = room.shares(np.array([camera.pose()[:3, 3] for camera in cameras])) >= SEEN
    framed = np.array([[in_frame(camera, points) for points in room.watched.values()] for camera in cameras])
    if ((seen & framed).mean(axis=0) < VISIBLE_SHARE).any():
        return False
    return not any(_blocked(room, camera) for camera in cameras)


def _blocked(room: Room, camera: Camera) -> bool:
    """Tell whether something close fills too much of a picture."""
    small = camera.model_copy(
        update={
            "width": 12, "height": 12, "fx": camera.fx * 12 / camera.width, "fy": camera.fy * 12 / camera.height,
            "cx": 6.0, "cy": 6.0,
        }
    )  # fmt: skip
    origins, directions = pixel_rays(small)
    _, distance = room.rays.first_hit(origins.reshape(-1, 3), directions.reshape(-1, 3))
    return bool((distance < BLOCKED).mean() > BLOCKED_SHARE)
