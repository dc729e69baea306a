"""Where things can stand: the largest free, flat, upward-facing region of a mesh."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.errors import MultilightError
from multilight.scenes.meshes import Mesh, once_a_mesh, read_only, stacked, triangle_crosses

CELL = 0.01
"""Grid [m] on which surfaces are looked for."""
FLATNESS = 0.0015
"""How far [m] cells of one surface may lie above or below its height."""


class SupportError(MultilightError):
    """A mesh offers no usable surface: names the size found and the size needed."""


@dataclass(frozen=True)
class SupportSurface:
    """A flat free region of a mesh, in the mesh's frame, as a grid of square cells.

    height [m]; `origin` (2,) is the lower corner of cell (0, 0) [m]; `cell` is the cells' side [m]; `free`
    (rows along y, columns along x) bool; `part` is the mesh part that lies on top.
    """

    height: float
    origin: Float64
    cell: float
    free: Mask
    part: int

    @cached_property
    def clearance(self) -> Float64:
        """Distance [m] from each cell's centre to the region's edge; 0 outside; same shape as `free`."""
        padded = np.pad(self.free, 1)
        distance = np.maximum(ndimage.distance_transform_edt(padded) - 0.5, 0.0)[1:-1, 1:-1]
        return np.asarray(distance * self.cell, np.float64)

    @cached_property
    def centres(self) -> Float64:
        """Centres of the free cells, (N, 2) float64 metres, row by row."""
        rows, columns = np.nonzero(self.free)
        return self.origin + (np.column_stack([columns, rows]) + 0.5) * self.cell

    @property
    def area(self) -> float:
        """Free area [m²]."""
        return float(self.free.sum() * self.cell**2)

    def edge_distance(self, points: Float64) -> Float64:
        """Distance [m] of points (N, 2) to the region's edge, 0 outside it, to a cell's accuracy."""
        index = np.floor((points - self.origin) / self.cell).astype(int)
        rows, columns = self.free.shape
        inside = (index >= 0).all(axis=1) & (index[:, 0] < columns) & (index[:, 1] < rows)
        result = np.zeros(len(points))
        result[inside] = self.clearance[index[inside, 1], index[inside, 0]]
        return result

    def supports(self, polygon: Float64, margin: float = 0.0) -> bool:
        """Tell whether a convex polygon (N, 2) [m] lies inside the region, `margin` [m] from its edge."""
        following = np.roll(polygon, -1, axis=0)
        steps = np.linspace(0.0, 1.0, max(2, int(np.ceil(np.ptp(polygon, axis=0).max() / self.cell))))
        outline = (polygon[:, None] + steps[:, None] * (following - polygon)[:, None]).reshape(-1, 2)
        centre = polygon.mean(axis=0)
        rings = np.concatenate([centre + scale * (outline - centre) for scale in (1.0, 0.75, 0.5, 0.25, 0.0)])
        return bool((self.edge_distance(rings) > margin).all())


@once_a_mesh
def find_support(mesh: Mesh, *, smallest: float = 0.4) -> SupportSurface:
    """Find the largest free flat region that rays from above reach, `smallest` x `smallest` metres at least.

    Things that stand on the surface, and holes in it, are not part of the region; shelves below it and seats
    beside it lose against the larger top. Raises `SupportError` where no region is large enough.
    """
    low, high = mesh.bounds().astype(np.float64)
    shape = np.maximum(np.ceil((high - low)[:2] / CELL).astype(int), 1)
    columns, rows = (low[i] + (np.arange(shape[i]) + 0.5) * CELL for i in (0, 1))
    heights, parts, upward = _height_map(mesh, columns, rows, float(high[2]) + 1.0)
    best: Mask | None = None
    for level in _levels(heights[upward]):
        flat = upward & (np.abs(heights - level) <= FLATNESS)
        region = largest_region(flat)
        if best is None or region.sum() > best.sum():
            best = region
    side = 0.0 if best is None else largest_square(best) * CELL
    if best is None or side < smallest:
        raise SupportError(f"largest free square is {side:.2f} m, need at least {smallest:.2f} m")
    return SupportSurface(float(heights[best].max()), low[:2], CELL, best, int(np.bincount(parts[best]).argmax()))


def _height_map(mesh: Mesh, columns: Float64, rows: Float64, top: float) -> tuple[Float64, Int64, Mask]:
    """Return height [m], part and whether the surface is level, of what lies on top of each cell (rows, columns)."""
    solid = as_trimesh(mesh)
    x, y = np.meshgrid(columns, rows)
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, top)])
    face = RayMeshIntersector(solid).intersects_first(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    corner = solid.triangles[face, 0]
    normal = solid.face_normals[face] if len(solid.face_normals) == len(solid.faces) else _normals(solid)[face]
    steep = np.abs(normal[:, 2]) < 0.98
    slope = np.where(steep, 1.0, normal[:, 2])
    height = corner[:, 2] - ((origins - corner)[:, :2] * normal[:, :2]).sum(axis=1) / slope
    level = (face >= 0) & ~steep
    return height.reshape(x.shape), mesh.part_of_face()[face].reshape(x.shape), level.reshape(x.shape)


def _normals(solid: Trimesh) -> Float64:
    """Return a normal for every face, zero where a face is degenerate."""
    cross = triangle_crosses(solid.triangles)
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-30))


def _levels(heights: Float64) -> list[float]:
    """Return the three commonest heights [m], to a millimetre's accuracy."""
    if heights.size == 0:
        return []
    rounded, counts = np.unique(np.round(heights, 3), return_counts=True)
    commonest = rounded[np.argsort(-counts, kind="stable")[:3]]
    return [float(np.median(heights[np.abs(heights - level) <= 0.001])) for level in commonest]


