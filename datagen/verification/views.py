"""Check what a scene's views hold: finite values, and the identities that make the data true.

That all files are there, whole and unchanged, is checked by `datagen.verification.dataset`.
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion, maximum_filter

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.halves import stored_layers
from multilight.datagen.storage.object_variants import ALL, variants_of
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, file_sha256, read_view
from multilight.datagen.tuples import compose
from multilight.datagen.tuples.exposure import BRIGHT, DARK, levels
from multilight.datagen.verification.residuals import SIDES, residual
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32
from multilight.scenes.cameras.pinhole import reprojection_error
from multilight.scenes.colour import luminance

ADDITIVITY = 1e-3  # raw layers against the renderer's own picture: float32 sums of half a dozen layers
FAR = 0.2
"""Of the local radiance, beyond noise: how far blocks of a denoised layer may be from what was rendered."""
OVERLAP = 0.005  # rounding of half floats where coverages add up to one
HALF = 2e-3  # twice the relative spacing of half floats, after sums
CONSISTENT = 0.97  # pixels that must land on or behind the other view's surface
DEPTH_ERROR = 2e-3  # relative, median over smooth surfaces
NEIGHBOURS = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)
FIREFLY = 50.0  # times the brightest neighbour, and brighter than white


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong, in the words a user needs; `scene` is None where it concerns the whole dataset."""

    scene: int | None
    view: int | None
    check: str
    message: str


CHECKS = (
    "files",
    "index",
    "finite",
    "additivity",
    "composite",
    "masks",
    "exposure",
    "fireflies",
    "removal",
    "reprojection",
)


Lend = Callable[[str], AbstractContextManager[Path]]
"""Lends a file of a scene's folder by its name there."""


def verify_views(record: SceneRecord, lend: Lend, *, left_out: Collection[int] = ()) -> list[Fault]:
    """Check the hashes and contents of a scene's views, but for those that are known to be missing or cut."""
    faults: list[Fault] = []
    before: ViewData | None = None
    for number, stated in enumerate(record.views):
        view: ViewData | None = None
        if number not in left_out:
            try:
                with lend(stated.file) as path:
                    if file_sha256(path) != stated.file_sha256:
                        raise StoreError(f"{stated.file} was changed: its hash is not the one in scene.json")
                    view = read_view(path, (record, number), compact=True)
                faults += verify_view(record, number, view)
            except (StoreError, OSError) as error:
                faults.append(Fault(record.index, number, "files", str(error)))
        if before is not None and view is not None:
            faults += verify_pair(record, (number - 1, before), (number, view))
        before = None if view is None else replace(view, variants={}, raw={})  # no more than the next one is held to
    return faults


def verify_view(record: SceneRecord, number: int, view: ViewData) -> list[Fault]:
    """Check one view's content against the scene's record."""
    return verify_rendered(record, number, view) + verify_exposure(record, number, brightness(record, view))


def verify_rendered(record: SceneRecord, number: int, view: ViewData, made: ViewData | None = None) -> list[Fault]:
    """Check what of one view can be checked before other views are rendered and exposures metered.

    `made` is what `view` should hold, where that is known.
    """
    found = [
        *(("files", m) for m in (() if made is None else _stored(view, made))),
        *(("files", m) for m in _content(record, number, view)),
        *(("finite", m) for m in _finite(view)),
        *(("additivity", m) for m in _additivity(record, number, view)),
        *(("masks", m) for m in _masks(record, number, view)),
    ]
    if not any(check in ("files", "finite") for check, _ in found):
        found += [("composite", m) for m in _composite(record, view)]
        found += [("removal", m) for m in _removal(record, view)]
    return [Fault(record.index, number, check, message) for check, message in found]


