"""Which direction is up in a capture, and the plane that an object can stand on."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from multilight.datagen.errors import UserError
from multilight.model.captures.capture import Capture
from multilight.scenes.arrays import Float64
from multilight.scenes.cameras.pinhole import unproject
from multilight.scenes.random_streams import Rng

TRIALS = 1000
TILT = np.deg2rad(30.0)
"""Largest angle between the plane's normal and up."""
REACH = 0.6
"""Radius about the scene's centre that is searched, over the cameras' median distance from it."""
THICKNESS = 0.01
"""Distance from the plane within which a point lies on it, over the same distance."""
FINEST = 0.0005
"""Roughness, over the same distance, below which no plane is measured."""
LEAST = 0.1
"""Fraction of the points about the centre that a plane must hold."""
POINTS = 20_000
"""Points, at most, that planes are looked for in."""
UPRIGHT = np.deg2rad(5.0)
"""Angle within which the cameras' up counts as the world's +Z."""


@dataclass(frozen=True)
class Plane:
    """A plane: unit normal (3,) towards up, `offset` = normal . point, and its points (N, 3).

    `rough` is the median distance of the points from it.
    """

    normal: Float64
    offset: float
    rough: float
    points: Float64

    def height(self, points: Float64) -> Float64:
        """Return how high points (..., 3) lie above it."""
        return np.asarray(points @ self.normal - self.offset)


def scene_up(capture: Capture) -> Float64:
    """Return the unit direction (3,) that is up: the one to which the pictures' horizontal axes are perpendicular.

    Photographers hold cameras level. Where all look in one direction, their own up decides what is left open.
    """
    poses = np.stack([camera.pose()[:3, :3] for camera in capture.cameras])
    mean = poses[:, :, 1].mean(axis=0)
    mean /= np.linalg.norm(mean)
    right = poses[:, :, 0]
    spread = right.T @ right / len(right) + 1e-2 * (np.eye(3) - np.outer(mean, mean))
    up = np.linalg.eigh(spread)[1][:, 0]
    up = up if up @ mean > 0 else -up
    return np.array([0.0, 0.0, 1.0]) if up[2] > np.cos(UPRIGHT) else np.asarray(up)


def scene_centre(capture: Capture) -> Float64:
    """Return the point (3,) nearest to all optical axes, or, where they run together, the median of the points."""
    forward = -np.stack([camera.pose()[:3, 2] for camera in capture.cameras])
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]
    total = across.sum(axis=0)
    if np.linalg.eigvalsh(total)[0] > 1e-2 * len(forward):
        centre = np.linalg.solve(total, (across @ capture.eyes[..., None]).sum(axis=0)[:, 0])
        if all((centre - eye) @ direction > 0 for eye, direction in zip(capture.eyes, forward, strict=True)):
            return np.asarray(centre)
    return np.asarray(np.median(scene_points(capture), axis=0))


def scene_points(capture: Capture) -> Float64:
    """Return points on what the views see, (N, 3): from depth where there is any, else the sparse ones."""
    if capture.z_depths is None:
        points = capture.points
    else:
        lifted = [unproject(c, d)[d > 0] for c, d in zip(capture.cameras, capture.z_depths, strict=True)]
        points = np.concatenate(lifted)
    if len(points) < 3:
        raise UserError(f"{capture.path} has neither depth nor points; give --depth-model or --gaussians")
    step = -(-len(points) // POINTS)
    return np.asarray(points[::step])


def find_plane(capture: Capture, rng: Rng) -> Plane:
    """Find the largest plane about the scene's centre that an object can stand on.

    RANSAC (Fischler and Bolles 1981) over the points, least squares over those that agree. Raises `UserError` where
    no plane that faces up holds a tenth of the points about the centre.
    """
    centre, up = scene_centre(capture), scene_up(capture)
    distance = float(np.median(np.linalg.norm(capture.eyes - centre, axis=1)))
    points = scene_points(capture)
    near = points[np.linalg.norm(points - centre, axis=1) < REACH * distance]
    best = np.zeros(len(near), bool)
    if len(near) >= 3:
        a, b, c = (near[i] for i in rng.integers(len(near), size=(3, TRIALS)))
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1)
        normals /= np.where(length > 0, length, 1.0)[:, None]
        normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
        for normal, point in zip(normals, a, strict=True):
            if normal @ up > np.cos(TILT):
                on = np.abs((near - point) @ normal) < THICKNESS * distance
                best = on if on.sum() > best.sum() else best
    if best.sum() < max(3, LEAST * len(near)):
        raise UserError(
            f"{capture.path}: no plane that faces up holds more than {LEAST:.0%} of the {len(near)} points about the "
            "scene's centre; say with --pose where the object is to stand"
        )
    inliers = near[best]
    for _ in range(5):
        centroid = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - centroid, full_matrices=False)[2][2]
        heights = (near - centroid) @ normal
        rough = max(float(np.median(np.abs((inliers - centroid) @ normal))), FINEST * distance)
        inliers = near[np.abs(heights) < min(3.0 * rough, THICKNESS * distance)]
    normal = normal if normal @ up > 0 else -normal
    return Plane(normal, float(normal @ centroid), rough, inliers)


def free_place(capture: Capture, plane: Plane, radius: float, height: float) -> tuple[Float64, bool]:
    """Return the point (3,) of the plane nearest to the scene's centre where an object has room to stand, and True.

    `radius` and `height` are the object's. Where there is no room at all, the roomiest place is returned, and False.
    """
    points, centre = scene_points(capture), scene_centre(capture)
    heights = plane.height(points)
    obstacles = (heights > 6.0 * plane.rough) & (heights < height)
    flat = _flattened(plane, points[obstacles])
    ground = _flattened(plane, plane.points)
    tried = ground[np.argsort(np.linalg.norm(ground - _flattened(plane, centre[None]), axis=1))]
    tried = tried[:: max(1, len(tried) // 2000)]
    room = np.full(len(tried), np.inf) if not len(flat) else cKDTree(flat).query(tried)[0]
    around = cKDTree(ground).query_ball_point(tried, radius)
    # At an edge of the plane its points lie to one side.
    edge = np.array([np.linalg.norm(ground[i].mean(axis=0) - p) for i, p in zip(around, tried, strict=True)])
    good = np.flatnonzero((room > radius) & (edge < 0.2 * radius))
    chosen = int(good[0]) if len(good) else int(np.argmax(np.minimum(room, radius) - edge))
    axes = _axes(plane)
    return np.asarray(tried[chosen] @ axes + plane.offset * plane.normal), bool(len(good))


def _axes(plane: Plane) -> Float64:
    """Return two unit directions in the plane, (2, 3)."""
    first = np.cross(plane.normal, np.eye(3)[np.argmin(np.abs(plane.normal))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(plane.normal, first)])


def _flattened(plane: Plane, points: Float64) -> Float64:
    return np.asarray(points @ _axes(plane).T)
