"""Check everything that was written: files, finite values, and the identities that make the data true."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from datagen import compose
from datagen.errors import StoreError
from datagen.layers import Float32
from datagen.records import SceneRecord
from datagen.store import ViewData, file_sha256, read_dataset, read_scene, read_view, scene_dir, scene_indices
from lights.spec import LightingCondition
from lights.tonemap import luminance
from scenes.cameras import reprojection_error

ADDITIVITY = 1e-3  # raw layers against the renderer's own picture: float32 sums of half a dozen layers
ENERGY = 0.3  # denoised layers against the raw picture: a denoiser spreads or drops what few samples found
OVERLAP = 0.005  # rounding of half floats where coverages add up to one
HALF = 2e-3  # twice the relative spacing of half floats, after sums
REPROJECTION_SHARE = 0.97  # pixels that must land on or behind the other view's surface
DEPTH_ERROR = 2e-3  # relative, median over smooth surfaces
DARK = 0.05  # the brightest twentieth of a metered view must reach this luminance (middle grey is 0.18)
BRIGHT = 4.0  # and its median must stay below this
FIREFLY = 50.0  # times the brightest neighbour, and brighter than white


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong, in the words a user needs."""

    scene: int
    view: int | None
    check: str
    message: str


CHECKS = (
    "files",
    "finite",
    "additivity",
    "composite",
    "masks",
    "exposure",
    "fireflies",
    "removal",
    "reprojection",
)


def verify_dataset(root: Path) -> Iterator[tuple[int, list[Fault]]]:
    """Check every finished scene of a dataset, one after the other; raises `StoreError` if it is none."""
    read_dataset(root)
    for index in scene_indices(root):
        yield index, verify_scene(scene_dir(root, index))


def verify_scene(folder: Path) -> list[Fault]:
    """Check one scene's folder and return its faults (none: the scene is sound)."""
    try:
        record = read_scene(folder)
    except StoreError as error:
        index = int(folder.name) if folder.name.isdigit() else -1
        return [Fault(index, None, "files", str(error))]
    faults: list[Fault] = []
    views: list[ViewData | None] = []
    for number, stated in enumerate(record.views):
        try:
            path = folder / stated.file
            view = read_view(path)
            if file_sha256(path) != stated.file_sha256:
                raise StoreError(f"{path}: content differs from the hash in scene.json")
            faults += verify_view(record, number, view)
            views.append(view)
        except StoreError as error:
            faults.append(Fault(record.index, number, "files", str(error)))
            views.append(None)
    for (a, view_a), (b, view_b) in pairwise(enumerate(views)):
        if view_a is not None and view_b is not None:
            faults += _reprojection(record, (a, view_a), (b, view_b))
    return faults


def verify_view(record: SceneRecord, number: int, view: ViewData) -> list[Fault]:
    """Check one view's content against the scene's record."""
    found = [
        *(("files", m) for m in _content(record, number, view)),
        *(("finite", m) for m in _finite(view)),
        *(("additivity", m) for m in _additivity(record, number, view)),
        *(("masks", m) for m in _masks(record, view)),
        *(("exposure", m) for m in _exposure(record, view)),
        *(("fireflies", m) for m in _fireflies(record, view)),
    ]
    if not any(check in ("files", "finite") for check, _ in found):
        found += [("composite", m) for m in _composite(record, view)]
        found += [("removal", m) for m in _removal(record, view)]
    return [Fault(record.index, number, check, message) for check, message in found]


def _content(record: SceneRecord, number: int, view: ViewData) -> Iterator[str]:
    names = record.scene.insertable
    wanted = {"all"} | {f"{action}_{name}" for action in ("without", "foreground") for name in names}
    if set(view.variants) != wanted:
        yield f"variants are {sorted(view.variants)}, expected {sorted(wanted)}"
    if set(view.lights) != set(record.rig.names):
        yield f"layers are {sorted(view.lights)}, the rig has {sorted(record.rig.names)}"
    camera = record.scene.cameras[number]
    if view.geometry.z_depth.shape != (camera.height, camera.width):
        yield f"image is {view.geometry.z_depth.shape}, the camera {camera.height} x {camera.width}"


def _finite(view: ViewData) -> Iterator[str]:
    for variant, layers in view.variants.items():
        for light, layer in zip(view.lights, layers, strict=True):
            if not np.isfinite(layer).all() or layer.min() < 0:
                yield f"{variant}.{light} holds NaN, infinite or negative radiance"
    if not np.isfinite(view.geometry.z_depth).all() or view.geometry.z_depth.min() < 0:
        yield "z_depth holds NaN, infinite or negative values"
    lengths = np.linalg.norm(view.geometry.normal_world, axis=-1)[view.geometry.instance_id > 0]
    if lengths.size and np.abs(lengths - 1).max() > 0.02:
        yield f"normal_world is not of unit length (off by {np.abs(lengths - 1).max():.3f})"


