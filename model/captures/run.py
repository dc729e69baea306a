"""From the files of a capture to those of the result."""

import json
from pathlib import Path

import numpy as np

from multilight.datagen.errors import full_disk_told
from multilight.datagen.files.outputs import written
from multilight.datagen.files.video import write_video
from multilight.datagen.report import Report
from multilight.datagen.storage.store import write_text
from multilight.model.captures.assets import load_asset
from multilight.model.captures.capture import Capture, check_alignment
from multilight.model.captures.depths import with_depth
from multilight.model.captures.insert import Harmonized, Inserted, harmonize_capture, insert_object
from multilight.model.captures.objects import PlacedObject
from multilight.model.captures.orbit import orbit_cameras, render_gaussians
from multilight.model.captures.placing import placed
from multilight.model.captures.planes import scene_up
from multilight.model.captures.read import read_capture
from multilight.model.captures.request import Insertion
from multilight.model.device import chosen_device
from multilight.model.inference.pictures import to_bytes, write_picture
from multilight.model.networks.checkpoint import load_network, load_network3d
from multilight.scenes.gaussians.ply import write_gaussians


def insert_into_files(wanted: Insertion, report: Report) -> str:
    """Insert an object and write composites/, harmonized/, scene.ply, placement.json and orbit.mp4.

    Returns in words what was made. Raises `UserError` for what the user can mend and `wanted.check` cannot know.
    """
    out, frames = wanted.out, wanted.frames
    report(0, 0, "reading the capture")
    network = load_network(wanted.weights).to(chosen_device(wanted.device))
    stage3d = None if wanted.weights_3d is None else load_network3d(wanted.weights_3d)
    asset = load_asset(wanted.asset)
    bare = read_capture(wanted.capture, max_side=wanted.max_side, every=wanted.every)
    views = len(bare.names)
    report(0, 0, f"finding room for the object in {views} views")
    capture = with_depth(bare, wanted.gaussians, wanted.depth_model)
    if bare.z_depths is not None or wanted.gaussians is not None:
        check_alignment(capture)
    pose = placed(capture, asset, wanted.place)
    inserted = insert_object(capture, PlacedObject(asset, pose))
    seen = int((inserted.coverage.max(axis=(1, 2)) > 0).sum())
    report(0, views, "harmonizing view by view")
    result = harmonize_capture(capture, inserted, network, stage3d, side=wanted.side, report=report)
    report(views, views, f"writing, {frames} frames of the orbit last")
    with full_disk_told(out):
        _write(out, capture, inserted, result)
        placement = {"world_from_asset": pose.tolist(), "asset": wanted.asset, "views": list(capture.names)}
        write_text(out / "placement.json", json.dumps(placement, indent=1) + "\n")
        if frames:
            centre = pose[:3, :3] @ [0.0, 0.0, asset.size[2] / 2] + pose[:3, 3]
            orbit = orbit_cameras(capture.cameras, np.asarray(centre), scene_up(capture), frames)
            shown = (to_bytes(render_gaussians(camera, result.gaussians)) for camera in orbit)
            with written(out / "orbit.mp4") as work:
                write_video(work, shown)
    return f"{views} views of {capture.images.shape[2]} x {capture.images.shape[1]}, the object in {seen} of them"


def _write(out: Path, capture: Capture, inserted: Inserted, result: Harmonized) -> None:
    masks = (np.repeat(mask[..., None], 3, axis=-1) for mask in inserted.coverage)
    made = {"composites": inserted.composites, "harmonized": result.views}
    if result.views is not result.single:
        made["single"] = result.single
    for folder, views in (*made.items(), ("masks", masks)):
        for name, view in zip(capture.names, views, strict=True):
            write_picture(out / folder / Path(name).with_suffix(".png"), view)
    with written(out / "scene.ply") as work:
        write_gaussians(work, result.gaussians)
