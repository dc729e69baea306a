"""Every flat place on a piece of furniture where something can stand: tops and open shelves below them."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.scenes.arrays import Float64, Mask
from multilight.scenes.geometry.support_surfaces import SupportSurface, as_trimesh, largest_region
from multilight.scenes.meshes import Mesh, triangle_crosses

CELL = 0.015
FLATNESS = 0.0005
"""How far [m] cells of one surface may lie above or below its height."""
HEADROOM = 0.12
"""Least free height [m] above a shelf."""
SMALLEST = 0.16
"""Side [m] of the square that a shelf holds at least."""
LEAST_AREA = 0.025
"""Least area [m²] of upward faces that make a level."""


@dataclass(frozen=True)
class Shelf:
    """A surface in the mesh's frame and the free height [m] above all of it (inf for a top)."""

    surface: SupportSurface
    headroom: float


def find_shelves(mesh: Mesh) -> list[Shelf]:
    """Find the free level regions, one a level, that hold a square of `SMALLEST` and are open above or before.

    A level's cells are free where a ray from `HEADROOM` above comes down on it; below a top, a ray towards -Y, the
    front, must leave the furniture: what lies behind doors is no shelf.
    """
    solid = as_trimesh(mesh)
    caster = RayMeshIntersector(solid)
    low, high = mesh.bounds().astype(np.float64)
    count = np.maximum(np.ceil((high - low)[:2] / CELL).astype(int), 1)
    x, y = np.meshgrid(*(low[i] + (np.arange(count[i]) + 0.5) * CELL for i in (0, 1)))
    part_of_face = mesh.part_of_face()
    shelves = []
    for level in _levels(solid):
        start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, level + HEADROOM)])
        face = caster.intersects_first(start, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
        flat = (face >= 0) & (np.abs(solid.triangles[face][:, :, 2] - level) <= FLATNESS).all(axis=1)
        free = np.full(x.size, np.inf)
        free[flat] = _distance_up(caster, solid, start[flat] - [0, 0, HEADROOM - 0.004])
        covered = np.flatnonzero(flat & np.isfinite(free))
        if len(covered):
            ahead = start[covered] - [0, 0, HEADROOM - 0.05]
            flat[covered] = caster.intersects_first(ahead, np.tile([0.0, -1.0, 0.0], (len(ahead), 1))) < 0
        region = _largest_region(flat.reshape(x.shape), int(np.ceil(SMALLEST / CELL)))
        if region is None:
            continue
        cells = region.ravel()
        part = int(np.bincount(part_of_face[face[cells]]).argmax())
        shelves.append(Shelf(SupportSurface(level, low[:2], CELL, region, part), float(free[cells].min())))
    return shelves


def _levels(solid: Trimesh) -> list[float]:
    """Return the heights [m] at which enough faces look up, lowest first, those within a centimetre joined."""
    cross = triangle_crosses(solid.triangles)
    area = np.linalg.norm(cross, axis=1) / 2
    level = (np.abs(cross[:, 2]) > 1.96 * area) & (area > 0)
    heights = solid.triangles[level][:, :, 2].max(axis=1)
    keys, inverse = np.unique(np.round(heights, 3), return_inverse=True)
    total = np.bincount(inverse, weights=area[level], minlength=len(keys))
    found: list[float] = []
    for key, size in zip(keys[::-1], total[::-1], strict=True):
        if size >= LEAST_AREA and key > 0.03 and all(abs(key - other) > 0.012 for other in found):
            found.append(float(heights[inverse == np.flatnonzero(keys == key)[0]].max()))
    return found[::-1]


def _distance_up(caster: RayMeshIntersector, solid: Trimesh, points: Float64) -> Float64:
    """Return how far it is from points (N, 3) up to the next face [m], inf where there is none."""
    if not len(points):
        return np.empty(0)
    face = caster.intersects_first(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    height = solid.triangles[face][:, :, 2].min(axis=1) - points[:, 2]
    return np.where(face >= 0, np.maximum(height, 0.0), np.inf)


def _largest_region(flat: Mask, side: int) -> Mask | None:
    """Return the largest connected region that holds a square of `side` cells; None where there is none."""
    if not ndimage.binary_erosion(np.pad(flat, 1), np.ones((side, side))).any():
        return None
    region = largest_region(flat)
    return region if ndimage.binary_erosion(np.pad(region, 1), np.ones((side, side))).any() else None
