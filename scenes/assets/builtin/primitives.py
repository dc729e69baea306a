"""Closed surfaces made by formula: lathe, cylinder, sphere, torus, tube, rounded box, bar, prism.

Lengths are metres; uv runs in metres along the surface unless said otherwise, so that a texture keeps its
real scale. Edges are rounded, normals are smooth across the rounding and true on flats.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.meshes import stacked, triangle_crosses

SEAM = 0.1
"""The circumference of a lathe is rounded to a multiple of this [m]: textures of that size (or a part) meet."""

CREASE = 0.7
"""Angle [rad] beyond which a corner of a profile is an edge."""


@dataclass(frozen=True)
class Surface:
    """Triangles: vertices (V, 3) m, faces (F, 3) counter-clockwise from outside, normals (V, 3), uv."""

    vertices: Float64
    faces: Int64
    normals: Float64
    uv: Float64

    def moved(self, offset: ArrayLike = (0.0, 0.0, 0.0), rotation: ArrayLike | None = None) -> "Surface":
        """Rotate by a 3x3 matrix, then shift [m]."""
        matrix = np.eye(3) if rotation is None else np.asarray(rotation, np.float64)
        moved = self.vertices @ matrix.T + np.asarray(offset)
        return Surface(moved, self.faces, self.normals @ matrix.T, self.uv)

    def at_corners(self, x: float, y: float) -> list["Surface"]:
        """Return four copies, one in each corner (±x, ±y) [m]."""
        return [self.moved((sx * x, sy * y, 0)) for sx in (-1, 1) for sy in (-1, 1)]


def merge(surfaces: Sequence[Surface]) -> Surface:
    """Join surfaces into one."""
    return Surface(
        *stacked((s.vertices, s.faces) for s in surfaces),
        np.concatenate([s.normals for s in surfaces]),
        np.concatenate([s.uv for s in surfaces]),
    )


def rotation(axis: str, angle: float) -> Float64:
    """Return the 3x3 rotation by `angle` [rad], counter-clockwise, about `x`, `y` or `z`."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = np.cos(angle)
    matrix[j, i] = np.sin(angle)
    matrix[i, j] = -np.sin(angle)
    return matrix


def circle(count: int, radius: float | Float64 = 1.0, *, start: float = 0.0) -> Float64:
    """Return points at even angles round the origin, counter-clockwise from `start` [rad], (count, 2).

    `radius` [m] is one for all or (count,).
    """
    angle = start + 2 * np.pi * np.arange(count) / count
    return np.reshape(radius, (-1, 1)) * np.stack([np.cos(angle), np.sin(angle)], -1)


