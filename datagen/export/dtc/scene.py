"""What the DTC-MultiLight exports need of a scene: stored frames, lightings with their exposure, geometry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from multilight.datagen.errors import UserError
from multilight.datagen.export.images import to_byte
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.tuples import compose
from multilight.lights.display.reinhard import Metering, ViewMetering, join, meter_view
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32, Int64, UInt8
from multilight.scenes.spec import Camera

VARIANTS = 2  # the published set's lightings are numbered in pairs


@dataclass(frozen=True)
class Frame:
    """How a rendered picture becomes a stored one: shrunk until one side fits, the rest cropped evenly.

    `shape` is (height, width) after shrinking, `corner` the (row, column) where the stored square begins in it.
    """

    size: int
    rendered: tuple[int, int]
    shape: tuple[int, int]
    corner: tuple[int, int]

    @staticmethod
    def fit(size: int, height: int, width: int) -> "Frame":
        """Choose the frame for pictures rendered at height x width; raises `UserError` where they are too small."""
        if not 1 <= size <= min(height, width):
            raise UserError(
                f"--size {size} must be 1 to {min(height, width)}: the views are rendered at {width}x{height}"
            )
        scale = size / min(height, width)
        shape = (max(size, round(height * scale)), max(size, round(width * scale)))
        return Frame(size, (height, width), shape, ((shape[0] - size) // 2, (shape[1] - size) // 2))

    def shrink(self, picture: UInt8) -> UInt8:
        """Shrink an 8-bit picture (H, W) or (H, W, 3) by an area filter, and crop it."""
        if self.shape != self.rendered:
            picture = np.asarray(Image.fromarray(picture).resize(self.shape[::-1], Image.Resampling.BOX))
        (row, column), size = self.corner, self.size
        return picture[row : row + size, column : column + size]

    def pick(self, buffer: NDArray[np.generic]) -> NDArray[np.generic]:
        """Take the values of (H, W, ...) at the stored pixels' centres: geometry is never filtered."""
        rows, columns = (self._under(axis) for axis in range(2))
        return buffer[rows[:, None], columns[None]]

    def camera(self, camera: Camera, shift: tuple[float, float] = (0.0, 0.0)) -> Camera:
        """Return the stored picture's camera; the principal point is shifted by so many pixels up and left."""
        (down, across), (row, column) = self._scale(), self.corner
        return Camera(
            width=self.size,
            height=self.size,
            fx=camera.fx * across,
            fy=camera.fy * down,
            cx=camera.cx * across - column - shift[1],
            cy=camera.cy * down - row - shift[0],
            c2w=camera.c2w,
        )

    def picked_camera(self, camera: Camera) -> Camera:
        """Return the camera whose pixel centres are the rays that `pick` took: within half a pixel of `camera`."""
        centres = np.arange(self.size)
        taken = [(self._under(axis) + 0.5) * self._scale()[axis] - self.corner[axis] for axis in range(2)]
        down, across = (float(np.mean(places - centres - 0.5)) for places in taken)
        return self.camera(camera, (down, across))

    def _scale(self) -> tuple[float, float]:
        return self.shape[0] / self.rendered[0], self.shape[1] / self.rendered[1]

    def _under(self, axis: int) -> Int64:
        """Return the rendered pixel under each stored pixel's centre, along one axis."""
        centres = np.arange(self.size) + self.corner[axis] + 0.5
        return np.floor(centres / self._scale()[axis]).astype(np.int64)


@dataclass(frozen=True)
class Lighting:
    """One lighting of a scene under its published name (`0_1`: lighting 0, variant 1), and how it is exposed."""

    name: str
    condition: LightingCondition
    metering: Metering

    def folder(self, step: int) -> str:
        """Return the name of its folder at an exposure."""
        return f"{self.name}_ev{step}"


@dataclass(frozen=True)
class Geometry:
    """What the stored pixels of a scene's V views see, at size x size.

    cameras: as stored; picked: whose rays z_depths (V, S, S) [m], instance_ids and normals (V, S, S, 3) belong to;
    depths (V, S, S) and environments (V, S, S) 8-bit as published; masks (V, K, S, S) 8-bit coverage of each
    insertable object.
    """

    cameras: tuple[Camera, ...]
    picked: tuple[Camera, ...]
    z_depths: Float32
    instance_ids: NDArray[np.uint16]
    normals: Float32
    depths: UInt8
    environments: UInt8
    masks: UInt8


def numbered(number: int) -> str:
    """Name the scene's condition of that number as published: twelve of them are 0_0, 0_1, 1_0, ..., 5_1."""
    return "{}_{}".format(*divmod(number, VARIANTS))


def survey(
    source: DatasetSource, record: SceneRecord, frame: Frame, conditions: Sequence[LightingCondition]
) -> tuple[tuple[Lighting, ...], Geometry]:
    """Read all views once: meter each condition as published, and gather the geometry."""
    metered: list[list[ViewMetering]] = [[] for _ in conditions]
    buffers: dict[str, list[NDArray[np.generic]]] = {"z_depth": [], "instance_id": [], "normal_world": [], "masks": []}
    farthest = 0.0
    for view in source.views(record):
        geometry = view.geometry
        seen = geometry.z_depth > 0
        farthest = max(farthest, float(geometry.z_depth.max()))
        for condition, metering in zip(conditions, metered, strict=True):
            metering.append(meter_view(compose.target(view, condition), seen))
        covered = [frame.shrink(to_byte(view.coverage[name])) for name in record.scene.insertable]
        buffers["masks"].append(np.stack(covered))
        for name in ("z_depth", "instance_id", "normal_world"):
            buffers[name].append(frame.pick(getattr(geometry, name)))
    lightings = tuple(
        Lighting(numbered(number), condition, join(metering))
        for number, (condition, metering) in enumerate(zip(conditions, metered, strict=True))
    )
    z_depths = np.stack(buffers["z_depth"]).astype(np.float32)
    nothing = z_depths <= 0
    # Cut off, not rounded, as published.
    depths = np.clip(z_depths / np.float32(max(farthest, 1e-9)) * 255.0, 0, 255)
    return lightings, Geometry(
        cameras=tuple(frame.camera(camera) for camera in record.scene.cameras),
        picked=tuple(frame.picked_camera(camera) for camera in record.scene.cameras),
        z_depths=z_depths,
        instance_ids=np.stack(buffers["instance_id"]).astype(np.uint16),
        normals=np.stack(buffers["normal_world"]).astype(np.float32),
        depths=np.where(nothing, 255, depths).astype(np.uint8),
        environments=np.where(nothing, 255, 0).astype(np.uint8),
        masks=np.stack(buffers["masks"]).astype(np.uint8),
    )
