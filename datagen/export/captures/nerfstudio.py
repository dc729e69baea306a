"""Captures as nerfstudio reads them: `transforms.json`, images, depth, masks, points."""

from pathlib import Path
from typing import Any

from multilight.datagen.export.captures.capture import Capture, write_pictures
from multilight.datagen.export.captures.points import write_ply
from multilight.datagen.export.files import write_json
from multilight.scenes.spec import Camera


def write_nerfstudio(capture: Capture, folder: Path) -> None:
    """Write one capture: poses are camera-to-world with OpenGL axes, world +Z up, metres; depth 16-bit mm."""
    write_pictures(capture, folder, mask_name="{}.png")
    points = capture.points
    write_ply(folder / "points.ply", points, points.colours(capture.images))
    write_json(folder / "transforms.json", transforms(capture))


def transforms(capture: Capture) -> dict[str, Any]:
    """Make the content of `transforms.json`; intrinsics stand with each frame where the views' lenses differ."""
    cameras = capture.record.scene.cameras
    lenses = [_lens(camera) for camera in cameras]
    shared = lenses[0] if all(lens == lenses[0] for lens in lenses) else {}
    frames = [
        {
            "file_path": f"images/{number:02d}.png",
            "depth_file_path": f"depths/{number:02d}.png",
            "mask_path": f"masks/{number:02d}.png",
            "transform_matrix": [list(row) for row in camera.c2w],
            **({} if shared else lens),
        }
        for number, (camera, lens) in enumerate(zip(cameras, lenses, strict=True))
    ]
    return {"camera_model": "OPENCV", **shared, "ply_file_path": "points.ply", "frames": frames}


def _lens(camera: Camera) -> dict[str, float]:
    return {
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy, "w": camera.width, "h": camera.height,
    }  # fmt: skip
