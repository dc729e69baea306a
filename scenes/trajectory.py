"""Cameras on a smooth arc, from the whole table to the still life that fills the frame."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from trimesh.collision import CollisionManager
from trimesh.creation import box
from trimesh.triangles import closest_point

from scenes.cameras import camera_from_lens, look_at, project
from scenes.rays import SceneRays
from scenes.spec import Camera

CLEARANCE = 0.08
"""Smallest distance [m] of a camera to the convex hull of any body, and to any wall."""
MARGIN = 0.015
"""Share of the image's sides that an object in frame keeps clear of its edges."""
SEEN = 0.3
"""An object counts as visible where this share of its points in view is not hidden by others."""
VIEWS_SEEN = 0.6
"""Share of the views in which each insertable object must be whole and visible."""

_POINT = box((1e-4, 1e-4, 1e-4))

Float64 = NDArray[np.float64]


class TrajectoryError(RuntimeError):
    """No arc shows the objects well enough."""


@dataclass(frozen=True)
class Subject:
    """What the cameras look at and must keep clear of; world frame, metres.

    `watched` maps the index of each insertable body (as in `rays`) to points on its surface (N, 3); `group` (N, 3)
    are points of the whole still life; `table` (N, 3) the outline of the table's free surface. `solids` holds the
    convex hulls of table and objects, `walls` (F, 3, 3) the triangles of the surrounding. Cameras stand within
    `opening` [rad] of azimuth `front` [rad].
    """

    watched: dict[int, Float64]
    group: Float64
    table: Float64
    rays: SceneRays
    solids: CollisionManager
    walls: Float64
    front: float
    opening: float


@dataclass(frozen=True)
class _Arc:
    """Ends of the arc, (from, to) each: azimuth, elevation [rad], focal length [mm], and radius framed [m]."""

    azimuth: tuple[float, float]
    elevation: tuple[float, float]
    focal: tuple[float, float]
    framed: tuple[float, float]


def sample_trajectory(
    rng: np.random.Generator, subject: Subject, *, width: int, height: int, views: int, tries: int = 12
) -> tuple[Camera, ...]:
    """Draw cameras in which each insertable object is whole and visible in most views.

    None stands inside or within `CLEARANCE` of anything, behind a wall, or below the table's top. Raises
    `TrajectoryError` after `tries` arcs.
    """
    for attempt in range(tries):
        # Later tries narrow the sweep, so that a tight room still finds an arc.
        arc = _sample_arc(rng, subject, narrow=0.93**attempt)
        cameras = _cameras(rng, arc, subject, (width, height), views)
        if all(_is_free(camera, subject) for camera in cameras) and _shows(cameras, subject):
            return cameras
    raise TrajectoryError(f"none of {tries} camera arcs is free and shows every insertable object")


def _sample_arc(rng: np.random.Generator, subject: Subject, *, narrow: float) -> _Arc:
    """Draw the ends of an arc."""
    widest = min(np.radians(120.0), 2.0 * subject.opening)
    sweep = max(np.radians(50.0), narrow * rng.uniform(np.radians(50.0), widest))
    slack = max(0.0, subject.opening - sweep / 2)
    middle = subject.front + (rng.uniform(-slack, slack) if slack < np.pi / 2 else rng.uniform(-np.pi, np.pi))
    side = float(rng.choice([-1.0, 1.0]))
    group_radius = float(np.linalg.norm(subject.group - _middle(subject.group), axis=1).max())
    table_radius = float(np.linalg.norm(subject.table - subject.table.mean(axis=0), axis=1).max())
    close = group_radius * rng.uniform(0.92, 1.12)
    return _Arc(
        azimuth=(middle - side * sweep / 2, middle + side * sweep / 2),
        elevation=(np.radians(rng.uniform(20.0, 42.0)), np.radians(rng.uniform(16.0, 48.0))),
        focal=(rng.uniform(24.0, 40.0), rng.uniform(38.0, 70.0)),
        framed=(float(np.clip(table_radius * rng.uniform(0.8, 1.0), 1.6 * close, 3.0 * close)), close),
    )


