"""Pinhole cameras: poses, projection, rays, and depth carried from view to view.

Arrays of pixels are (x, y) from the image's top left, pixel centres at (x + 0.5, y + 0.5); points are world
coordinates in metres; `z_depth` is measured along the optical axis, 0 where there is nothing.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import uniform_filter

from multilight.scenes.arrays import Float64, Mask
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera

SENSOR_MM = 36.0
"""Width of a full-frame sensor, and Blender's default, in millimetres."""
FLAT = 1e-3
"""How far inverse depth may be from its mean round a pixel, relative, where a surface counts as flat."""


def look_at(eye: ArrayLike, target: ArrayLike, up: Sequence[float] = (0.0, 0.0, 1.0)) -> Float64:
    """Return the 4x4 `c2w` (OpenGL axes, metres) of a camera at `eye` that looks at `target`.

    `up` is the world direction that points up in the picture. Raises `ValueError` where eye and target coincide
    or the view runs along `up`.
    """
    eye, target = np.asarray(eye, np.float64), np.asarray(target, np.float64)
    backward = eye - target
    right = np.cross(np.asarray(up, np.float64), backward)
    if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(backward) * np.linalg.norm(up):
        raise ValueError(
            f"cannot look from {eye.tolist()} at {target.tolist()} with up {tuple(up)}: "
            "the points must differ and not lie along up"
        )
    backward /= np.linalg.norm(backward)
    right /= np.linalg.norm(right)
    c2w = np.eye(4)
    c2w[:3] = np.stack([right, np.cross(backward, right), backward, eye], axis=1)
    return c2w


def camera_from_fov(c2w: ArrayLike, *, width: int, height: int, fov: float) -> Camera:
    """Return a centred camera with square pixels; `fov` [rad] spans the image's longer side."""
    if not 0.0 < fov < math.pi:
        raise ValueError(f"field of view {fov} rad is outside (0, pi)")
    focal = max(width, height) / (2.0 * math.tan(fov / 2.0))
    return Camera(width=width, height=height, fx=focal, fy=focal, cx=width / 2, cy=height / 2, c2w=matrix4(c2w))


def camera_from_lens(c2w: ArrayLike, *, width: int, height: int, focal_length_mm: float) -> Camera:
    """Return a centred camera with a lens of this focal length before a 36 mm sensor.

    The sensor's width spans the image's longer side, as in Blender's sensor fit `AUTO`.
    """
    if focal_length_mm <= 0:
        raise ValueError(f"focal length {focal_length_mm} mm must be above 0")
    fov = 2.0 * math.atan(SENSOR_MM / (2.0 * focal_length_mm))
    return camera_from_fov(c2w, width=width, height=height, fov=fov)


def focal_length_mm(camera: Camera) -> float:
    """Return the full-frame equivalent focal length [mm]: the undoing of `camera_from_lens`."""
    return SENSOR_MM * camera.fx / max(camera.width, camera.height)


def half_angle(focal_length_mm: float, size: tuple[int, int]) -> float:
    """Return half the angle [rad] that the shorter side of a picture of `size` (width, height) [pixels] spans."""
    return float(np.arctan(SENSOR_MM / (2.0 * focal_length_mm) * min(size) / max(size)))


def with_depth_of_field(camera: Camera, *, f_number: float, focus_distance: float) -> Camera:
    """Open the lens: aperture as on a full-frame camera, focused on the plane at `focus_distance` [m].

    The f-number is the focal length over the aperture's diameter, so the radius is focal length / (2 N).
    """
    if not (f_number > 0 and focus_distance > 0):
        raise ValueError(f"f-number {f_number} and focus distance {focus_distance} m must be above 0")
    radius = focal_length_mm(camera) / 1000.0 / (2.0 * f_number)
    return camera.model_copy(update={"aperture_radius": radius, "focus_distance": focus_distance})


