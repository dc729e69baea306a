"""Lenses as COLMAP names them, and pictures with their distortion taken out."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates

from multilight.datagen.errors import UserError
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera

ONE_FOCAL = {"SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"}
"""COLMAP's models with one focal length for both axes."""


@dataclass(frozen=True)
class Lens:
    """A camera model of COLMAP with its parameters, in pixels: focal length(s), principal point, then distortion."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    @property
    def pinhole(self) -> tuple[float, float, float, float]:
        """Return fx, fy, cx, cy."""
        first = self.params[:1] * 2 if self.model in ONE_FOCAL else self.params[:2]
        cx, cy = self.params[self._focals : self._focals + 2]
        return *first, cx, cy  # type: ignore[return-value]

    @property
    def distortion(self) -> tuple[float, ...]:
        """Return the parameters of the distortion."""
        return self.params[self._focals + 2 :]

    @property
    def _focals(self) -> int:
        return 1 if self.model in ONE_FOCAL else 2

    def scaled(self, width: int, height: int) -> "Lens":
        """Return the lens of the same picture at another size."""
        x, y = width / self.width, height / self.height
        factors = (x, y, x, y) if self._focals == 2 else (x, x, y)
        params = tuple(p * f for p, f in zip(self.params, factors, strict=False))
        return replace(self, width=width, height=height, params=params + self.distortion)


def undistorted(
    lens: Lens, c2w: Float64, image: Float32, depth: Float32 | None
) -> tuple[Camera, Float32, Float32 | None]:
    """Turn a picture (H, W, 3), and its z_depth (H, W), into those of a pinhole without blank borders.

    z_depth stays what it is: it is measured along the axis, which distortion does not move.
    """
    fx, fy, cx, cy = lens.pinhole
    if not any(lens.distortion) and "FISHEYE" not in lens.model:
        found = Camera(width=lens.width, height=lens.height, fx=fx, fy=fy, cx=cx, cy=cy, c2w=matrix4(c2w))
        return found, image, depth
    import pycolmap

    try:
        bent = pycolmap.Camera(model=lens.model, width=lens.width, height=lens.height, params=list(lens.params))
        straight = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), bent)
    except (ValueError, RuntimeError) as error:
        raise UserError(f"a lens {lens.model} with {list(lens.params)} cannot be undistorted: {error}") from None
    fx, fy, cx, cy = straight.params
    camera = Camera(width=straight.width, height=straight.height, fx=fx, fy=fy, cx=cx, cy=cy, c2w=matrix4(c2w))
    x, y = np.meshgrid((np.arange(camera.width) + 0.5 - cx) / fx, (np.arange(camera.height) + 0.5 - cy) / fy)
    pixels = bent.img_from_cam(np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=-1))
    at = pixels.reshape(*x.shape, 2)[..., ::-1].transpose(2, 0, 1) - 0.5  # rows, columns
    planes = [map_coordinates(image[..., c], at, order=1, mode="nearest") for c in range(3)]
    moved = None if depth is None else map_coordinates(depth, at, order=0, mode="constant")
    return camera, np.stack(planes, axis=-1), moved
