"""What models are compared on: fixed tuples of a dataset, how each is lit, and what makes it hard."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.errors import UserError
from multilight.datagen.storage.open_training import open_training
from multilight.datagen.storage.records import SceneRecord
from multilight.lights.photometry.angular_size import angular_diameter
from multilight.lights.spec import EmissiveLight
from multilight.model.configs.stage2d import FAULTS
from multilight.model.data.dataset import Given, MultiLightDataset, make_samples
from multilight.model.data.settings import SampleSettings
from multilight.model.evaluation.settings import CaseSettings
from multilight.scenes.appearance import is_mirror, material_class
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.assets.splits import Split
from multilight.scenes.cameras.pinhole import camera_of
from multilight.scenes.spec import Camera

HARD = np.radians(3.0)
"""A light of a smaller angular diameter throws shadows with hard edges: a penumbra below a twentieth of the height."""
VARIANT, RIGHTLY = "with: ", "light that is right"
"""How subsets begin whose pictures are others made over, and the name of the one that needs no new light."""
DOMINANT = 0.5
"""Least fraction of the picture's light that a small light must give for its shadows to be seen."""


@dataclass(frozen=True)
class Case:
    """One picture to harmonize, and the truth where there is one.

    composite, background, target (H, W, 3) float32 display-encoded sRGB in [0, 1]; depth (H, W) float32 in [0, 1] as
    networks see it; mask (H, W) float32 in [0, 1]; effect (H, W, 3) float32 signed. `valid` (H, W) says where the
    truth is known (None: everywhere). With `fit_exposure` a picture may be exposed anew before it is judged.
    """

    name: str
    composite: Float32 = field(repr=False)
    background: Float32 = field(repr=False)
    depth: Float32 = field(repr=False)
    mask: Float32 = field(repr=False)
    target: Float32 | None = field(default=None, repr=False)
    effect: Float32 | None = field(default=None, repr=False)
    valid: Mask | None = field(default=None, repr=False)
    fit_exposure: bool = False


@dataclass(frozen=True)
class Group:
    """Views of one scene with one object under one pair of lightings; `subsets` are the rows that it counts in.

    `cameras` and `z_depth` [m] (H, W), 0 where nothing, are those of the cases, where known: for the consistency.
    """

    cases: tuple[Case, ...]
    subsets: tuple[str, ...]
    cameras: tuple[Camera, ...] = ()
    z_depth: tuple[Float32, ...] = ()


LazyGroup = Callable[[], Group]
"""A group that is read when it is called for."""


def dataset_groups(address: str | Path, settings: CaseSettings, where: str | None = None) -> list[LazyGroup]:
    """Open a dataset's tuples, or those of the scenes that an SQL expression over its index chooses.

    Lighting is such as `settings` say, without augmentation. Raises `UserError` where none of the splits holds a scene.
    """
    found: list[LazyGroup] = []
    reasons = []
    variants: dict[str, dict[str, Any]] = {}
    if settings.variants:
        variants = {RIGHTLY: {"right": 1.0}} | {fault: {"faults": 1.0, "kinds": (fault,)} for fault in FAULTS}
    for split in settings.splits:
        try:
            found += _split_groups(address, split, settings, where)
            for name, values in variants.items():
                groups = _split_groups(address, split, settings, where, **values)
                found += [with_subset(group, f"{VARIANT}{name}", alone=True) for group in groups]
        except UserError as error:
            reasons.append(str(error))
    if not found:
        raise UserError(f"{address}: nothing to evaluate on: {'; '.join(reasons)}; choose others with --splits")
    return found


def with_subset(load: LazyGroup, name: str, *, alone: bool = False) -> LazyGroup:
    """Let a group count in one more subset, or in that `alone`."""

    def named() -> Group:
        group = load()
        return replace(group, subsets=(name,) if alone else (*group.subsets, name))

    return named


def _split_groups(
    address: str | Path, split: Split, settings: CaseSettings, where: str | None, **values: Any
) -> list[LazyGroup]:
    """Open a split's tuples; `values` are further settings of the samples."""
    first = SampleSettings(
        size=settings.size, seed=settings.seed, split=split, where=where, lighting=settings.lighting, length=1,
        augment=False, **values,
    )  # fmt: skip
    index = open_training(address, where=first.filter()).index
    if not len(index):
        raise UserError(f"no scene of split {split!r}")
    samples = MultiLightDataset(address, replace(first, views=min(settings.views, *index["views"].to_list())))
    count = min(settings.groups, len(samples.plan.places))
    return [functools.partial(_drawn_group, samples, split, number) for number in range(count)]


def _drawn_group(samples: MultiLightDataset, split: Split, number: int) -> Group:
    draw = samples.plan.draw(0, number)
    record = samples.source.source.scene(draw.place.scene)
    views = [samples.source.view(draw.place.scene, view) for view in draw.views]
    made = make_samples(views, draw, samples.settings, samples.lights(draw.place.scene, views[0].lights), Given())
    cases, cameras, depths = [], [], []
    for view, sample in zip(draw.views, made, strict=True):
        arrays = {name: values.numpy() for name, values in sample.items()}
        if arrays["mask"].sum() < samples.settings.visible:
            continue
        name = f"scene {record.index}, {draw.place.object}, view {view}"
        pictures: dict[str, Any] = {
            key: arrays[key].transpose(1, 2, 0) for key in ("composite", "background", "target", "effect")
        }
        cases.append(Case(name, **pictures, depth=arrays["depth"][0], mask=arrays["mask"][0]))
        cameras.append(camera_of(arrays["K"], arrays["c2w"], arrays["mask"].shape[1:]))
        depths.append(arrays["z_depth"][0])
    fractions = dict(zip(views[0].lights, made[0]["light_fraction"].tolist(), strict=False))
    subsets = subsets_of(record, draw.place.object, fractions)
    return Group(tuple(cases), (split, *subsets), tuple(cameras), tuple(depths))


def subsets_of(record: SceneRecord, name: str, fractions: dict[str, float]) -> tuple[str, ...]:
    """Name the subsets that an object counts in: its kind of scene, and what is hard about it.

    `fractions` is each light's part of the pictures' light. "hard shadow": most of it comes from one light of a small
    angular diameter; "emissive": the object glows; "mirror": it, or something of the setting, is a mirror.
    """
    body = record.scene.body(name)
    place = np.array(body.world_from_body)[:3, 3]
    lit = [(light, fractions[light.name]) for light in record.rig.lights]
    found = [f"kind: {record.scene.kind}"]
    if any(isinstance(light, EmissiveLight) and light.body == name and fraction > 0 for light, fraction in lit):
        found.append("emissive")
    sizes = [angular_diameter(light, place) for light, fraction in lit if fraction >= DOMINANT]
    if any(size is not None and size < HARD for size in sizes):
        found.append("hard shadow")
    if any(material_class(m) == "mirror" for m in body.materials) or any(map(is_mirror, record.scene.bodies)):
        found.append("mirror")
    return tuple(found)