def circle_of_confusion(camera: Camera, z_depth: ArrayLike) -> Float64:
    """Return the diameter [pixels, along x] of the disc that a point at `z_depth` [m] becomes; 0 for a pinhole.

    Similar triangles: the cone from the lens through a point at z cuts the plane of focus at z_f in a disc of
    diameter 2 r |z_f - z| / z, which the pinhole sees as 2 r fx |1/z - 1/z_f| pixels.
    """
    depth = np.asarray(z_depth, np.float64)
    return np.asarray(2.0 * camera.aperture_radius * camera.fx * np.abs(1.0 / depth - 1.0 / camera.focus_distance))


def camera_of(intrinsics: ArrayLike, c2w: ArrayLike, size: Sequence[int]) -> Camera:
    """Return the camera of K (3, 3) in pixels, c2w (4, 4) with OpenGL axes, and a picture's (height, width)."""
    (fx, _, cx), (_, fy, cy), _ = np.asarray(intrinsics, np.float64)
    return Camera(width=size[1], height=size[0], fx=fx, fy=fy, cx=cx, cy=cy, c2w=matrix4(c2w))


def opencv_from_opengl(c2w: ArrayLike) -> Float64:
    """Convert a camera-to-world pose from OpenGL axes (+Y up, looks along -Z) to OpenCV's (+Y down, along +Z).

    4x4 to 4x4; its own inverse.
    """
    return np.asarray(c2w, np.float64) @ np.diag([1.0, -1.0, -1.0, 1.0])


def project(camera: Camera, points: ArrayLike) -> tuple[Float64, Float64]:
    """Project world points (N, 3) to pixels (N, 2) and z_depth (N,), both float64.

    Points at or behind the pinhole come out with a z_depth of 0 or less and pixels NaN.
    """
    pose = camera.pose()
    x, y, z = ((np.asarray(points, np.float64) - pose[:3, 3]) @ pose[:3, :3]).T
    depth = -z
    ahead = np.where(depth > 0, depth, np.nan)
    pixels = np.stack([camera.cx + camera.fx * x / ahead, camera.cy - camera.fy * y / ahead], axis=-1)
    return pixels, depth


def _axis_one_directions(camera: Camera, offset: tuple[float, float] = (0.5, 0.5)) -> Float64:
    """Return world directions (H, W, 3) whose component along the optical axis is one, not unit."""
    x = (np.arange(camera.width) + offset[0] - camera.cx) / camera.fx
    y = (camera.cy - np.arange(camera.height) - offset[1]) / camera.fy
    right, up, backward = camera.pose()[:3, :3].T
    return x[None, :, None] * right + y[:, None, None] * up - backward


def unproject(camera: Camera, z_depth: ArrayLike) -> Float64:
    """Lift z_depth (H, W) at the pixel centres to world points (H, W, 3) float64.

    Where z_depth is 0 (nothing there) the point is the pinhole.
    """
    depth = np.asarray(z_depth, np.float64)
    if depth.shape != (camera.height, camera.width):
        raise ValueError(f"z_depth has shape {depth.shape}, the camera's image is {camera.height} x {camera.width}")
    return camera.pose()[:3, 3] + depth[..., None] * _axis_one_directions(camera)


def pixel_rays(camera: Camera, offset: tuple[float, float] = (0.5, 0.5)) -> tuple[Float64, Float64]:
    """Return the rays through the pixels: origins and unit directions, both (H, W, 3) float64, world.

    `offset` (x, y) in [0, 1]^2 is the place inside each pixel, from its top left; the centre unless told.
    """
    directions = _axis_one_directions(camera, offset)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.broadcast_to(camera.pose()[:3, 3], directions.shape), directions


def ray_distance_from_z_depth(camera: Camera, z_depth: ArrayLike) -> Float64:
    """Turn z_depth (H, W) into the distance from the pinhole along each pixel's ray, float64, metres."""
    return np.asarray(z_depth, np.float64) * np.linalg.norm(_axis_one_directions(camera), axis=-1)