def _middle(points: Float64) -> Float64:
    """Return the centre of the bounding box of points (N, 3)."""
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def _cameras(
    rng: np.random.Generator, arc: _Arc, subject: Subject, size: tuple[int, int], views: int
) -> tuple[Camera, ...]:
    """Place the cameras along an arc, with the slight unrest of a hand."""
    step = np.linspace(0.0, 1.0, views) if views > 1 else np.array([0.6])
    # Azimuth runs evenly; the approach starts gently and ends gently.
    ease = 0.5 * step + 0.5 * step**2 * (3 - 2 * step)
    far_aim = 0.5 * _middle(subject.group) + 0.5 * subject.table.mean(axis=0)
    near_aim = 0.6 * _middle(subject.group) + 0.4 * _middle(np.concatenate(list(subject.watched.values())))
    cameras = []
    for t, e in zip(step, ease, strict=True):
        shake = rng.normal(0.0, 1.0, 7)
        azimuth = np.interp(t, [0, 1], arc.azimuth) + 0.012 * shake[0]
        elevation = float(np.clip(np.interp(e, [0, 1], arc.elevation) + 0.012 * shake[1], 0.262, 0.873))
        focal = float(np.exp(np.interp(e, [0, 1], np.log(arc.focal))))
        framed = float(np.exp(np.interp(e, [0, 1], np.log(arc.framed))))
        half = np.arctan(36.0 / (2.0 * focal) * min(size) / max(size))
        distance = framed / np.sin(half) * (1.0 + 0.015 * shake[2])
        aim = (1 - e) * far_aim + e * near_aim + 0.02 * framed * shake[3:6]
        way = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        up = (-np.sin(azimuth) * 0.01 * shake[6], np.cos(azimuth) * 0.01 * shake[6], 1.0)
        pose = look_at(aim + distance * np.array(way), aim, up=up)
        cameras.append(camera_from_lens(pose, width=size[0], height=size[1], focal_length_mm=focal))
    return tuple(cameras)


def _is_free(camera: Camera, subject: Subject) -> bool:
    """Tell whether a camera stands clear of everything, above the table's top and on the open side of all walls."""
    eye = camera.pose()[:3, 3]
    if eye[2] < subject.table[0, 2] + CLEARANCE:
        return False
    distance = np.linalg.norm(closest_point(subject.walls, np.broadcast_to(eye, (len(subject.walls), 3))) - eye, axis=1)
    if distance.min() < CLEARANCE:
        return False
    above = _middle(subject.group)
    above[2] = subject.group[:, 2].max() + 0.01
    if not subject.rays.sees(above, eye[None], slack=0.0)[0]:
        return False
    pose = np.eye(4)
    pose[:3, 3] = eye
    return bool(subject.solids.min_distance_single(_POINT, pose) >= CLEARANCE)


def _shows(cameras: Sequence[Camera], subject: Subject) -> bool:
    """Tell whether every insertable object is whole and visible in enough views."""
    for body, points in subject.watched.items():
        good = sum(in_frame(camera, points) and _is_seen(camera, subject.rays, body, points) for camera in cameras)
        if good < VIEWS_SEEN * len(cameras):
            return False
    return True


def in_frame(camera: Camera, points: Float64) -> bool:
    """Tell whether all points (N, 3) project into the image, `MARGIN` from its edges."""
    pixels, depth = project(camera, points)
    if (depth <= 0).any():
        return False
    size = np.array([camera.width, camera.height])
    return bool((pixels >= MARGIN * size).all() and (pixels <= (1 - MARGIN) * size).all())


def _is_seen(camera: Camera, rays: SceneRays, body: int, points: Float64) -> bool:
    """Tell whether enough of an object is not hidden by others."""
    return rays.visible_share(camera.pose()[:3, 3], body, points) >= SEEN