def _content(record: SceneRecord, number: int, view: ViewData) -> Iterator[str]:
    names = record.scene.insertable
    wanted = set(variants_of(names))
    if set(view.variants) != wanted:
        yield f"variants are {sorted(view.variants)}, expected {sorted(wanted)}"
    if view.raw and set(view.raw) != wanted:
        yield f"raw variants are {sorted(view.raw)}, expected {sorted(wanted)}"
    if set(view.lights) != set(record.rig.names):
        yield f"layers are {sorted(view.lights)}, the rig has {sorted(record.rig.names)}"
    camera = record.scene.cameras[number]
    if view.geometry.z_depth.shape != (camera.height, camera.width):
        yield f"image is {view.geometry.z_depth.shape}, the camera {camera.height} x {camera.width}"


def _stored(view: ViewData, made: ViewData) -> Iterator[str]:
    """Hold what was read back to what was written: its residuals are known, and hold for what is on disk."""
    for variant in filter(view.variants.__contains__, made.variants):
        written = dict(zip(made.lights, stored_layers(made.variants, variant), strict=True))
        for light, planes in zip(view.lights, stored_layers(view.variants, variant), strict=True):
            if not all(map(np.array_equal, planes, written[light])):
                yield f"{variant}.{light} reads back other than it was written"


def _finite(view: ViewData) -> Iterator[str]:
    for prefix, variants in (("", view.variants), ("raw ", view.raw)):
        for variant in variants:
            for light, planes in zip(view.lights, stored_layers(variants, variant), strict=True):
                if not all(np.isfinite(plane).all() and plane.min() >= 0 for plane in planes):
                    yield f"{prefix}{variant}.{light} holds NaN, infinite or negative radiance"
    if not np.isfinite(view.geometry.z_depth).all() or view.geometry.z_depth.min() < 0:
        yield "z_depth holds NaN, infinite or negative values"
    lengths = np.linalg.norm(view.geometry.normal_world, axis=-1)[view.geometry.instance_id > 0]
    if lengths.size and np.abs(lengths - 1).max() > 0.02:
        yield f"normal_world is not of unit length (off by {np.abs(lengths - 1).max():.3f})"


def _additivity(record: SceneRecord, number: int, view: ViewData) -> Iterator[str]:
    stated = record.views[number]
    if not stated.additivity <= ADDITIVITY:  # so that NaN is a fault, too
        yield f"raw layers differ from the combined render by {stated.additivity:.2e} (limit {ADDITIVITY:.0e})"
    total, combined = view.variants[ALL].sum(axis=0), view.combined
    rendered = view.raw[ALL].sum(axis=0) if view.raw else None if record.denoised else total
    if rendered is not None and (off := _off(rendered, combined, np.ones(total.shape[:2], bool))) > 2 * HALF:
        yield f"stored layers differ from the combined render by {off:.2e} (limit {2 * HALF:.0e})"
    if record.denoised:
        yield from _denoised(view)


def _denoised(view: ViewData) -> Iterator[str]:
    """Hold the denoised layers to what was rendered: their sum to `combined`, each of them where it was kept."""
    anywhere = np.ones(view.combined.shape[:2], bool)

    def differs(name: str, layer: Float32, rendered: Float32) -> Iterator[str]:
        if (far := residual(layer, rendered, anywhere, least_side=SIDES[-1])[0]) > FAR:
            yield f"{name} differs from what was rendered by {far:.2f} more than noise explains (limit {FAR})"

    yield from differs("the sum of all layers", view.variants[ALL].sum(axis=0), view.combined)
    for variant, raw in view.raw.items():
        for light, layer, rendered in zip(view.lights, view.variants[variant], raw, strict=True):
            yield from differs(f"{variant}.{light}", layer, rendered)


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


STRAY = 0.01
"""Fraction of an object's inner pixels whose centre may see something else, through a gap that all samples missed."""


