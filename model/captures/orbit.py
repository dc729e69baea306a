"""An orbit about the inserted object, through the Gaussians of the harmonized scene."""

import numpy as np

from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.cameras.pinhole import look_at
from multilight.scenes.gaussians.from_views import Gaussians
from multilight.scenes.gaussians.splatting import blending_weights
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera

GAP = np.deg2rad(120.0)
"""Angle without a camera from which on the orbit swings to and fro over what was seen, instead of going round."""


def orbit_cameras(cameras: tuple[Camera, ...], centre: Float64, up: Float64, frames: int) -> tuple[Camera, ...]:
    """Return cameras that look at `centre` from the capture's median distance and height, once round and closed.

    Where the capture's cameras leave a gap of 120 degrees or more, the orbit swings over the rest. Lens and size are
    those of the first camera, the size cut to even numbers, as video wants.
    """
    first = cameras[0]
    width, height = first.width // 2 * 2, first.height // 2 * 2
    offsets = np.stack([camera.pose()[:3, 3] for camera in cameras]) - centre
    axis = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    axis /= np.linalg.norm(axis)
    side = np.cross(up, axis)
    rise = float(np.median(offsets @ up))
    reach = float(np.median(np.hypot(offsets @ axis, offsets @ side)))
    angles = _angles(np.arctan2(offsets @ side, offsets @ axis), frames)
    made = []
    for angle in angles:
        eye = centre + rise * up + max(reach, 1e-6) * (np.cos(angle) * axis + np.sin(angle) * side)
        pose = matrix4(look_at(eye, centre, tuple(up)))
        made.append(first.model_copy(update={"width": width, "height": height, "c2w": pose}))
    return tuple(made)


def _angles(seen: Float64, frames: int) -> Float64:
    seen = np.sort(np.mod(seen, 2 * np.pi))
    gaps = np.diff(np.append(seen, seen[0] + 2 * np.pi))
    widest = int(np.argmax(gaps))
    phase = 2 * np.pi * np.arange(frames) / frames
    if gaps[widest] < GAP:
        return np.asarray(seen[0] + phase)
    start, span = seen[(widest + 1) % len(seen)], 2 * np.pi - gaps[widest]
    return np.asarray(start + span * (0.5 - 0.5 * np.cos(phase)))


def render_gaussians(camera: Camera, gaussians: Gaussians) -> Float32:
    """Render Gaussians over their mean colour: (H, W, 3) float32 in [0, 1], in the encoding of their colours."""
    weights = blending_weights(camera, gaussians)
    free = 1.0 - np.asarray(weights.sum(axis=1)).reshape(-1, 1)
    picture = weights @ gaussians.colors + np.maximum(free, 0.0) * gaussians.colors.mean(axis=0)
    return np.clip(picture, 0.0, 1.0).reshape(camera.height, camera.width, 3).astype(np.float32)
