"""Captures as COLMAP's binary models: `sparse/0/cameras.bin`, `images.bin`, `points3D.bin` beside the images.

The layout is that of https://colmap.github.io/format.html: little-endian, ids from 1, world-to-camera poses with
OpenCV axes as a unit quaternion (w, x, y, z) and a translation, the upper left pixel's centre at (0.5, 0.5).
"""

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from multilight.datagen.export.captures.capture import Capture, write_pictures
from multilight.datagen.export.captures.points import ScenePoints, Sighting, sightings
from multilight.scenes.arrays import UInt8
from multilight.scenes.cameras.pinhole import opencv_from_opengl
from multilight.scenes.spec import Camera

PINHOLE = 1  # COLMAP's number of the model with fx, fy, cx, cy


def write_colmap(capture: Capture, folder: Path) -> None:
    """Write one capture: a camera and an image a view, points with their tracks; masks are named as COLMAP wants."""
    write_pictures(capture, folder, mask_name="{}.png.png")
    cameras = capture.record.scene.cameras
    points = capture.points
    seen = sightings(points, cameras, capture.depths)
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.bin").write_bytes(_cameras(cameras))
    (model / "images.bin").write_bytes(_images(cameras, seen))
    (model / "points3D.bin").write_bytes(_points(points, points.colours(capture.images), seen))


def _cameras(cameras: tuple[Camera, ...]) -> bytes:
    rows = [
        struct.pack("<IiQQ4d", number, PINHOLE, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        for number, camera in enumerate(cameras, 1)
    ]
    return struct.pack("<Q", len(rows)) + b"".join(rows)


def _images(cameras: tuple[Camera, ...], seen: list[Sighting]) -> bytes:
    parts = [struct.pack("<Q", len(cameras))]
    for number, (camera, sighting) in enumerate(zip(cameras, seen, strict=True), 1):
        camera_from_world = np.linalg.inv(opencv_from_opengl(camera.c2w))
        x, y, z, w = Rotation.from_matrix(camera_from_world[:3, :3]).as_quat()
        parts.append(struct.pack("<I7dI", number, w, x, y, z, *camera_from_world[:3, 3], number))
        parts.append(f"{number - 1:02d}.png".encode() + b"\0")
        rows = np.zeros(len(sighting.point), [("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
        rows["x"], rows["y"] = sighting.pixels.T
        rows["point"] = sighting.point + 1
        parts += [struct.pack("<Q", len(rows)), rows.tobytes()]
    return b"".join(parts)


def _points(points: ScenePoints, colours: UInt8, seen: list[Sighting]) -> bytes:
    tracks: list[list[tuple[int, int]]] = [[] for _ in points.xyz]
    for number, sighting in enumerate(seen, 1):
        for place, point in enumerate(sighting.point):
            tracks[point].append((number, place))
    parts = [struct.pack("<Q", len(tracks))]
    for number, (xyz, rgb, track) in enumerate(zip(points.xyz, colours, tracks, strict=True), 1):
        flat = [value for pair in track for value in pair]
        parts.append(struct.pack(f"<Q3d3BdQ{len(flat)}I", number, *xyz, *rgb, 0.0, len(track), *flat))
    return b"".join(parts)
