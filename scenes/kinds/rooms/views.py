"""Cameras in a room that show what is inserted: on a walk, an arc, in a hand, or at single standpoints."""

from dataclasses import dataclass

import numpy as np

from multilight.scenes.arrays import Float64, Mask
from multilight.scenes.cameras.close_ups import CLEAR, closer_views, move_in
from multilight.scenes.cameras.paths import DEFAULT_CAMERAS, CameraSettings, TrajectoryKind
from multilight.scenes.cameras.pinhole import SENSOR_MM, camera_from_lens, look_at, pixel_rays
from multilight.scenes.cameras.trajectory import CLOSER, SEEN, TrajectoryError, focused, in_frame
from multilight.scenes.geometry.rays import SceneRays
from multilight.scenes.poses import box_centre
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Camera

# Measures [m], and fractions of a picture.
HEIGHTS, LOWEST = (0.85, 1.75), 0.3  # of cameras: a seated child's eye to a tall adult's; when moved in on an object
CLEARANCE = 0.15  # of a camera to the box of any body, and to walls
NEAREST = 1.0  # of a standpoint to what is inserted
STANDPOINTS, LEAST_GOOD = 320, 8  # drawn; those that are free and see everything, for a path
WALKS = 60  # paths that are tried, the last third of them standpoints anywhere
ARC = (25.0, 110.0)  # degrees, round what is inserted
TOWARDS_ROOM = (0.75, 0.75, 0.7), 0.36  # a wide view looks at the focus times these, raised: nearer to the midline
BLOCKED, BLOCKED_FRACTION = 0.6, 0.12  # no more than this of a picture may show things closer than that


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
        """The centre of what is inserted, (3,)."""
        return box_centre(np.concatenate(list(self.watched.values())))

    def is_free(self, eyes: Float64) -> Mask:
        """Tell for standpoints (N, 3) whether they keep clear of everything."""
        inside = (np.abs(eyes[:, :2]) < self.half - CLEARANCE).all(axis=1) & (eyes[:, 2] < self.height - CLEARANCE)
        in_box = (eyes[:, None] > self.low - CLEARANCE) & (eyes[:, None] < self.high + CLEARANCE)
        return np.asarray(inside & ~in_box.all(axis=-1).any(axis=1))

    def visible_fractions(self, eyes: Float64) -> Float64:
        """Return which fraction of each inserted object (M) is seen from each standpoint (N): (N, M)."""
        result = []
        for body, points in self.watched.items():
            origins = np.repeat(eyes, len(points), axis=0)
            hit, _ = self.rays.first_hit(origins, np.tile(points, (len(eyes), 1)) - origins)
            result.append((hit == body).reshape(len(eyes), -1).mean(axis=1))
        # An object hides half of itself: half of its points are all that can be seen.
        return np.stack(result, axis=1) * 2.0


