"""The point cloud of a scene, from its views' depth: where splatting and radiance fields may begin."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.scenes.arrays import Float32, Float64, Int64, UInt8
from multilight.scenes.cameras.pinhole import project, unproject
from multilight.scenes.spec import Camera

NEAR_ENOUGH = 0.01
"""Relative difference of depth up to which a view is said to see a point."""


@dataclass(frozen=True)
class ScenePoints:
    """Points on what the views see: xyz (N, 3) float64 world [m], normals (N, 3) float32 unit.

    Each was lifted from the centre of pixel (`x`, `y`) of view `view`, (N,) int64 each.
    """

    xyz: Float64
    normals: Float32
    view: Int64
    x: Int64
    y: Int64

    def colours(self, images: Sequence[UInt8]) -> UInt8:
        """Look the points' colours up in the pictures (H, W, 3) of the views they come from: (N, 3) uint8."""
        return np.stack(images)[self.view, self.y, self.x]


@dataclass(frozen=True)
class Sighting:
    """What one view sees of the points: their indices (M,) int64 and pixels (M, 2) float64, centres at + 0.5."""

    point: Int64
    pixels: Float64


def scene_points(
    cameras: Sequence[Camera],
    depths: Sequence[Float32],
    normals: Sequence[Float32],
    *,
    count: int,
    rng: np.random.Generator,
) -> ScenePoints:
    """Lift at most `count` pixels, drawn evenly over all views from those that see something.

    depths: z_depth (H, W) a view [m], 0 where nothing; normals (H, W, 3), world.
    """
    view, y, x = np.nonzero(np.stack(depths) > 0)
    if len(view) > count:
        chosen = np.sort(rng.choice(len(view), count, replace=False))
        view, y, x = view[chosen], y[chosen], x[chosen]
    lifted = np.stack([unproject(camera, depth) for camera, depth in zip(cameras, depths, strict=True)])
    return ScenePoints(lifted[view, y, x], np.stack(normals)[view, y, x], view, x, y)


def sightings(points: ScenePoints, cameras: Sequence[Camera], depths: Sequence[Float32]) -> list[Sighting]:
    """Say which view sees which point, and where: those in the picture whose depth is the pixel's own within 1 %."""
    found = []
    for number, (camera, stored) in enumerate(zip(cameras, depths, strict=True)):
        pixels, depth = project(camera, points.xyz)
        inside = (depth > 0) & np.all((pixels >= 0) & (pixels < [camera.width, camera.height]), axis=1)
        column, row = np.where(inside[:, None], pixels, 0.0).astype(np.int64).T
        there = stored[row, column]
        seen = inside & (there > 0) & (np.abs(depth - there) <= NEAR_ENOUGH * there)
        seen |= points.view == number  # rounding may carry a pixel's own point out of it
        found.append(Sighting(np.flatnonzero(seen), pixels[seen]))
    return found


def write_ply(path: Path, points: ScenePoints, colours: UInt8) -> None:
    """Write the points as binary PLY: x, y, z, nx, ny, nz (float), red, green, blue (uchar)."""
    kinds = [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    kinds += [(name, "u1") for name in ("red", "green", "blue")]
    rows = np.zeros(len(points.xyz), kinds)
    for i, name in enumerate("xyz"):
        rows[name], rows[f"n{name}"] = points.xyz[:, i], points.normals[:, i]
    for i, name in enumerate(("red", "green", "blue")):
        rows[name] = colours[:, i]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + rows.tobytes())
