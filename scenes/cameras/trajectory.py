"""Cameras that show a still life, on a path of one of four kinds, clear of everything."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from trimesh.collision import CollisionManager
from trimesh.creation import box
from trimesh.triangles import closest_point

from multilight.scenes.arrays import Float64
from multilight.scenes.cameras.close_ups import CLEAR, closer_views, move_in
from multilight.scenes.cameras.paths import (
    DEFAULT_CAMERAS,
    CameraSettings,
    Framing,
    TrajectoryKind,
    camera_on,
    draw_path,
)
from multilight.scenes.cameras.pinhole import project, with_depth_of_field
from multilight.scenes.errors import MultilightError
from multilight.scenes.geometry.rays import SceneRays
from multilight.scenes.poses import box_centre, translation
from multilight.scenes.random_streams import Rng, log_uniform, pick
from multilight.scenes.spec import Camera

CLEARANCE = 0.08
"""Smallest distance [m] of a camera to the convex hull of any body, and to any wall."""
MARGIN = 0.015
"""Fraction of the image's sides that an object in frame keeps clear of its edges."""
SEEN = 0.3
"""An object counts as visible where this fraction of its points in view is not hidden by others."""
TRIES = 12
"""Paths that are drawn before a scene is given up."""
CANDIDATES = 8
"""Cameras that are drawn for one view of a `random` trajectory."""

CLOSER = frozenset({"approach", "random"})
"""Trajectories whose last views may move in on one object."""

_POINT = box((1e-4, 1e-4, 1e-4))


class TrajectoryError(MultilightError):
    """No path shows the objects well enough."""


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


def sample_trajectory(
    rng: Rng,
    subject: Subject,
    *,
    width: int,
    height: int,
    views: int,
    kind: TrajectoryKind = "approach",
    settings: CameraSettings = DEFAULT_CAMERAS,
) -> tuple[Camera, ...]:
    """Draw cameras in which each insertable object is whole and visible in `settings.min_visible_share` of the views.

    None stands inside or within `CLEARANCE` of anything, behind a wall, or below the table's top. Draw `kind` from
    `settings.trajectories` once a scene: refusals make no kind rarer. Raises `TrajectoryError` after `TRIES` paths.
    """
    size = (width, height)
    for attempt in range(TRIES):
        # Later tries narrow the sweep and the lens, so that a tight room still finds a path.
        framing = _framing(rng, subject, narrow=0.93**attempt)
        if kind == "random":
            cameras = _scattered(rng, subject, framing, size, views, settings)
        else:
            path = draw_path(rng, kind, framing, views=views, lens_mm=settings.lens_mm)
            cameras = tuple(camera_on(path, view, _aims(subject), size) for view in range(views))
        free = len(cameras) == views and all(_is_free(camera, subject) for camera in cameras)
        if free and _shows(cameras, subject, settings.min_visible_share):
            if kind in CLOSER:
                cameras = _moved_in(rng, cameras, subject, settings.min_visible_share)
            return focused(rng, cameras, subject.watched, settings)
    raise TrajectoryError(f"none of {TRIES} {kind} paths is free and shows every insertable object")


def _framing(rng: Rng, subject: Subject, *, narrow: float) -> Framing:
    """Measure the still life and the table, and draw how tightly they are framed."""
    group = float(np.linalg.norm(subject.group - box_centre(subject.group), axis=1).max())
    table = float(np.linalg.norm(subject.table - subject.table.mean(axis=0), axis=1).max())
    close = group * rng.uniform(0.92, 1.12)
    distant = float(np.clip(table * rng.uniform(0.8, 1.0), 1.6 * close, 3.0 * close))
    return Framing(close=close, distant=distant, front=subject.front, opening=subject.opening, narrow=narrow)


def _aims(subject: Subject) -> tuple[Float64, Float64]:
    """Return what a distant camera looks at, and what a close one does: points (3,)."""
    distant = 0.5 * box_centre(subject.group) + 0.5 * subject.table.mean(axis=0)
    watched = box_centre(np.concatenate(list(subject.watched.values())))
    return distant, 0.6 * box_centre(subject.group) + 0.4 * watched


