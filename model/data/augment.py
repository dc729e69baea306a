"""Augmentation: what another camera, held otherwise, would have made of the same scene."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from multilight.scenes.arrays import Float32, Float64

EXPOSURE, WHITE_BALANCE = 0.5, 0.12
"""Ranges: exposure in EV; white balance as the natural logarithm of the red and blue gains against green."""
RESPONSE, RESPONSE_COLOUR = 0.2, 0.04
"""Largest departure of a camera's response curve from the plain one, of all channels and of each."""
PAINT, PAINT_COLOUR, PAINTED = 0.35, 0.15, (0.4, 1.8)
"""Standard deviations of the logarithm of an object's new colour over its old one, of all channels and of each, and its
range: what a light did to an object must not be read off what object it is."""
SMALLEST_CROP = 0.6
"""Smallest side of a crop against the picture's shorter side."""


@dataclass(frozen=True)
class CameraResponse:
    """How a picture is taken.

    `gain` (3,) float32 multiplies linear radiance (exposure and white balance); `bend` (2, 3) float32 shapes the
    display-encoded values v as v + v (1 - v) (bend[0] + bend[1] (2 v - 1)), which is monotone where the absolute
    values sum to less than one.
    """

    gain: Float32
    bend: Float32


@dataclass(frozen=True)
class Crop:
    """Which part of a picture is kept: a square of `side` pixels with its corner at (left, top), mirrored or not."""

    left: int
    top: int
    side: int
    mirrored: bool = False


PLAIN = CameraResponse(np.ones(3, np.float32), np.zeros((2, 3), np.float32))


def draw_camera(rng: np.random.Generator) -> CameraResponse:
    """Draw exposure, white balance and response curve."""
    balance = rng.uniform(-WHITE_BALANCE, WHITE_BALANCE, 2)
    gain = 2.0 ** rng.uniform(-EXPOSURE, EXPOSURE) * np.exp([balance[0], 0.0, balance[1]])
    bend = rng.uniform(-RESPONSE, RESPONSE, (2, 1)) + rng.uniform(-RESPONSE_COLOUR, RESPONSE_COLOUR, (2, 3))
    return CameraResponse(gain.astype(np.float32), bend.astype(np.float32))


def draw_paint(rng: np.random.Generator) -> Float32:
    """Draw what an object's colour is multiplied by in red, green and blue, (3,): its own three times in ten."""
    if rng.random() < 0.3:
        return np.ones(3, np.float32)
    paint = np.exp(rng.normal(0.0, PAINT) + rng.normal(0.0, PAINT_COLOUR, 3))
    return np.clip(paint, *PAINTED).astype(np.float32)


def respond(encoded: Tensor, camera: CameraResponse) -> Tensor:
    """Bend display-encoded values (..., 3, h, w) in [0, 1] as the camera does, in place."""
    if not camera.bend.any():
        return encoded
    lift, contrast = (torch.from_numpy(row).view(3, 1, 1) for row in camera.bend)
    # The polynomial in Horner's form: one pass a coefficient.
    bent = (encoded * (-2.0 * contrast)).add_(3.0 * contrast - lift).mul_(encoded).add_(1.0 + lift - contrast)
    return encoded.mul_(bent)


def centre_crop(height: int, width: int) -> Crop:
    """Return the largest square about the centre."""
    side = min(height, width)
    return Crop((width - side) // 2, (height - side) // 2, side)


def draw_crop(rng: np.random.Generator, mask: NDArray[np.floating], *, mirrored: bool) -> Crop:
    """Draw a square crop of a picture that keeps the centre of the object, whose coverage `mask` (H, W) is."""
    height, width = mask.shape
    side = round(min(height, width) * float(rng.uniform(SMALLEST_CROP, 1.0)))
    total = float(mask.sum())
    corner = []
    for axis, length in ((1, width), (0, height)):
        centre = float(mask.sum(axis=1 - axis) @ (np.arange(length) + 0.5)) / total if total > 0 else length / 2
        low, high = max(0, int(np.ceil(centre - 0.9 * side))), min(length - side, int(centre - 0.1 * side))
        corner.append(int(rng.integers(low, high + 1)) if low < high else min(max(low, 0), length - side))
    return Crop(corner[0], corner[1], side, mirrored)


def cropped(picture: Tensor, crop: Crop) -> Tensor:
    """Crop (C, H, W) to a frame and mirror it: (C, side, side)."""
    cut = picture[:, crop.top : crop.top + crop.side, crop.left : crop.left + crop.side]
    return cut.flip(-1) if crop.mirrored else cut


def resize(picture: Tensor, size: int, *, nearest: bool = False) -> Tensor:
    """Resize (C, h, h) to (C, size, size), pixel edges kept.

    `nearest` keeps values apart (depth); else bilinear, with the filter widened where the picture shrinks.
    """
    if picture.shape[-1] == size:
        return picture
    if nearest:
        return functional.interpolate(picture[None], size=(size, size), mode="nearest-exact")[0]
    shrinks = size < picture.shape[-1]
    return functional.interpolate(picture[None], size=(size, size), mode="bilinear", antialias=shrinks)[0]


def cropped_camera(intrinsics: Float64, c2w: Float64, crop: Crop, size: int) -> tuple[Float32, Float32]:
    """Return K (3, 3) and c2w (4, 4) of the cropped picture, float32.

    A mirrored picture is that of the world mirrored in the plane x = 0, seen by the mirrored camera: c2w' = M c2w M
    with M = diag(-1, 1, 1, 1), so that the views of a group still agree with each other.
    """
    moved = np.array([[1.0, 0.0, -crop.left], [0.0, 1.0, -crop.top], [0.0, 0.0, 1.0]]) @ intrinsics
    moved[:2] *= size / crop.side
    pose = c2w
    if crop.mirrored:
        moved[0, 2] = size - moved[0, 2]
        mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
        pose = mirror @ c2w @ mirror
    return moved.astype(np.float32), pose.astype(np.float32)
