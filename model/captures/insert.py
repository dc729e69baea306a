"""Put an object into a capture and harmonize all views alike."""

from dataclasses import dataclass, replace

import numpy as np

from multilight.datagen.errors import UserError
from multilight.datagen.report import Report
from multilight.model.captures.capture import Capture
from multilight.model.captures.confidence import depth_confidence, repaired
from multilight.model.captures.objects import ObjectView, PlacedObject
from multilight.model.captures.planes import scene_centre
from multilight.model.configs.stage3d import SLIM3D
from multilight.model.gaussians.splat_scene import splat_scene
from multilight.model.inference.depth import depth_from_metres
from multilight.model.inference.harmonize import harmonize, lights_of_views
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import Compositing3D, SceneNetwork, harmonize_views
from multilight.scenes.arrays import Float32
from multilight.scenes.gaussians.from_views import Gaussians

LEAST_SEEN = 16
"""Pixels of the object, over all views, from which on it is worth harmonizing."""


@dataclass(frozen=True)
class Inserted:
    """A capture with an object in it: V views (V, H, W, 3) display-encoded, coverage and z_depths (V, H, W)."""

    composites: Float32
    coverage: Float32
    z_depths: Float32


@dataclass(frozen=True)
class Harmonized:
    """The result: views of the 2D and of the 3D stage (V, H, W, 3), display-encoded, and the scene's Gaussians."""

    single: Float32
    views: Float32
    gaussians: Gaussians


def insert_object(capture: Capture, placed: PlacedObject) -> Inserted:
    """Lay the object over every view, hidden where the capture's depth says so.

    Raises `UserError` where it is out of every picture, or hidden in all of them.
    """
    assert capture.z_depths is not None
    views = [placed.seen(camera, depth) for camera, depth in zip(capture.cameras, capture.z_depths, strict=True)]
    coverage = np.stack([view.coverage for view in views])
    if coverage.sum() < LEAST_SEEN:
        raise UserError(_unseen(capture, placed, views))
    depths = [np.where(v.coverage > 0.5, v.z_depth, d) for v, d in zip(views, capture.z_depths, strict=True)]
    composites = [view.over(image) for view, image in zip(views, capture.images, strict=True)]
    return Inserted(np.stack(composites), coverage, np.stack(depths).astype(np.float32))


def harmonize_capture(
    capture: Capture,
    inserted: Inserted,
    network: Compositing2D,
    network3d: SceneNetwork | None = None,
    *,
    side: int,
    report: Report,
) -> Harmonized:
    """Harmonize view by view under one set of lights, then all together on side * side Gaussians.

    Without a network of the 3D stage the views stay as one set of lights makes them. Where the 2D network guesses no
    lights, what its views say of a Gaussian is averaged. Where no view was changed, the capture's own pixels stay.
    `report` is told (views done, views).
    """
    depths = [depth_from_metres(depth) for depth in inserted.z_depths]
    rotations = np.stack([camera.pose()[:3, :3] for camera in capture.cameras])
    composites, backgrounds, masks = map(list, (inserted.composites, capture.images, inserted.coverage))
    lights = lights_of_views(network, composites, backgrounds, depths, masks, rotations)
    alone = []
    for composite, background, depth, mask, numbers in zip(composites, backgrounds, depths, masks, lights, strict=True):
        seen = mask.max() > 0
        alone.append(
            harmonize(network, composite, background, depth, mask=mask, numbers=numbers) if seen else composite
        )
        report(len(alone), len(capture.images))
    report(len(capture.images), len(capture.images), "harmonizing all views alike")
    single = np.stack(alone)
    device = next(network.parameters()).device
    stage3d = (network3d or Compositing3D(SLIM3D).eval()).to(device)
    try:
        scene = splat_scene(capture.cameras, inserted.z_depths, side=side, order=stage3d.config.order).to(device)
    except ValueError as error:
        raise UserError(f"{capture.path}: {error}; --side must be a power of two, and the views need depth") from None
    colors, together = harmonize_views(stage3d, scene, inserted.composites, single, capture.images)
    gaussians = replace(scene.gaussians.gaussians, colors=colors)
    if network3d is None and network.config.head == "light":
        return Harmonized(single, single, gaussians)
    confidence = depth_confidence(scene, capture.cameras, inserted.z_depths)
    return Harmonized(single, repaired(single, together, confidence, inserted.coverage), gaussians)


def _unseen(capture: Capture, placed: PlacedObject, views: list[ObjectView]) -> str:
    place, centre = placed.pose[:3, 3].round(3).tolist(), scene_centre(capture).round(3).tolist()
    outlined = sum(view.outlined for view in views)
    if outlined < LEAST_SEEN:
        return (
            f"the object at {place} is out of all {len(views)} pictures, or too small in them: the cameras of "
            f"{capture.path} look at about {centre}; mend --pose, or --scale"
        )
    return (
        f"the object at {place} would be seen in {sum(v.outlined > 0 for v in views)} pictures, but the scene's depth "
        f"hides it in all: is it inside or behind something? The cameras of {capture.path} look at about {centre}"
    )
