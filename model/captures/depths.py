"""Depth for captures that have none: from Gaussians, or from a depth model held to the capture's sparse points."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.captures.capture import Capture
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.cameras.pinhole import project
from multilight.scenes.gaussians.ply import read_gaussians
from multilight.scenes.gaussians.splatting import blending_weights
from multilight.scenes.spec import Camera

LEAST_POINTS = 12
"""Sparse points that a view must see for its depth to be aligned."""
COVERED = 0.5
"""Fraction of a pixel that Gaussians must cover for it to have a depth."""
SEEN = 0.1
"""Fraction of a picture's pixels, in the median view, that Gaussians of the same world cover."""


def with_depth(capture: Capture, gaussians: Path | None, depth_model: Path | None) -> Capture:
    """Give a capture depth, from what the user has: Gaussians go first, then its own, then a model's.

    Raises `UserError` with the remedies where there is nothing to take it from.
    """
    if gaussians is not None:
        return replace(capture, z_depths=depth_of_gaussians(capture, gaussians))
    if capture.z_depths is not None:
        return capture
    if depth_model is None:
        raise UserError(
            f"{capture.path} has no depth, and {len(capture.points)} sparse points are too few to hide an object "
            "behind; give --depth-model (ONNX, Depth Anything V2's layout) or --gaussians (a 3DGS PLY trained on the "
            "capture), run COLMAP's patch_match_stereo, or add depth_file_path to the frames"
        )
    return replace(capture, z_depths=depth_from_model(capture, depth_model))


def depth_of_gaussians(capture: Capture, path: Path) -> Float32:
    """Return the mean depth of the Gaussians that each pixel shows, (V, H, W), 0 where they cover less than half."""
    try:
        gaussians = read_gaussians(path)
    except OSError as error:
        raise UserError(f"Gaussians {path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UserError(str(error)) from None
    depths = []
    for camera in capture.cameras:
        z = project(camera, gaussians.means)[1]
        weights = blending_weights(camera, gaussians)
        covered = np.asarray(weights.sum(axis=1)).ravel()
        depth = np.where(covered > COVERED, weights @ np.maximum(z, 0.0) / np.maximum(covered, 1e-6), 0.0)
        depths.append(depth.reshape(camera.height, camera.width).astype(np.float32))
    stacked = np.stack(depths)
    shown = float(np.median((stacked > 0).mean(axis=(1, 2))))
    if shown < SEEN:
        raise UserError(
            f"{path} covers {shown:.0%} of the pictures of {capture.path}: Gaussians and cameras are not of one world; "
            "export both from the same training, without re-centring or scaling"
        )
    return stacked


def depth_from_model(capture: Capture, path: Path) -> Float32:
    """Estimate each view's depth with an ONNX model, and bring it to the capture's unit by its sparse points."""
    from multilight.model.inference.depth import DepthModel

    model = DepthModel.load(path)
    seen = capture.seen or tuple(np.arange(len(capture.points)) for _ in capture.cameras)
    depths = []
    for name, camera, image, numbers in zip(capture.names, capture.cameras, capture.images, seen, strict=True):
        relative = 1.0 / model.estimate(image)
        try:
            depths.append(aligned_depth(camera, relative, capture.points[numbers]))
        except ValueError as error:
            raise UserError(f"{capture.path}: the depth of {name} cannot be aligned: {error}") from None
    return np.stack(depths)


def aligned_depth(camera: Camera, inverse: Float32, points: Float64) -> Float32:
    """Scale and shift relative inverse depth (H, W) so that it fits points (N, 3) that the view sees: z_depth.

    1 / z = scale * inverse + shift, least squares, twice with the worse half of the points left out, since some may
    be hidden in this view. Beyond twice the farthest point depth is unknown (0). Raises `ValueError` where too few
    points lie in the picture, or nearer ones come out as farther.
    """
    pixels, z = project(camera, points)
    inside = (z > 0) & np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
    if inside.sum() < LEAST_POINTS:
        raise ValueError(f"{int(inside.sum())} sparse points lie in it, {LEAST_POINTS} are needed")
    x, y = pixels[inside].astype(np.int64).T
    found, wanted = inverse[y, x].astype(np.float64), 1.0 / z[inside]
    kept = np.ones(len(found), bool)
    for _ in range(3):
        matrix = np.stack([found[kept], np.ones(kept.sum())], axis=1)
        (scale, shift), *_ = np.linalg.lstsq(matrix, wanted[kept], rcond=None)
        errors = np.abs(scale * found + shift - wanted)
        kept = errors <= np.median(errors)
    if not scale > 0:
        raise ValueError("its near points are far in the model's depth")
    result = scale * inverse.astype(np.float64) + shift
    farthest = 2.0 * float(z[inside].max())
    return np.where(result > 1.0 / farthest, 1.0 / np.maximum(result, 1e-12), 0.0).astype(np.float32)