def sample_views(
    rng: Rng,
    room: Room,
    *,
    size: tuple[int, int],
    views: int,
    kind: TrajectoryKind,
    settings: CameraSettings = DEFAULT_CAMERAS,
) -> tuple[Camera, ...]:
    """Draw cameras that stand free and show each inserted object, whole, in `settings.min_visible_share` of the views.

    They approach on a walk, go round what is inserted, stay in one place, or stand anywhere, far places first; where
    the furniture allows none of the first two, they stand anywhere. Raises `TrajectoryError` where it hides too much.
    """
    low = np.array([*(-room.half), HEIGHTS[0]])
    eyes = rng.uniform(low, [*room.half, HEIGHTS[1]], (STANDPOINTS, 3))
    eyes = eyes[room.is_free(eyes)]
    if not len(eyes):
        raise TrajectoryError("no free standpoint in the room")
    good = eyes[(room.visible_fractions(eyes) >= SEEN).all(axis=1)]
    distance = np.linalg.norm(good - room.focus, axis=1)
    good = good[distance > NEAREST][np.argsort(distance[distance > NEAREST])]
    if len(good) < LEAST_GOOD:
        raise TrajectoryError(f"only {len(good)} of {len(eyes)} standpoints see every inserted object")
    for attempt in range(WALKS):
        eyes, tightness = _path(rng, room, good, views, kind if attempt < WALKS * 2 // 3 else "random")
        if not room.is_free(eyes).all():
            continue
        cameras = _cameras(rng, room, eyes, tightness, size, settings)
        if _shows(room, cameras, settings.min_visible_share):
            if kind in CLOSER:
                cameras = _moved_in(rng, room, cameras, settings.min_visible_share)
            return focused(rng, cameras, room.watched, settings)
    raise TrajectoryError(f"none of {WALKS} {kind} paths shows every inserted object")


def _path(rng: Rng, room: Room, good: Float64, views: int, kind: TrajectoryKind) -> tuple[Float64, Float64]:
    """Draw a path of a kind over the good standpoints, which are sorted from near to far.

    Returns where cameras stand (views, 3), and for each how tightly it frames what is inserted: 0 not at all, 1 fully.
    """
    match kind:
        case "approach":
            eyes = _walk(rng, good, views)
        case "orbit":
            return _arc(rng, room, good, views), np.full(views, rng.uniform(0.4, 1.0))
        case "handheld":
            spot = good[int(rng.integers(max(1, len(good) * 2 // 3)))]
            return spot + 0.04 * _wobble(rng, views), np.full(views, rng.uniform(0.5, 1.0))
        case "random":
            eyes = good[np.sort(rng.integers(len(good), size=views))[::-1]]
    reach = np.linalg.norm(eyes - room.focus, axis=1)
    return eyes, np.clip((reach.max() - reach) / max(np.ptp(reach), 0.3), 0.0, 1.0)


def _walk(rng: Rng, good: Float64, views: int) -> Float64:
    """Draw a curve (views, 3) from one of the farther standpoints to one of the nearer."""
    near = good[int(rng.integers(0, max(1, len(good) // 4)))]
    far = good[int(rng.integers(len(good) * 2 // 3, len(good)))]
    via = (near + far) / 2 + rng.normal(0.0, [0.35, 0.35, 0.1])
    t = np.linspace(0.0, 1.0, views)[:, None] if views > 1 else np.array([[0.8]])
    curve = (1 - t) ** 2 * far + 2 * t * (1 - t) * via + t**2 * near
    return np.asarray(curve + rng.normal(0.0, 0.01, curve.shape))


def _arc(rng: Rng, room: Room, good: Float64, views: int) -> Float64:
    """Draw an arc (views, 3) round what is inserted, through one of the standpoints."""
    through = good[int(rng.integers(len(good)))] - room.focus
    sweep = np.radians(rng.uniform(*ARC)) * rng.choice([-1.0, 1.0])
    angle = np.arctan2(through[1], through[0]) + sweep * (np.linspace(0.0, 1.0, views) - rng.random())
    reach = np.hypot(through[0], through[1])
    height = through[2] + 0.08 * np.sin(np.linspace(0.0, np.pi, views) + rng.uniform(0.0, 2 * np.pi))
    return np.asarray(room.focus + np.stack([reach * np.cos(angle), reach * np.sin(angle), height], axis=-1))


def _wobble(rng: Rng, views: int) -> Float64:
    """Return the slow unrest of a hand, (views, 3), of about unit size: two sine waves an axis."""
    t = np.linspace(0.0, 1.0, views)[:, None]
    waves = [np.sin(2 * np.pi * (rng.uniform(*c, 3) * t + rng.random(3))) for c in ((0.3, 0.9), (0.9, 2.2))]
    return np.asarray(waves[0] + 0.5 * waves[1])


def _cameras(
    rng: Rng, room: Room, eyes: Float64, tightness: Float64, size: tuple[int, int], settings: CameraSettings
) -> tuple[Camera, ...]:
    """Point cameras at what is inserted: wide where a path is loose, so that the room shows, else tighter."""
    points = np.concatenate(list(room.watched.values()))
    shortest, longest = settings.lens_mm
    wide = float(rng.uniform(shortest, min(1.33 * shortest, longest)))
    full = rng.uniform(0.7, 0.9)
    unrest = rng.normal(0.0, 1.0, eyes.shape) if np.ptp(tightness) else _wobble(rng, len(eyes))
    cameras = []
    for eye, tight, shift in zip(eyes, tightness, 0.02 * unrest, strict=True):
        factors, height = TOWARDS_ROOM
        towards = room.focus * factors + [0.0, 0.0, height]
        aim = (1 - tight) * towards + tight * room.focus + shift * np.linalg.norm(room.focus - eye)
        forward = (aim - eye) / np.linalg.norm(aim - eye)
        spread = points - eye
        cosine = spread @ forward / np.linalg.norm(spread, axis=1)
        angle = min(float(np.arccos(np.clip(cosine, -1.0, 1.0)).max()), 1.3)
        filling = 0.5 * SENSOR_MM * full / np.tan(angle) * min(size) / max(size)
        focal = float(np.exp((1 - tight) * np.log(wide) + tight * np.log(filling)))
        focal = float(np.clip(min(focal, filling / full * 0.93), shortest, longest))
        up = (0.01 * rng.normal(), 0.01 * rng.normal(), 1.0)
        cameras.append(camera_from_lens(look_at(eye, aim, up=up), width=size[0], height=size[1], focal_length_mm=focal))
    return tuple(cameras)


def _moved_in(rng: Rng, room: Room, cameras: tuple[Camera, ...], fraction: float) -> tuple[Camera, ...]:
    """Let the last cameras of a path move in on one object, where the others still show everything."""
    body = pick(rng, sorted(room.watched))
    points = room.watched[body]

    def is_good(camera: Camera) -> bool:
        eye = camera.pose()[None, :3, 3]
        if eye[0, 2] < LOWEST or not room.is_free(eye)[0] or not in_frame(camera, points):
            return False
        seen = room.rays.visible_share(eye[0], body, points) >= CLEAR
        near = 0.5 * float(np.linalg.norm(eye[0] - points, axis=1).min())
        return bool(seen and not _blocked(room, camera, within=near))

    moved = move_in(rng, cameras, points, closer_views(rng, len(cameras), fraction), is_good)
    return moved if _shows(room, moved, fraction) else cameras


def _shows(room: Room, cameras: tuple[Camera, ...], fraction: float) -> bool:
    """Tell whether each object is whole and visible in that fraction of the views, and no picture is blocked."""
    seen = room.visible_fractions(np.array([camera.pose()[:3, 3] for camera in cameras])) >= SEEN
    framed = np.array([[in_frame(camera, points) for points in room.watched.values()] for camera in cameras])
    if ((seen & framed).mean(axis=0) < fraction).any():
        return False
    return not any(_blocked(room, camera) for camera in cameras)


def _blocked(room: Room, camera: Camera, *, within: float = BLOCKED) -> bool:
    """Tell whether something closer than `within` [m] fills too much of a picture."""
    small = camera.model_copy(
        update={
            "width": 12, "height": 12, "fx": camera.fx * 12 / camera.width, "fy": camera.fy * 12 / camera.height,
            "cx": 6.0, "cy": 6.0,
        }
    )  # fmt: skip
    origins, directions = pixel_rays(small)
    _, distance = room.rays.first_hit(origins.reshape(-1, 3), directions.reshape(-1, 3))
    return bool((distance < within).mean() > BLOCKED_FRACTION)
