"""Where the object goes: a pose from a file, or a place on a plane of the capture."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from multilight.datagen.errors import UserError
from multilight.model.captures.assets import Asset
from multilight.model.captures.capture import Capture
from multilight.model.captures.planes import find_plane, free_place, scene_centre, scene_up
from multilight.model.captures.request import Wish
from multilight.scenes.arrays import Float64
from multilight.scenes.files.limits import parse_json, read_text
from multilight.scenes.poses import pose_of

FRACTIONS = (0.2, 0.15, 0.11, 0.08, 0.06)
"""Fractions of the pictures' width that the object takes at the scene's centre, unless its scale is given: the
first that there is room for."""


def placed(capture: Capture, asset: Asset, wish: Wish) -> Float64:
    """Return `world_from_asset`, 4x4: rotation times uniform scale, and translation.

    Raises `UserError` for a pose file that cannot be read and where no plane is found.
    """
    if wish.pose is not None:
        return _from_file(wish.pose, capture, asset, wish)
    plane = find_plane(capture, np.random.default_rng(wish.seed))
    for scale in (wish.scale,) if wish.scale else [fitting_scale(capture, asset, fraction) for fraction in FRACTIONS]:
        radius = 0.5 * float(np.hypot(*asset.size[:2])) * scale
        place, free = free_place(capture, plane, radius, scale * float(asset.size[2]))
        if free:
            break
    else:
        print(f"no room on the plane for an object {2 * radius:.3g} wide: it may cut into others", file=sys.stderr)
    return upright(place, plane.normal, wish.yaw, scale)


def fitting_scale(capture: Capture, asset: Asset, fraction: float = FRACTIONS[0]) -> float:
    """Return the scale at which the asset takes a fraction of the pictures' width at the scene's centre."""
    centre = scene_centre(capture)
    widths = [np.linalg.norm(c.pose()[:3, 3] - centre) * c.width / c.fx for c in capture.cameras]
    return fraction * float(np.median(widths)) / float(asset.size.max())


def upright(place: Float64, up: Float64, yaw: float, scale: float) -> Float64:
    """Return the pose (4x4) of an asset that stands at `place` with its +Z along `up`, rotated by `yaw` degrees."""
    rotation, _ = Rotation.align_vectors(up[None], np.array([[0.0, 0.0, 1.0]]))
    return pose_of(scale * (rotation * Rotation.from_euler("z", yaw, degrees=True)).as_matrix(), place)


def _from_file(path: Path, capture: Capture, asset: Asset, wish: Wish) -> Float64:
    """Read a 4x4 matrix, as JSON or 16 numbers, or JSON with `position` and, if wanted, `yaw`, `scale`, `up`."""
    try:
        text = read_text(path)
        try:
            content: Any = parse_json(text)
        except ValueError:
            content = np.array(text.replace(",", " ").split(), np.float64).reshape(4, 4)
        if isinstance(content, dict) and "position" in content:
            up = np.array(content["up"], np.float64) if "up" in content else scene_up(capture)
            if not 0 < np.linalg.norm(up) < np.inf:
                raise ValueError("its `up` has no direction")
            scale = float(content.get("scale", wish.scale or fitting_scale(capture, asset)))
            position = np.array(content["position"], np.float64).reshape(3)
            return _sound(path, upright(position, up / np.linalg.norm(up), float(content.get("yaw", wish.yaw)), scale))
        matrix = content.get("matrix") if isinstance(content, dict) else content
        return _sound(path, np.array(matrix, np.float64).reshape(4, 4))
    except OSError as error:
        raise UserError(f"pose {path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError) as error:
        raise UserError(
            f"pose {path} must be a 4x4 matrix (16 numbers, or JSON), or JSON with position, yaw, scale: {error}"
        ) from None


def _sound(path: Path, pose: Float64) -> Float64:
    linear = pose[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear))) if np.isfinite(pose).all() else 0.0
    rigid = scale > 0 and np.allclose(linear @ linear.T, scale**2 * np.eye(3), atol=1e-3 * scale**2)
    if not (rigid and np.allclose(pose[3], [0, 0, 0, 1])):
        raise UserError(f"pose {path} is not a rotation, a uniform scale and a translation: {pose.tolist()}")
    return pose