@dataclass(frozen=True)
class Reprojection:
    """How well one view's depth predicts another's.

    `compared` pixels could be judged; of them the fraction `consistent` agrees (NaN where none could be judged).
    `median_relative_error` is that of the points lying on a surface smooth in both views.
    """

    compared: int
    consistent: float
    median_relative_error: float


def reprojection_error(
    depth_a: ArrayLike, camera_a: Camera, depth_b: ArrayLike, camera_b: Camera, *, tolerance: float = 0.01
) -> Reprojection:
    """Carry view a's pixels into view b and compare their depth with what b stores there.

    z_depths (H, W) in metres, 0 where nothing; `tolerance` is relative. A point agrees where its depth lies
    within the stored depths of the four pixel centres around it, widened by the tolerance. One that lies behind
    all four is hidden from b and is not counted; one in front of all four should have been seen by b: a fault.
    The four-pixel range makes silhouettes count neither for nor against, nor do points beside which a's surface is not
    flat as far as a pixel of b reaches: of a close-up's detail b may store nothing.
    """
    depth_a = np.asarray(depth_a, np.float64)
    stored = np.asarray(depth_b, np.float64)
    if stored.shape != (camera_b.height, camera_b.width):
        raise ValueError(f"depth_b has shape {stored.shape}, not {camera_b.height} x {camera_b.width}")
    pixels, depth = project(camera_b, unproject(camera_a, depth_a)[depth_a > 0])
    grid = pixels - 0.5
    inside = (depth > 0) & np.all((grid >= 0) & (grid < [camera_b.width - 1, camera_b.height - 1]), axis=1)
    reach = depth[inside] / depth_a[depth_a > 0][inside] * camera_a.fx / camera_b.fx
    inside &= _flat(depth_a, float(np.percentile(reach, 90)) if len(reach) else 1.0)[depth_a > 0]
    grid, depth = grid[inside], depth[inside]
    corner = grid.astype(np.int64)
    # Nothing there is infinitely far: 1 / inf = 0 keeps the arithmetic below plain.
    inverse = np.divide(1.0, stored, out=np.zeros_like(stored), where=stored > 0)
    x, y = corner.T
    around = np.stack([inverse[y, x], inverse[y, x + 1], inverse[y + 1, x], inverse[y + 1, x + 1]])
    ratio = depth * around  # above 1: the point lies behind what b stores
    hidden = ratio.min(axis=0) > 1.0 + tolerance
    in_front = ratio.max(axis=0) < 1.0 - tolerance
    compared = int(np.count_nonzero(~hidden))
    # Inverse depth is linear across the image of a plane, so bilinear interpolation is exact there.
    fraction = grid - corner
    weights = np.stack([1 - fraction[:, 0], fraction[:, 0]])
    top, bottom = (weights * ratio[:2]).sum(axis=0), (weights * ratio[2:]).sum(axis=0)
    blended = top * (1 - fraction[:, 1]) + bottom * fraction[:, 1]
    smooth = ~hidden & _flat(stored, 1.0)[y, x]
    return Reprojection(
        compared=compared,
        consistent=1.0 - np.count_nonzero(in_front) / compared if compared else math.nan,
        median_relative_error=float(np.median(np.abs(blended[smooth] - 1.0))) if smooth.any() else math.nan,
    )


def _flat(depth: Float64, reach: float) -> Mask:
    """Say which pixels of a z_depth (H, W) show a plane as far as `reach` pixels round them.

    Inverse depth is linear across the image of a plane, so there its mean over a window is the value in the middle.
    """
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=depth > 0)
    side = 2 * min(math.ceil(reach), max(1, min(depth.shape) // 8)) + 1
    return np.abs(uniform_filter(inverse, side, mode="mirror") - inverse) < FLAT * inverse
