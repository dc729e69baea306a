"""Captures in nerfstudio's layout: `transforms.json`, pictures, maybe depth and a first point cloud."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from multilight.datagen.errors import UserError
from multilight.model.captures.capture import Capture, Shot, load_shots
from multilight.model.captures.lenses import Lens
from multilight.scenes.files.confined import inside
from multilight.scenes.files.limits import open_picture, read_json, shown

Json = dict[str, Any]


def read_nerfstudio(file: Path, *, max_side: int, every: int = 1) -> Capture:
    """Read `transforms.json` and what it names; raises `UserError` naming what is missing or wrong.

    Depth pictures of 16 bits are in thousandths of the unit of length. `every` takes each n-th frame.
    """
    try:
        content: Json = read_json(file)
        frames = content["frames"][::every]
        shots = [_shot(file.parent, content, frame) for frame in frames]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ArithmeticError) as error:
        what = f"has no {error}" if isinstance(error, KeyError) else f"cannot be read: {error}"
        raise UserError(f"{file} {what}") from None
    cloud = content.get("ply_file_path")
    points = None
    if cloud is not None:
        try:
            points = np.asarray(trimesh.load(inside(file.parent, cloud, beside=file.parent)).vertices, np.float64)
        except Exception as error:  # trimesh raises whatever a broken file makes it stumble over
            raise UserError(f"{file}: points {shown(cloud)} cannot be read: {error}") from None
    return load_shots(file.parent, shots, max_side=max_side, points=points)


def _shot(folder: Path, content: Json, frame: Json) -> Shot:
    values = content | frame
    depth = frame.get("depth_file_path")
    unit = 1.0 if depth is not None and depth.endswith(".npy") else float(content.get("depth_unit_scale_factor", 0.001))
    image = inside(folder, frame["file_path"], beside=folder)
    if not image.suffix:  # as in Blender's synthetic sets
        image = image.with_suffix(".png")
    return Shot(
        name=image.name,
        image=image,
        lens=_lens(image, values),
        c2w=np.array(frame["transform_matrix"], np.float64),
        depth=None if depth is None else inside(folder, depth, beside=folder),
        depth_unit=unit,
    )


def _lens(image: Path, values: Json) -> Lens:
    model = values.get("camera_model", "OPENCV")
    known = ("OPENCV", "OPENCV_FISHEYE", "PINHOLE", "SIMPLE_PINHOLE", "PERSPECTIVE")
    if model not in known:
        raise UserError(f"{image}: camera model {model} cannot be read; {', '.join(known)} can")
    if "w" not in values or "h" not in values:
        with open_picture(image) as opened:
            values = values | {"w": opened.width, "h": opened.height}
    width, height = int(values["w"]), int(values["h"])
    fx = float(values["fl_x"]) if "fl_x" in values else 0.5 * width / np.tan(0.5 * float(values["camera_angle_x"]))
    fy = float(values.get("fl_y", fx))
    if width < 1 or height < 1 or not (0 < fx < np.inf and 0 < fy < np.inf):
        raise UserError(f"{image}: a camera of {width} x {height} pixels and focal length {fx:g}, {fy:g} sees nothing")
    first = (fx, fy, float(values.get("cx", width / 2)), float(values.get("cy", height / 2)))
    k1, k2, k3, k4, p1, p2 = (float(values.get(name, 0.0)) for name in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if model == "OPENCV_FISHEYE":
        return Lens(model, width, height, (*first, k1, k2, k3, k4))
    if model == "OPENCV" and any((k1, k2, k3, p1, p2)):
        return Lens("FULL_OPENCV", width, height, (*first, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))
    return Lens("PINHOLE", width, height, first)
