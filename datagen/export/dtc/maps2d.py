"""DTC-MultiLight's 2D layouts: a folder of pictures for each lighting and exposure (training), or one composite a
scene (evaluation).

    scene_00000/0_1_ev2/images/3.png            view 3, all objects
                        env_masks/3.png         255 where the pixel's centre sees nothing
                        depths/3.png            z depth over the scene's largest; 255 where nothing
                        object_masks/3_object0.png, object_bgs/3_object0.png
                        transforms.json
    scene_00084/{composites,bgs,depths,gts,masks}/3.png, transforms.json
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.export.dtc.scene import Geometry
from multilight.datagen.export.files import repeat, write_json, write_png
from multilight.scenes.arrays import UInt8
from multilight.scenes.spec import Camera

FIELD_TOLERANCE = 1e-6  # of focal lengths that count as one


def write_training_geometry(scene: Path, name: str, folders: Sequence[str], geometry: Geometry) -> None:
    """Write what no lighting changes into each lighting's folder: depths, masks, `transforms.json`.

    `name` is the scene's final name, which the paths in `transforms.json` begin with.
    """
    first, *others = folders
    objects = geometry.masks.shape[1]
    for view in range(len(geometry.cameras)):
        pictures = {f"env_masks/{view}.png": geometry.environments[view], f"depths/{view}.png": geometry.depths[view]}
        for j in range(objects):
            pictures[f"object_masks/{view}_object{j}.png"] = geometry.masks[view, j]
        for file, picture in pictures.items():
            write_png(scene / first / file, picture)
            for folder in others:
                repeat(scene / first / file, scene / folder / file)
    for folder in folders:
        frames = [_training_frame(f"{name}/{folder}", view, objects) for view in range(len(geometry.cameras))]
        write_json(scene / folder / "transforms.json", _transforms(geometry.cameras, frames))


def write_training_pictures(folder: Path, view: int, image: UInt8, backgrounds: Sequence[UInt8]) -> None:
    """Write a view under one lighting and exposure: with all objects, and without each of them."""
    write_png(folder / "images" / f"{view}.png", image)
    for j, background in enumerate(backgrounds):
        write_png(folder / "object_bgs" / f"{view}_object{j}.png", background)


def write_evaluation_pictures(scene: Path, view: int, **pictures: UInt8) -> None:
    """Write a view of an evaluation scene: composite, bg, depth, gt and mask.

    Its mask is that of the environment: the published loader leaves out of the comparison what the mask covers,
    as it does with `env_masks` in training.
    """
    for kind, picture in pictures.items():
        write_png(scene / f"{kind}s" / f"{view}.png", picture)


def write_evaluation_transforms(scene: Path, name: str, geometry: Geometry) -> None:
    """Write an evaluation scene's `transforms.json`; `name` as for training."""
    kinds, views = ("composite", "bg", "depth", "gt", "mask"), range(len(geometry.cameras))
    frames = [{f"{kind}_path": f"{name}/{kind}s/{view}.png" for kind in kinds} for view in views]
    write_json(scene / "transforms.json", _transforms(geometry.cameras, frames))


def paste(image: UInt8, background: UInt8, mask: UInt8) -> UInt8:
    """Composite as the published loader does: image * mask + background * (1 - mask), all 8-bit."""
    covered = mask[..., None].astype(np.float32) / 255.0
    return np.rint(image * covered + background * (1.0 - covered)).astype(np.uint8)


def _training_frame(folder: str, view: int, objects: int) -> dict[str, Any]:
    return {
        "image_path": f"{folder}/images/{view}.png",
        "depth_path": f"{folder}/depths/{view}.png",
        "env_mask_path": f"{folder}/env_masks/{view}.png",
        "object_mask_path": [f"{folder}/object_masks/{view}_object{j}.png" for j in range(objects)],
        "object_bg_path": [f"{folder}/object_bgs/{view}_object{j}.png" for j in range(objects)],
    }


def _transforms(cameras: Sequence[Camera], frames: list[dict[str, Any]]) -> dict[str, Any]:
    """Join frames and cameras: one field of view where all share it, else a focal length a frame."""
    posed = [frame | {"transform_matrix": camera.c2w} for frame, camera in zip(frames, cameras, strict=True)]
    focal = [camera.fx for camera in cameras]
    if max(focal) - min(focal) <= FIELD_TOLERANCE * max(focal):
        return {"camera_angle_x": 2.0 * math.atan(cameras[0].width / (2.0 * focal[0])), "frames": posed}
    return {"frames": [frame | {"fl_x": fx} for frame, fx in zip(posed, focal, strict=True)]}
