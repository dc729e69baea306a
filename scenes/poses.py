"""Rigid poses: 4x4 matrices that take a body's frame to another (metres, +Z up), and small things about them."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from multilight.scenes.arrays import Float64
from multilight.scenes.frozen import Matrix4
from multilight.scenes.spec import Body, Camera, SceneKind, SceneSpec


def matrix4(matrix: ArrayLike) -> Matrix4:
    """Convert a 4x4 array to the nested tuples that specifications hold."""
    rows = np.asarray(matrix, np.float64)
    if rows.shape != (4, 4):
        raise ValueError(f"expected a 4x4 matrix, got shape {rows.shape}")
    return tuple(tuple(float(x) for x in row) for row in rows)  # type: ignore[return-value]


def about_z(angle: float) -> Float64:
    """Return the rotation (4, 4) about +Z by `angle` [rad]."""
    rotation = np.eye(4)
    rotation[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return rotation


def pose_at(place: ArrayLike, z: float, angle: float) -> Float64:
    """Return the pose (4, 4) of a body at (x, y) and height `z` [m], rotated about +Z by `angle` [rad]."""
    pose = about_z(angle)
    pose[:2, 3], pose[2, 3] = place, z
    return pose


def pose_of(rotation: ArrayLike, offset: ArrayLike) -> Float64:
    """Return the pose (4, 4) of a rotation (3, 3) and an offset (3,) [m]."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, offset
    return pose


def translation(offset: ArrayLike) -> Float64:
    """Return the pose (4, 4) that moves by an offset (3,) [m] and rotates nothing."""
    return pose_of(np.eye(3), offset)


def apply_pose(pose: Float64, points: NDArray[np.floating]) -> Float64:
    """Take points (..., 3) through a pose (4, 4)."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])


def direction_from(azimuth: float, elevation: float) -> Float64:
    """Return the unit vector (3,) at an azimuth (counter-clockwise from +X) and an elevation [rad]."""
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])


def box_centre(points: Float64) -> Float64:
    """Return the centre (D,) of the bounding box of points (N, D)."""
    return np.asarray((points.min(axis=0) + points.max(axis=0)) / 2)


def rotated_scene(
    kind: SceneKind, index: int, bodies: Iterable[Body], cameras: Iterable[Camera], angle: float
) -> SceneSpec:
    """Make a scene with everything rotated about +Z by `angle` [rad], so that no world axis is special in a dataset."""
    rotation = about_z(angle)
    return SceneSpec(
        kind=kind,
        index=index,
        bodies=tuple(
            body.model_copy(update={"world_from_body": matrix4(rotation @ np.array(body.world_from_body))})
            for body in bodies
        ),
        cameras=tuple(camera.model_copy(update={"c2w": matrix4(rotation @ camera.pose())}) for camera in cameras),
    )