def _masks(record: SceneRecord, number: int, view: ViewData) -> Iterator[str]:
    ids, environment = view.geometry.instance_id, view.geometry.environment
    if ids.max() > len(record.scene.bodies):
        yield f"instance_id {ids.max()} is beyond the scene's {len(record.scene.bodies)} bodies"
    total = sum(view.coverage.values(), start=environment)
    if total.max() > 1 + OVERLAP:
        yield f"coverages and environment add up to {total.max():.3f} in a pixel"
    for name, stated in record.views[number].pixels.items():
        if name in view.coverage and (found := float(view.coverage[name].sum(dtype=np.float64))) != stated:
            yield f"{name} covers {found} pixels, scene.json states {stated}"
    for name, alpha in view.coverage.items():
        # Away from the outline: where few samples all hit the object, the pixel's centre may still lie beside it.
        inside = binary_erosion(alpha >= 0.999, np.ones((3, 3)))
        wrong = np.count_nonzero(ids[inside] != record.scene.instance_id(name))
        if wrong > 1 + STRAY * np.count_nonzero(inside):
            yield f"{wrong} pixels wholly covered by {name} carry another instance_id"
    if ((view.geometry.z_depth > 0) != (ids > 0)).any():
        yield "z_depth and instance_id disagree on where there is geometry"


@dataclass(frozen=True)
class Brightness:
    """How bright a view is at 0 EV: luminances a condition (median, 95th percentile), and of the brightest pixel
    that outshines all its neighbours with all lights on (0: there is none)."""

    median: tuple[float, ...]
    high: tuple[float, ...]
    spike: float


def brightness(record: SceneRecord, view: ViewData) -> Brightness:
    """Measure what `verify_exposure` needs, so that no picture must be kept until the exposures are metered."""
    unexposed = [condition.model_copy(update={"exposure_ev": 0.0}) for condition in record.conditions]
    medians, highs = zip(*(levels(compose.target(view, condition)) for condition in unexposed), strict=True)
    everything = LightingCondition.unchanged(view.lights)
    picture = luminance(compose.target(view, everything))
    neighbours = maximum_filter(picture, footprint=NEIGHBOURS, mode="mirror")
    spike = float(picture.max(initial=0.0, where=picture > FIREFLY * neighbours))
    return Brightness(medians, highs, spike)


def verify_exposure(record: SceneRecord, number: int, seen: Brightness) -> list[Fault]:
    """Check that no lighting condition leaves a view black, blown out or with fireflies."""
    faults = []
    for condition, median, high in zip(record.conditions, seen.median, seen.high, strict=True):
        gain, found = 2.0**condition.exposure_ev, []
        if high * gain < DARK:
            found.append(f"black, the brightest twentieth reaches {high * gain:.4f} (least {DARK})")
        if median * gain > BRIGHT:
            found.append(f"blown out, median luminance {median * gain:.2f} (most {BRIGHT})")
        faults += [Fault(record.index, number, "exposure", f"condition {condition.name}: {m}") for m in found]
    if seen.spike * 2.0 ** record.conditions[0].exposure_ev > 1.0:
        message = f"a pixel brighter than white is over {FIREFLY:.0f} times brighter than all its neighbours"
        faults.append(Fault(record.index, number, "fireflies", message))
    return faults


def _removal(record: SceneRecord, view: ViewData) -> Iterator[str]:
    everything = LightingCondition.unchanged(view.lights)
    for name, alpha in view.coverage.items():
        change = np.abs(compose.effect(view, name, everything))
        seen = alpha >= 1
        if seen.sum() > 16 and not change[seen].any():
            yield f"removing {name} changes nothing where it was"


def verify_pair(record: SceneRecord, first: tuple[int, ViewData], second: tuple[int, ViewData]) -> list[Fault]:
    """Carry the depth of each view into the other: too small shows in one direction, too large in the other."""
    faults = []
    for (a, view_a), (b, view_b) in ((first, second), (second, first)):
        cameras = record.scene.cameras
        found = reprojection_error(view_a.geometry.z_depth, cameras[a], view_b.geometry.z_depth, cameras[b])
        if found.compared == 0:
            continue
        if found.consistent < CONSISTENT or found.median_relative_error > DEPTH_ERROR:
            message = (
                f"{found.consistent:.1%} of the depth agrees with view {b} (least {CONSISTENT:.0%}), "
                f"median error {found.median_relative_error:.2e} (most {DEPTH_ERROR:.0e})"
            )
            faults.append(Fault(record.index, a, "reprojection", message))
    return faults