def largest_region(free: Mask) -> Mask:
    """Return the largest connected region of the cells that are free; empty where none is."""
    labels, _ = ndimage.label(free)
    return np.asarray(labels == 1 + int(np.argmax(np.bincount(labels.ravel(), minlength=2)[1:])))


def largest_square(region: Mask) -> int:
    """Return the side, in cells, of the largest square inside a region (bisection over a summed-area table)."""
    total = np.pad(region.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    fits, too_large = 0, min(region.shape) + 1
    while too_large - fits > 1:
        side = (fits + too_large) // 2
        inside = total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
        if (inside == side * side).any():
            fits = side
        else:
            too_large = side
    return fits


@once_a_mesh
def stacked_faces(mesh: Mesh) -> Int64:
    """Stack all parts' faces, (F, 3) int64, as indices into `mesh.vertices()`."""
    return read_only(stacked((part.vertices, part.faces) for part in mesh.parts)[1])


def as_trimesh(mesh: Mesh) -> Trimesh:
    """Return all parts of a mesh as one, nothing about it changed."""
    return Trimesh(mesh.vertices(), stacked_faces(mesh), process=False)


@once_a_mesh
def convex_hull(mesh: Mesh) -> Trimesh:
    """Return the convex hull of a mesh."""
    return as_trimesh(mesh).convex_hull


def stands(vertices: Float64, centres: Iterable[Float64], *, contact: float) -> bool:
    """Tell whether a body (vertices (N, 3)) stands: its centres of mass (3,) lie over what touches the ground.

    That is the convex hull, seen from above, of the vertices within `contact` [m] of the lowest.
    """
    carried = convex_polygon(vertices[vertices[:, 2] <= vertices[:, 2].min() + contact, :2])
    return carried is not None and all(inside_convex(carried, centre[:2]) for centre in centres)


def convex_polygon(points: Float64) -> Float64 | None:
    """Return the convex hull of points (N, 2) as a counter-clockwise polygon, or None where it has no area."""
    if len(points) < 3:
        return None
    try:
        return np.asarray(points[ConvexHull(points).vertices], np.float64)
    except QhullError:
        return None


def inside_convex(polygon: Float64, point: Float64) -> bool:
    """Tell whether a point (2,) lies inside a counter-clockwise convex polygon (N, 2)."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    offset = point - polygon
    return bool((edge[:, 0] * offset[:, 1] - edge[:, 1] * offset[:, 0] > 0).all())