def _scattered(
    rng: Rng, subject: Subject, framing: Framing, size: tuple[int, int], views: int, settings: CameraSettings
) -> tuple[Camera, ...]:
    """Draw views one by one: the first candidate that shows everything, else the first that stands free."""
    chosen: list[Camera] = []
    for _ in range(views):
        path = draw_path(rng, "random", framing, views=CANDIDATES, lens_mm=settings.lens_mm)
        candidates = (camera_on(path, number, _aims(subject), size) for number in range(CANDIDATES))
        free = [camera for camera in candidates if _is_free(camera, subject)]
        good = (camera for camera in free if _shows((camera,), subject, 1.0))
        if not free:
            break
        chosen.append(next(good, free[0]))
    return tuple(chosen)


def _moved_in(rng: Rng, cameras: tuple[Camera, ...], subject: Subject, fraction: float) -> tuple[Camera, ...]:
    """Let the last cameras of a path move in on one object, where the others still show everything."""
    body = pick(rng, sorted(subject.watched))
    points = subject.watched[body]

    def is_good(camera: Camera) -> bool:
        if not _is_free(camera, subject) or not in_frame(camera, points):
            return False
        return subject.rays.visible_share(camera.pose()[:3, 3], body, points) >= CLEAR

    moved = move_in(rng, cameras, points, closer_views(rng, len(cameras), fraction), is_good)
    return moved if _shows(moved, subject, fraction) else cameras


def focused(
    rng: Rng, cameras: tuple[Camera, ...], objects: dict[int, Float64], settings: CameraSettings
) -> tuple[Camera, ...]:
    """Open the lens in the stated fraction of scenes, focused throughout on one of the objects' points (N, 3)."""
    if rng.random() >= settings.depth_of_field:
        return cameras
    centre = box_centre(objects[pick(rng, sorted(objects))])
    f_number = log_uniform(rng, *settings.f_number)
    depths = [float(project(camera, centre[None])[1][0]) for camera in cameras]
    # An object behind the camera cannot be in focus: such a view looks into the distance.
    return tuple(
        with_depth_of_field(camera, f_number=f_number, focus_distance=depth if depth > 0 else 10.0)
        for camera, depth in zip(cameras, depths, strict=True)
    )


def _is_free(camera: Camera, subject: Subject) -> bool:
    """Tell whether a camera stands clear of everything, above the table's top and on the open side of all walls."""
    eye = camera.pose()[:3, 3]
    if eye[2] < subject.table[0, 2] + CLEARANCE:
        return False
    distance = np.linalg.norm(closest_point(subject.walls, np.broadcast_to(eye, (len(subject.walls), 3))) - eye, axis=1)
    if distance.min() < CLEARANCE:
        return False
    above = box_centre(subject.group)
    above[2] = subject.group[:, 2].max() + 0.01
    if not subject.rays.sees(above, eye[None], slack=0.0)[0]:
        return False
    return bool(subject.solids.min_distance_single(_POINT, translation(eye)) >= CLEARANCE)


def _shows(cameras: Sequence[Camera], subject: Subject, fraction: float) -> bool:
    """Tell whether every insertable object is whole and visible in that fraction of the views."""
    for body, points in subject.watched.items():
        good = [camera for camera in cameras if in_frame(camera, points)]
        seen = [subject.rays.visible_share(camera.pose()[:3, 3], body, points) >= SEEN for camera in good]
        if sum(seen) < fraction * len(cameras):
            return False
    return True


def in_frame(camera: Camera, points: Float64) -> bool:
    """Tell whether all points (N, 3) project into the image, `MARGIN` from its edges."""
    pixels, depth = project(camera, points)
    if (depth <= 0).any():
        return False
    size = np.array([camera.width, camera.height])
    return bool((pixels >= MARGIN * size).all() and (pixels <= (1 - MARGIN) * size).all())
