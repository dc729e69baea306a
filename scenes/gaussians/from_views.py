"""Gaussians on the surfaces that a scene's views see, in the order of a Hilbert curve, folded onto a square map.

How the Gaussians come about: each view's depth is unprojected, pixels of the environment are dropped, the points of
insertable object 0, object 1, ..., then all others are thinned evenly to as many as the map has cells, and sorted
along the 3D Hilbert curve over their bounding box (MV-CoLight, Ren et al. 2025, section 3.3, and its
`proj_dtc_multilight.py`). Within a group a view's pixels are counted along a 2D Hilbert curve, so that every n-th of
them stands for a compact patch: counted row by row, what is left would be stripes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from multilight.scenes.arrays import Float32, Float64, Int64
from multilight.scenes.cameras.pinhole import pixel_rays, unproject
from multilight.scenes.gaussians.curves import curve_order, fold, hilbert_index
from multilight.scenes.spec import Camera

OPACITY = 1.0
"""Opaque: renderers of Gaussians cap what one of them covers at 0.99 or so."""
WIDTH = 0.6
"""Standard deviation of a disc over the spacing of the discs."""
THICKNESS = 0.05
"""Standard deviation of a disc along its normal over its smaller one across."""
STRETCH = 6.0
"""The most that a disc seen at a grazing angle is drawn out along the surface."""
NEIGHBOURS = 8


@dataclass(frozen=True)
class Gaussians:
    """Gaussians of one colour each, all float32.

    means (N, 3) world, metres; quats (N, 4) wxyz, unit, world from the Gaussian's axes; scales (N, 3) standard
    deviations along those axes, metres; opacities (N,) in [0, 1]; colors (N, 3), in whatever encoding the views had.
    """

    means: Float32
    quats: Float32
    scales: Float32
    opacities: Float32
    colors: Float32

    def __len__(self) -> int:
        return len(self.means)


@dataclass(frozen=True)
class SceneGaussians:
    """A scene's Gaussians in curve order, with where each came from and where it goes.

    sources (N, 2) int32: view index, flat row-major pixel index in that view; objects (N,) int16: index into the
    scene's insertable objects, -1 for the rest; cells (N, 2) int64: row and column in the `side` x `side` map.
    """

    gaussians: Gaussians
    sources: NDArray[np.int32]
    objects: NDArray[np.int16]
    cells: Int64

    @property
    def side(self) -> int:
        """Cells a side of the map."""
        return int(np.sqrt(len(self.cells)))

    def to_map(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """Lay values (N, ...) out on the map: (side, side, ...), same type."""
        folded = np.empty((self.side, self.side, *values.shape[1:]), values.dtype)
        folded[self.cells[:, 0], self.cells[:, 1]] = values
        return folded


@dataclass(frozen=True)
class _Pixels:
    """What the views see, V x H x W flattened to V x P: points and unit normals (V, P, 3), pixel sizes (V, P) [m].

    `groups` (V, P): index of the insertable object, K for the rest, -1 where there is nothing.
    """

    points: Float64
    normals: Float64
    footprints: Float64
    groups: Int64


def gaussians_from_views(
    cameras: Sequence[Camera],
    z_depths: ArrayLike,
    instance_ids: ArrayLike,
    object_ids: Sequence[int],
    *,
    side: int = 256,
    normals: ArrayLike | None = None,
) -> SceneGaussians:
    """Make side * side Gaussians from the depth of a scene's views, grey until they are given their sources' colours.

    z_depths (V, H, W) metres, 0 where there is nothing; instance_ids (V, H, W); `object_ids` are the instance ids
    of the insertable objects, in order; normals (V, H, W, 3) unit, world (found from the depth, unless given).
    Where the views hold fewer points than the map has cells, points come up more than once. Flat discs lie on the
    surface, as wide as the points are apart, so that rendering them gives the views back. Raises `ValueError` where
    shapes disagree, nothing is seen, or `side` is not a power of two.
    """
    cells = fold(side)
    depths, ids = np.asarray(z_depths, np.float64), np.asarray(instance_ids)
    if depths.ndim != 3 or depths.shape != ids.shape or len(depths) != len(cameras):
        raise ValueError(f"{len(cameras)} cameras, depths of shape {depths.shape} and ids of shape {ids.shape}")
    pixels = _pixels(cameras, depths, ids, object_ids, normals)
    views, flat, groups, thinning = _thin(pixels.groups, depths.shape[1:], len(object_ids), side * side)
    order = curve_order(pixels.points[views, flat])
    views, flat, groups = views[order], flat[order], groups[order]
    eyes = np.stack([camera.pose()[:3, 3] for camera in cameras])[views]
    means = pixels.points[views, flat]
    scales, quats = _discs(means, means - eyes, pixels.normals[views, flat], pixels.footprints[views, flat], thinning)
    gaussians = Gaussians(
        means=means.astype(np.float32),
        quats=quats.astype(np.float32),
        scales=scales.astype(np.float32),
        opacities=np.full(len(means), OPACITY, np.float32),
        colors=np.full((len(means), 3), 0.5, np.float32),
    )
    sources = np.stack([views, flat], axis=-1).astype(np.int32)
    objects = np.where(groups < len(object_ids), groups, -1).astype(np.int16)
    return SceneGaussians(gaussians, sources, objects, cells)


def normals_from_depth(camera: Camera, z_depth: ArrayLike) -> Float64:
    """Find surface normals (H, W, 3) from z_depth (H, W), unit, world, facing the camera.

    Of the two neighbours along each image axis the one at the more similar depth counts, so that outlines do not
    bend the normals beside them. Where there is nothing, or no neighbour, the normal faces the camera.
    """
    depth = np.asarray(z_depth, np.float64)
    points = unproject(camera, depth)
    normals = np.cross(_step(points, depth, 0), _step(points, depth, 1))
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    towards = -pixel_rays(camera)[1]
    normals = np.where(length > 0, normals / np.where(length > 0, length, 1.0), towards)
    return np.where(np.sum(normals * towards, axis=-1, keepdims=True) < 0, -normals, normals)


def _step(points: Float64, depth: Float64, axis: int) -> Float64:
    """Return the difference to the neighbour at the more similar depth along an image axis, forwards, (H, W, 3)."""
    pad = [(1, 1) if a == axis else (0, 0) for a in range(2)]
    differences = np.diff(points, axis=axis)
    jumps = np.abs(np.diff(depth, axis=axis))
    seen = np.minimum(np.delete(depth, 0, axis), np.delete(depth, -1, axis)) > 0
    jumps = np.pad(np.where(seen, jumps, np.inf), pad, constant_values=np.inf)
    differences = np.pad(differences, [*pad, (0, 0)])
    count = depth.shape[axis]
    before, after = np.arange(count), np.arange(1, count + 1)
    jump_before, jump_after = np.take(jumps, before, axis), np.take(jumps, after, axis)
    chosen = np.where(
        (jump_before < jump_after)[..., None], np.take(differences, before, axis), np.take(differences, after, axis)
    )
    return np.where(np.isfinite(np.minimum(jump_before, jump_after))[..., None], chosen, 0.0)


def _pixels(
    cameras: Sequence[Camera],
    depths: Float64,
    ids: NDArray[np.generic],
    object_ids: Sequence[int],
    normals: ArrayLike | None,
) -> _Pixels:
    count = len(cameras)
    groups = np.full(ids.shape, len(object_ids), np.int64)
    for number, instance in enumerate(object_ids):
        groups[ids == instance] = number
    groups[~(depths > 0)] = -1
    if normals is None:
        found = np.stack([normals_from_depth(c, d) for c, d in zip(cameras, depths, strict=True)])
    else:
        found = np.asarray(normals, np.float64)
    focal = np.array([np.sqrt(camera.fx * camera.fy) for camera in cameras])
    return _Pixels(
        points=np.stack([unproject(c, d) for c, d in zip(cameras, depths, strict=True)]).reshape(count, -1, 3),
        normals=found.reshape(count, -1, 3),
        footprints=(depths / focal[:, None, None]).reshape(count, -1),
        groups=groups.reshape(count, -1),
    )


def _thin(groups: Int64, shape: tuple[int, ...], objects: int, wanted: int) -> tuple[Int64, Int64, Int64, float]:
    """Choose `wanted` pixels, evenly: views, flat pixel indices, groups, and how many pixels each stands for."""
    rows, columns = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    bits = max(int(max(shape) - 1).bit_length(), 1)
    along = np.argsort(hilbert_index(np.stack([rows, columns], axis=-1), bits))
    ordered = groups[:, along]
    found = [np.nonzero(ordered == group) for group in range(objects + 1)]
    views, places = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if len(views) == 0:
        raise ValueError("no view sees anything but the environment: there is nothing to put Gaussians on")
    kept = np.linspace(0, len(views) - 1, wanted).astype(np.int64)
    chosen, flat = views[kept], along[places[kept]]
    return chosen, flat, groups[chosen, flat], max(len(views) / wanted, 1.0)


def _discs(
    means: Float64, rays: Float64, normals: Float64, footprints: Float64, thinning: float
) -> tuple[Float64, Float64]:
    """Lay discs on the surface that close it: standard deviations (N, 3) in metres and quaternions (N, 4) wxyz.

    A pixel that stands for `thinning` others covers an ellipse, drawn out along the view by 1 / cosine. Where the
    other views' points lie denser than that, both axes shrink alike, to the area that a point has there.
    """
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    facing = np.linalg.norm(normals, axis=-1, keepdims=True) < 0.5
    normals = np.where(facing, -rays, normals)
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    cosine = np.sum(normals * rays, axis=-1, keepdims=True)
    along = rays - cosine * normals
    # Seen from straight ahead no direction is drawn out, so any one will do.
    level = np.linalg.norm(along, axis=-1, keepdims=True)
    any_axis = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
    along = np.where(level > 1e-6, along, np.cross(normals, any_axis))
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along), normals], axis=-1)
    quats = np.roll(Rotation.from_matrix(axes).as_quat(), 1, axis=-1)
    stretch = 1.0 / np.maximum(np.abs(cosine[:, 0]), 1.0 / STRETCH)
    spacing = np.sqrt(thinning) * footprints
    spacing *= np.sqrt(np.minimum(_free_area(means) / (spacing**2 * stretch), 1.0))
    across = WIDTH * spacing
    return np.stack([across * stretch, across, THICKNESS * across], axis=-1), quats


def _free_area(means: Float64) -> Float64:
    """Return the area (N,) in square metres that each point has to itself, from its nearest neighbours' distance."""
    points, first = np.unique(means, axis=0, return_inverse=True)
    neighbours = min(NEIGHBOURS, len(points) - 1)
    if neighbours == 0:
        return np.full(len(means), np.inf)
    distances = cKDTree(points).query(points, k=[neighbours + 1])[0][:, 0]
    return np.asarray(np.pi * distances[first.reshape(-1)] ** 2 / neighbours)