def _additivity(record: SceneRecord, number: int, view: ViewData) -> Iterator[str]:
    stated = record.views[number]
    if stated.additivity > ADDITIVITY:
        yield f"raw layers differ from the combined render by {stated.additivity:.2e} (limit {ADDITIVITY:.0e})"
    total, combined = view.variants["all"].sum(axis=0), view.combined
    if not record.denoised and (off := _off(total, combined, np.ones(total.shape[:2], bool))) > 2 * HALF:
        yield f"stored layers differ from the combined render by {off:.2e} (limit {2 * HALF:.0e})"
    # A few samples' highlights say little about a layer: the brightest twentieth is held to what bounds the rest.
    limit = float(np.percentile(combined, 95))
    energy = float(total.clip(max=limit).mean() / max(float(combined.clip(max=limit).mean()), 1e-9))
    if abs(energy - 1) > ENERGY:
        yield f"layers carry {energy:.3f} of the combined render's energy (allowed: 1 ± {ENERGY})"


def _composite(record: SceneRecord, view: ViewData) -> Iterator[str]:
    condition = record.conditions[-1]
    truth = compose.target(view, condition)
    for name in record.scene.insertable:
        pasted = compose.composite(view, name, insert=condition, base=condition)
        empty = compose.background(view, name, condition)
        alpha = view.coverage[name]
        if _off(pasted, empty, alpha <= 0) > HALF:
            yield f"composite of {name} differs from the background outside the object"
        if _off(pasted, truth, alpha >= 1) > HALF:
            yield f"composite of {name} under one lighting differs from the target inside the object"


def _off(a: Float32, b: Float32, where: np.ndarray) -> float:
    if not where.any():
        return 0.0
    scale = np.abs(b[where]) + 1e-3 * float(np.abs(b).mean()) + 1e-12
    return float((np.abs(a[where] - b[where]) / scale).max())


def _masks(record: SceneRecord, view: ViewData) -> Iterator[str]:
    ids, environment = view.geometry.instance_id, view.geometry.environment
    if ids.max() > len(record.scene.bodies):
        yield f"instance_id {ids.max()} is beyond the scene's {len(record.scene.bodies)} bodies"
    total = sum(view.coverage.values(), start=environment)
    if total.max() > 1 + OVERLAP:
        yield f"coverages and environment add up to {total.max():.3f} in a pixel"
    for name, alpha in view.coverage.items():
        if (ids[alpha >= 0.999] != record.scene.instance_id(name)).any():
            yield f"pixels wholly covered by {name} carry another instance_id"
    if ((view.geometry.z_depth > 0) != (ids > 0)).any():
        yield "z_depth and instance_id disagree on where there is geometry"


def _exposure(record: SceneRecord, view: ViewData) -> Iterator[str]:
    for condition in record.conditions:
        median, high = np.percentile(luminance(compose.target(view, condition)), [50, 95])
        if high < DARK:
            yield f"condition {condition.name}: black, the brightest twentieth reaches {high:.4f} (least {DARK})"
        if median > BRIGHT:
            yield f"condition {condition.name}: blown out, median luminance {median:.2f} (most {BRIGHT})"


def _fireflies(record: SceneRecord, view: ViewData) -> Iterator[str]:
    everything = LightingCondition(
        name="all", gains=dict.fromkeys(view.lights, (1.0, 1.0, 1.0)), exposure_ev=record.conditions[0].exposure_ev
    )
    picture = luminance(compose.target(view, everything))
    padded = np.pad(picture, 1, mode="reflect")
    height, width = picture.shape
    shifts = [(y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)]
    neighbours = np.max([padded[y : y + height, x : x + width] for y, x in shifts], axis=0)
    count = int(((picture > 1.0) & (picture > FIREFLY * neighbours)).sum())
    if count:
        yield f"{count} single pixels are over {FIREFLY:.0f} times brighter than all their neighbours"


def _removal(record: SceneRecord, view: ViewData) -> Iterator[str]:
    everything = LightingCondition(name="all", gains=dict.fromkeys(view.lights, (1.0, 1.0, 1.0)))
    for name, alpha in view.coverage.items():
        change = np.abs(compose.effect(view, name, everything))
        seen = alpha >= 1
        if seen.sum() > 16 and not change[seen].any():
            yield f"removing {name} changes nothing where it was"


def _reprojection(record: SceneRecord, first: tuple[int, ViewData], second: tuple[int, ViewData]) -> list[Fault]:
    """Carry each view's depth into the other: depth that is too small shows one way, too large the other."""
    faults = []
    for (a, view_a), (b, view_b) in ((first, second), (second, first)):
        cameras = record.scene.cameras
        found = reprojection_error(view_a.geometry.z_depth, cameras[a], view_b.geometry.z_depth, cameras[b])
        if found.compared == 0:
            continue
        if found.consistent < REPROJECTION_SHARE or found.median_relative_error > DEPTH_ERROR:
            message = (
                f"{found.consistent:.1%} of the depth agrees with view {b} (least {REPROJECTION_SHARE:.0%}), "
                f"median error {found.median_relative_error:.2e} (most {DEPTH_ERROR:.0e})"
            )
            faults.append(Fault(record.index, a, "reprojection", message))
    return faults