def from_grid(points: Float64, normals: Float64, uv: Float64) -> Surface:
    """Triangulate an (M, N) grid of points; faces look where the normals do, slivers are dropped."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    flat, flat_normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    cross = triangle_crosses(flat[faces])
    inward = np.einsum("fi,fi->f", cross, flat_normals[faces].sum(axis=1)) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Surface(flat, faces[np.linalg.norm(cross, axis=1) > 1e-12], flat_normals, uv.reshape(-1, 2))


def rounded(corners: ArrayLike, radius: ArrayLike, *, closed: bool = False, steps: int = 6) -> Float64:
    """Round the corners of a 2-D polyline with arcs.

    `corners` (N, 2), `radius` one for all or (N,); an arc never takes more than half of a neighbouring edge.
    """
    points = np.asarray(corners, np.float64)
    radii = np.broadcast_to(np.asarray(radius, np.float64), len(points))
    result: list[Float64] = []
    for i, point in enumerate(points):
        if (not closed and i in (0, len(points) - 1)) or radii[i] <= 0:
            result.append(point[None])
            continue
        to_before, to_after = points[i - 1] - point, points[(i + 1) % len(points)] - point
        length = min(float(np.linalg.norm(to_before)), float(np.linalg.norm(to_after)))
        u, w = to_before / np.linalg.norm(to_before), to_after / np.linalg.norm(to_after)
        half = 0.5 * np.arccos(np.clip(u @ w, -1, 1))
        if half > np.pi / 2 - 1e-3:
            result.append(point[None])
            continue
        tangent = min(radii[i] / np.tan(half), 0.49 * length)
        centre = point + (u + w) / np.linalg.norm(u + w) * tangent / np.cos(half)
        start, end = point + u * tangent - centre, point + w * tangent - centre
        sweep = np.arctan2(start[0] * end[1] - start[1] * end[0], start @ end)
        angles = np.linspace(0, sweep, steps + 1)[:, None]
        result.append(centre + start * np.cos(angles) + np.array([-start[1], start[0]]) * np.sin(angles))
    return np.concatenate(result)


def _profile(points: Float64) -> tuple[Float64, Float64, Float64]:
    """Give each point of a 2-D profile its right-hand normal; corners sharper than `CREASE` are split.

    Normals are averaged by edge length, so that long flats keep theirs. Returns points, normals, arc length.
    """
    points = points[np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9]]
    edges = np.diff(points, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    sides = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / lengths[:, None]
    position = np.r_[0, np.cumsum(lengths)]
    where, normals = [0], [sides[0]]
    for i in range(1, len(points) - 1):
        if sides[i - 1] @ sides[i] < np.cos(CREASE):
            where += [i, i]
            normals += [sides[i - 1], sides[i]]
        else:
            mean = lengths[i - 1] * sides[i - 1] + lengths[i] * sides[i]
            where.append(i)
            normals.append(mean / np.linalg.norm(mean))
    where.append(len(points) - 1)
    normals.append(sides[-1])
    return points[where], np.array(normals), position[where]


def lathe(
    profile: ArrayLike, *, segments: int = 64, planar_uv: bool = False, lobes: int = 0, depth: float = 0.0
) -> Surface:
    """Rotate a profile of (radius, z) points about +Z.

    The outside lies to the right of the profile: run it from the axis at the bottom, up the outer wall, and
    back down inside. uv is (around, along) in metres, or (x, y) if `planar_uv`. The radius swells by
    `1 + depth cos(lobes phi)`.
    """
    points, normals, along = _profile(np.asarray(profile, np.float64))
    normals[(points[:, 0] < 1e-9) & (np.abs(normals[:, 0]) < 0.5), 0] = 0.0
    phi = np.linspace(0, 2 * np.pi, segments + 1)
    swell, slope = 1 + depth * np.cos(lobes * phi), -depth * lobes * np.sin(lobes * phi)
    cos, sin = np.cos(phi), np.sin(phi)
    r, z = points[:, :1], points[:, 1:]
    grid = np.stack(np.broadcast_arrays(r * swell * cos, r * swell * sin, z), -1)
    n_r, n_z = normals[:, :1], normals[:, 1:]
    bend = slope / swell
    direction = np.stack([n_r * (cos + bend * sin), n_r * (sin - bend * cos), n_z * swell], -1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    around = max(1, round(2 * np.pi * float(points[:, 0].max()) / SEAM)) * SEAM
    if planar_uv:
        return from_grid(grid, direction, grid[..., :2])
    uv = np.stack(np.broadcast_arrays(phi / (2 * np.pi) * around, along[:, None]), -1)
    return from_grid(grid, direction, uv)


def cylinder(
    radius: float, height: float, bevel: float = 0.0, *, segments: int = 64, planar_uv: bool = False
) -> Surface:
    """Make a cylinder that stands on z = 0, its rims rounded."""
    profile = rounded([(0, 0), (radius, 0), (radius, height), (0, height)], bevel)
    return lathe(profile, segments=segments, planar_uv=planar_uv)


def sphere(radius: float, *, segments: int = 48) -> Surface:
    """Make a sphere that stands on z = 0."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    return lathe(np.stack([radius * np.cos(angle), radius + radius * np.sin(angle)], -1), segments=segments)


def torus(major: float, minor: float, *, segments: int = 64) -> Surface:
    """Make a ring that lies on z = 0; `major` is the radius of its centre line."""
    phi = np.linspace(0, 2 * np.pi, segments + 1)[None]
    theta = np.linspace(-np.pi, np.pi, segments // 2 + 1)[:, None]
    zero = np.zeros_like(theta + phi)
    normals = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta) + zero], -1)
    centres = np.stack([major * np.cos(phi) + zero, major * np.sin(phi) + zero, minor + zero], -1)
    around = max(1, round(2 * np.pi * major / SEAM)) * SEAM
    uv = np.stack([phi / (2 * np.pi) * around + zero, theta * minor + zero], -1)
    return from_grid(centres + minor * normals, normals, uv)


