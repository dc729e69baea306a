"""A camera as one of Mitsuba's sensors, and the very rays that its renders begin with.

Pictures are rendered one sample a pixel at a time. The place of the sample is random, but the same in every render
with the same seed: a render of two planes tells it, and so what each sample saw first can be looked up.
"""

import math
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.spec import Camera

BLOCK = 32
"""Pixels a side of the renderer's tiles: fixed, because it would else depend on the number of threads."""
CAMERA_AXES = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Mitsuba's cameras look along +Z with +X to the left; ours along -Z with +X to the right."""


@dataclass(frozen=True)
class Rays:
    """The rays of one pass, in world axes: origins and unit directions (N, 3), and the pixel of each (N,).

    A pixel's number counts row by row; -1 lies outside of the picture.
    """

    origins: Float64
    directions: Float64
    pixels: Int64


class Film:
    """A camera's sensor.

    Mitsuba's pixels are square, and a lens of some size looks through the picture's middle. Other cameras render a
    finer grid, fine enough that each of our pixels holds a whole one of it; samples are sorted by where they lie.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
        size = np.array([camera.width, camera.height])
        square = math.isclose(camera.fx, camera.fy, rel_tol=1e-6)
        self._same = square and (camera.aperture_radius == 0 or np.allclose(centre, size / 2))
        if self._same:
            self._focal, self._scale = camera.fx, np.ones(2)
            self._size, self._centre = size, centre
        else:
            self._focal = 2 * max(camera.fx, camera.fy)
            self._scale = self._focal / focal
            self._size = 2 * np.ceil(self._scale * np.maximum(centre, size - centre)).astype(int)
            self._centre = self._size / 2
        self._pose = np.array(camera.c2w)
        self.sensor = self._made(self._pose @ CAMERA_AXES)
        self._own = self._made(CAMERA_AXES)
        self._planes = [self._plane(share * camera.focus_distance) for share in (0.5, 1.0)]
        self._position = mi.load_dict({"type": "aov", "aovs": "p:position", "block_size": BLOCK})
        tiles = np.ceil(self._size / BLOCK).prod() * BLOCK**2
        self._seed_step = math.ceil(tiles / self._size.prod())

    def passes(self, spp: int) -> int:
        """Return how many renders give at least about `spp` samples a pixel."""
        return max(1, round(spp / self._scale.prod()))

    def seed(self, first: int, number: int) -> int:
        """Return the seed of a pass. Mitsuba numbers pixels from `seed` times their count, tile after tile."""
        return (first + number * self._seed_step) % 2**32

    def rays(self, seed: int) -> Rays:
        """Return the rays with which renders of this seed begin."""
        near, far = (
            np.array(self._position.render(plane, self._own, seed=seed, spp=1), np.float64)[..., -3:].reshape(-1, 3)
            for plane in self._planes
        )
        camera, way = self._camera, far - near
        start = near - way * (near[:, 2:] / way[:, 2:])  # on the lens
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        turn = self._pose[:3, :3]
        return Rays(start @ turn.T + self._pose[:3, 3], way @ turn.T, self._pixels(far / camera.focus_distance))

    def summed(self, rays: Rays, values: NDArray[np.floating]) -> Float64:
        """Add up each pixel's samples: values of a pass (..., C), in the order of its rays, to (H, W, C)."""
        channels = values.shape[-1]
        values = values.reshape(-1, channels).astype(np.float64)
        shape = (self._camera.height, self._camera.width, channels)
        if self._same:
            return values.reshape(shape)
        inside = rays.pixels >= 0
        sums = np.empty((shape[0] * shape[1], channels))
        for channel, column in enumerate(values[inside].T):
            sums[:, channel] = np.bincount(rays.pixels[inside], column, len(sums))
        return sums.reshape(shape)

    def _pixels(self, on_plane: Float64) -> Int64:
        camera = self._camera
        if self._same:
            return np.arange(camera.width * camera.height)
        column = np.floor(camera.cx + camera.fx * on_plane[:, 0]).astype(np.int64)
        row = np.floor(camera.cy - camera.fy * on_plane[:, 1]).astype(np.int64)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        return np.where(inside, row * camera.width + column, -1)

    def _made(self, to_world: Float64) -> mi.Sensor:
        (width, height), (cx, cy) = self._size, self._centre
        film = {
            "type": "hdrfilm",
            "width": int(width),
            "height": int(height),
            "pixel_format": "rgb",
            "component_format": "float32",
            "rfilter": {"type": "box"},
        }
        parts = {
            "type": "perspective",
            "fov": math.degrees(2 * math.atan(width / (2 * self._focal))),
            "fov_axis": "x",
            "near_clip": 1e-4,
            "far_clip": 1e7,
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "film": film,
            "sampler": {"type": "independent"},
        }
        if self._camera.aperture_radius > 0:
            lens = {"aperture_radius": self._camera.aperture_radius, "focus_distance": self._camera.focus_distance}
            return mi.load_dict(parts | {"type": "thinlens", **lens})
        parts |= {"principal_point_offset_x": 0.5 - cx / width, "principal_point_offset_y": 0.5 - cy / height}
        return mi.load_dict(parts)

    def _plane(self, depth: float) -> mi.Scene:
        """Make a plane across the camera's view, hardly larger than the picture, so that float32 keeps its digits."""
        reach = np.maximum(np.abs(self._centre), np.abs(self._size - self._centre)).max() / self._focal
        half = 1.1 * reach * self._camera.focus_distance + 2 * self._camera.aperture_radius
        place = mi.ScalarTransform4f().translate([0, 0, -depth]).scale(float(half))
        return mi.load_dict({"type": "scene", "plane": {"type": "rectangle", "to_world": place}})
