"""A capture of many views with known cameras, whatever it was read from, as pinhole pictures of one size."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.captures.lenses import Lens, undistorted
from multilight.model.inference.pictures import opened, read_depth, resized
from multilight.scenes.arrays import Float32, Float64, Int64
from multilight.scenes.cameras.pinhole import reprojection_error
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera

ALIKE = 0.02
"""Relative difference of proportions up to which pictures are brought to one size."""
AGREEING = 0.6
"""Fraction of a view's depth that the next view must agree with, within `TOLERANCE`."""
TOLERANCE = 0.1


@dataclass(frozen=True)
class Shot:
    """One picture of a capture as its files have it: `c2w` 4x4 with OpenGL axes; depth file, and its unit [world]."""

    name: str
    image: Path
    lens: Lens
    c2w: Float64
    depth: Path | None = None
    depth_unit: float = 0.001


@dataclass(frozen=True)
class Capture:
    """V pinhole views of one size, in whatever unit of length the capture has.

    images (V, H, W, 3) float32, display-encoded in [0, 1]; z_depths (V, H, W) float32, 0 where unknown, or None;
    points (N, 3) float64 world, sparse, maybe none; `seen` which of them each view sees, (M,) int64, where known.
    """

    path: Path
    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    images: Float32
    z_depths: Float32 | None
    points: Float64
    seen: tuple[Int64, ...] | None = None

    @property
    def eyes(self) -> Float64:
        """Return where the cameras stand, (V, 3)."""
        return np.stack([camera.pose()[:3, 3] for camera in self.cameras])


def load_shots(
    path: Path,
    shots: Sequence[Shot],
    *,
    max_side: int,
    points: Float64 | None = None,
    seen: tuple[Int64, ...] | None = None,
) -> Capture:
    """Read pictures and depth, take lens distortion out, and bring all to one size of at most `max_side` pixels.

    Raises `UserError` where files are missing or do not fit their cameras, or pictures are of different shapes.
    """
    if not shots:
        raise UserError(f"{path} holds no picture with a camera")
    missing = [shot.image for shot in shots if not shot.image.is_file()]
    if missing:
        raise UserError(f"{len(missing)} of {len(shots)} pictures of {path} are missing, first of all {missing[0]}")
    with_depth = [shot for shot in shots if shot.depth is not None]
    if with_depth and len(with_depth) < len(shots):
        lacking = next(shot.name for shot in shots if shot.depth is None)
        raise UserError(f"{path}: {lacking} has no depth, others have; give depth to all views or to none")
    size: tuple[int, int] | None = None
    views = []
    for shot in shots:
        camera, image, depth = _read(shot)
        scale = min(1.0, max_side / max(image.shape[:2]))
        size = size or (max(1, round(image.shape[0] * scale)), max(1, round(image.shape[1] * scale)))
        views.append(_fitted(shot, camera, image, depth, size))
    depths = [depth for _, _, depth in views if depth is not None]
    return Capture(
        path=path,
        names=tuple(shot.name for shot in shots),
        cameras=tuple(camera for camera, _, _ in views),
        images=np.stack([image for _, image, _ in views]),
        z_depths=np.stack(depths) if depths else None,
        points=np.zeros((0, 3)) if points is None else points,
        seen=seen,
    )


def check_alignment(capture: Capture) -> None:
    """Raise `UserError` where a view's depth contradicts that of the view nearest to it."""
    if capture.z_depths is None or len(capture.cameras) < 2:
        return
    for number, camera in enumerate(capture.cameras):
        distances = np.linalg.norm(capture.eyes - capture.eyes[number], axis=1)
        distances[number] = np.inf
        other = int(np.argmin(distances))
        found = reprojection_error(
            capture.z_depths[number], camera, capture.z_depths[other], capture.cameras[other], tolerance=TOLERANCE
        )
        if found.compared and found.consistent < AGREEING:
            raise UserError(
                f"{capture.path}: seen from {capture.names[other]}, only {found.consistent:.0%} of the depth of "
                f"{capture.names[number]} can be right: cameras and depth do not fit (axes? scale? order of files?)"
            )


def _read(shot: Shot) -> tuple[Camera, Float32, Float32 | None]:
    # As its pixels lie in the file, which is what cameras are given for.
    image = np.asarray(opened(shot.image).convert("RGB"), np.float32) / 255.0
    height, width = image.shape[:2]
    if abs(width * shot.lens.height / (height * shot.lens.width) - 1.0) > ALIKE:
        raise UserError(
            f"{shot.image} is {width} x {height} pixels, its camera {shot.lens.width} x {shot.lens.height}: "
            "picture and camera do not belong together"
        )
    if shot.c2w.shape != (4, 4) or not np.isfinite(shot.c2w).all() or abs(np.linalg.det(shot.c2w[:3, :3]) - 1) > 0.01:
        raise UserError(f"the pose of {shot.name} is not a rotation and a translation: {shot.c2w.tolist()}")
    depth = None
    if shot.depth is not None:
        if not shot.depth.is_file():
            raise UserError(f"depth {shot.depth} does not exist")
        depth = read_depth_map(shot.depth) * np.float32(shot.depth_unit)
        if abs(depth.shape[1] * height / (depth.shape[0] * width) - 1.0) > ALIKE:
            raise UserError(f"depth {shot.depth} is {depth.shape[1]} x {depth.shape[0]} pixels, not as its picture")
        depth = nearest(depth, (height, width))
    return undistorted(shot.lens.scaled(width, height), shot.c2w, image, depth)


def read_depth_map(path: Path) -> Float32:
    """Read one of COLMAP's own (`.bin`), or what `read_depth` reads: (H, W) in the file's unit, 0 where unknown."""
    if path.suffix != ".bin":
        return read_depth(path)
    import pycolmap  # an extra

    depth = pycolmap.DepthMap()
    try:
        depth.read(path)
    except (ValueError, RuntimeError, OSError) as error:
        raise UserError(f"depth map {path} cannot be read: {str(error).splitlines()[0]}") from None
    values = np.asarray(depth.to_array(), np.float32)
    return np.where(np.isfinite(values) & (values > 0), values, np.float32(0.0))


def _fitted(
    shot: Shot, camera: Camera, image: Float32, depth: Float32 | None, size: tuple[int, int]
) -> tuple[Camera, Float32, Float32 | None]:
    if abs(size[1] * camera.height / (size[0] * camera.width) - 1.0) > ALIKE:
        raise UserError(
            f"{shot.image} is {camera.width} x {camera.height} pixels, of other proportions than the first picture; "
            "leave out upright pictures among wide ones, or crop all alike"
        )
    image = image if image.shape[:2] == size else resized(image, size)
    return scaled_camera(camera, size), image, None if depth is None else nearest(depth, size)


def scaled_camera(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the camera of a picture that was brought to (height, width)."""
    x, y = size[1] / camera.width, size[0] / camera.height
    return Camera(
        width=size[1], height=size[0], fx=camera.fx * x, fy=camera.fy * y, cx=camera.cx * x, cy=camera.cy * y,
        c2w=matrix4(camera.pose()),
    )  # fmt: skip


def nearest(values: Float32, size: tuple[int, int]) -> Float32:
    """Bring (H, W) to (height, width) by the nearest pixel: depths must not be mixed across outlines."""
    rows, columns = (
        ((np.arange(new) + 0.5) * old / new).astype(np.int64) for new, old in zip(size, values.shape, strict=True)
    )
    return values[np.ix_(rows, columns)]