def _frames(path: Float64) -> tuple[Float64, Float64, Float64]:
    """Carry a frame along a path with the least twist: tangents and two sides, (N, 3) each."""
    tangents = np.gradient(path, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    sides = []
    for tangent in tangents:
        side = side - (side @ tangent) * tangent
        side = side / np.linalg.norm(side)
        sides.append(side)
    first = np.array(sides)
    return tangents, first, np.cross(tangents, first)


def tube(path: ArrayLike, radius: float, *, segments: int = 20, flatten: float = 1.0) -> Surface:
    """Sweep a circle along a path (N, 3) and round its ends; `flatten` scales the section's second axis."""
    centres = np.asarray(path, np.float64)
    tangents, first, second = _frames(centres)
    cap = np.linspace(0, np.pi / 2, 7)[:-1]
    head, tail = radius * np.cos(cap), radius * np.cos(cap[::-1])
    ends = centres[0] - head[:, None] * tangents[0], centres[-1] + tail[:, None] * tangents[-1]
    centres = np.concatenate([ends[0], centres, ends[1]])
    radii = np.concatenate([radius * np.sin(cap), np.full(len(tangents), radius), radius * np.sin(cap[::-1])])
    first, second, tangents = (np.pad(a, ((6, 6), (0, 0)), mode="edge") for a in (first, second, tangents))
    along = np.r_[0, np.cumsum(np.linalg.norm(np.diff(centres, axis=0), axis=1))]
    edges = np.stack([np.gradient(radii), np.gradient(along)], -1)
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    phi = np.linspace(0, 2 * np.pi, segments + 1)
    cos, sin = np.cos(phi)[None, :, None], np.sin(phi)[None, :, None]
    points = centres[:, None] + radii[:, None, None] * (first[:, None] * cos + flatten * second[:, None] * sin)
    outward = first[:, None] * cos + second[:, None] * sin / flatten
    normals = outward * edges[:, 1, None, None] - tangents[:, None] * edges[:, 0, None, None]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    around = phi / (2 * np.pi) * 2 * np.pi * radius
    return from_grid(points, normals, np.stack(np.broadcast_arrays(around, along[:, None]), -1))


def rounded_box(size: ArrayLike, radius: float, *, steps: int = 4) -> Surface:
    """Make a box with rounded edges that stands on z = 0, centred in x and y; uv in metres on each side."""
    half = np.asarray(size, np.float64) / 2
    radius = min(radius, 0.999 * float(half.min()))
    bend = np.tan(np.linspace(0, np.pi / 4, steps + 1)) * radius
    sides = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        a, b = (np.r_[-(half[k] - radius) - bend[::-1], half[k] - radius + bend] for k in (i, j))
        for sign in (-1.0, 1.0):
            cube = np.empty((len(a), len(b), 3))
            cube[..., i], cube[..., j] = np.broadcast_arrays(a[:, None], b)
            cube[..., axis] = sign * half[axis]
            core = np.clip(cube, radius - half, half - radius)
            normals = cube - core
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
            # Upright sides get z as v and the flats (x, y), so that grain runs in one direction on all of them.
            uv = cube[..., list(((1, 2), (0, 2), (0, 1))[axis])]
            sides.append(from_grid(core + radius * normals, normals, uv))
    return merge(sides).moved((0, 0, half[2]))


def bar(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], radius: float = 0.002) -> Surface:
    """Make a box between two corners [m] with slightly rounded edges."""
    low, high = np.transpose([x, y, z])
    size = high - low
    made = rounded_box(size, min(radius, 0.4 * float(size.min())), steps=1)
    return made.moved((low[0] + size[0] / 2, low[1] + size[1] / 2, low[2]))


def bar_pair(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> list[Surface]:
    """Make two bars that mirror each other in x: the right one between two corners [m]."""
    return [bar((-x[1], -x[0]), y, z), bar(x, y, z)]


def prism(outline: ArrayLike, height: float, bevel: float) -> Surface:
    """Extrude a convex, smoothly rounded, counter-clockwise outline (N, 2) along +Z; round both rims."""
    points = np.asarray(outline, np.float64)
    points = points[np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1) > 1e-9]
    edges = np.roll(points, -1, axis=0) - points
    sides = np.stack([edges[:, 1], -edges[:, 0]], -1)
    normals = sides + np.roll(sides, 1, axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points, normals = np.vstack([points, points[:1]]), np.vstack([normals, normals[:1]])
    rim = np.linspace(0, np.pi / 2, 5)
    tilt = np.r_[-rim[::-1], rim]
    level = np.r_[bevel * (1 - np.sin(rim[::-1])), height - bevel * (1 - np.sin(rim))]
    inset = bevel * (1 - np.cos(tilt))
    grid = np.empty((len(tilt), len(points), 3))
    grid[..., :2] = points - inset[:, None, None] * normals
    grid[..., 2] = level[:, None]
    shading = np.empty_like(grid)
    shading[..., :2] = np.cos(tilt)[:, None, None] * normals
    shading[..., 2] = np.sin(tilt)[:, None]
    around = np.r_[0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    wall = from_grid(grid, shading, np.stack(np.broadcast_arrays(around, level[:, None]), -1))
    return merge([wall, _cap(grid[0], -1.0), _cap(grid[-1], 1.0)])


def _cap(ring: Float64, sign: float) -> Surface:
    """Close a flat ring with a fan."""
    fan = np.stack([np.broadcast_to(ring.mean(axis=0), ring.shape), ring])
    normals = np.broadcast_to(np.array([0.0, 0.0, sign]), fan.shape)
    return from_grid(fan, normals, fan[..., :2].copy())
