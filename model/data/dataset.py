"""PyTorch datasets over a native or packed dataset: map-style and streaming."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
import polars as pl
import torch
from torch import Tensor
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from multilight.datagen.errors import UserError
from multilight.datagen.storage.open_training import open_training
from multilight.datagen.storage.packed import PackedView
from multilight.datagen.tuples.condition_files import read_condition
from multilight.lights.relight import gain_matrix
from multilight.lights.spec import LightingCondition
from multilight.model.data.augment import (
    PLAIN,
    CameraResponse,
    Crop,
    centre_crop,
    cropped,
    cropped_camera,
    draw_camera,
    draw_crop,
    draw_paint,
    resize,
)
from multilight.model.data.faults import Placement, draw_placement, misplaced_tuple, wrong_depth
from multilight.model.data.lighting import light_fractions, lit_conditions, tints
from multilight.model.data.lights import LEAST, SceneLights, read_lights
from multilight.model.data.mixing import UNPAINTED, Pictures, mix_tuple
from multilight.model.data.plan import Draw, Plan, places_of
from multilight.model.data.settings import RIGHT, SampleSettings
from multilight.scenes.arrays import Float32, Mask

Sample = dict[str, Any]
"""Tensors and `meta`, as `MultiLightDataset` describes them."""


class Lit(TypedDict):
    """How a tuple is lit and taken: (L, 3) linear gains of the object, and of all else, its own lights (L,), camera."""

    insert: Float32
    base: Float32
    own: Mask
    camera: CameraResponse


class MultiLightDataset(Dataset[Sample]):
    """Tuples with lighting made on the fly: a pure function of (seed, epoch, index), whatever the workers.

    A sample, with S the size and, where a sample is a group of V views, V in front of every tensor:

        composite, background, target  (3, S, S)  display-encoded sRGB in [0, 1]
        effect   (3, S, S)  target - background, signed
        depth    (1, S, S)  z_depth over the largest of the group; 1 where there is nothing; with `faults`, wrong
        z_depth  (1, S, S)  metres along the optical axis; 0 where there is nothing
        mask     (1, S, S)  the object's coverage of the pixel in [0, 1]
        glow     (1, S, S)  the fraction of the object's light in the composite that is its own, times `mask`
        K        (3, 3)     pixels, pixel centres at (x + 0.5, y + 0.5)
        c2w      (4, 4)     camera to world, OpenGL axes, metres
        insert_gains, base_gains  (N, 3)  linear gains of the N lights in red, green and blue, exposure and white
                                          balance included; 0 where a light is off
        light_fraction   (N,)    each light's fraction of the light in the target, all views together
        light_mask       (N,)    bool, false where it is filled up
        light_kind       (N,)    int64, numbers of `lights.KINDS`
        light_position   (N, 3)  metres, in the camera's OpenGL axes; 0 for environments and suns
        light_direction  (N, 3)  unit, in the same axes: where it shines; 0 for environments and glowing bodies
        light_towards    (N, 3)  unit, in the same axes: from the object to the light; 0 for environments
        light_amount     (N, 3)  before gains: radiance [W/(m² sr)], of suns irradiance [W/m²], of points and spots
                                 intensity [W/sr]
        light_size       (N,)    angular diameter [rad] as seen from the object; 0 for environments and glowing bodies

    float32 but for the two, and `meta`: scene, view (of a group the first), emissive (ints), object, kind (strings).
    The background is lit as the target is, by `base_gains`; the object in the composite by `insert_gains`, but where
    lighting is drawn, what glows of it as in the target. N is 8, or the number of lights in the chosen scene that has
    most, where that is more.
    """

    def __init__(self, address: str | Path, settings: SampleSettings) -> None:
        """Open a dataset at any address; raises `StoreError` and `UserError` naming the value and the remedy."""
        self.source = open_training(address, where=settings.filter())
        config = self.source.source.record.config
        self.settings = (
            replace(settings, lighting="wild") if settings.lighting == "random" and config.wild else settings
        )
        self._given = Given(*(_read(wanted) for wanted in (settings.insert_condition, settings.condition)))
        places, index = places_of(self.source.visible, settings), self.source.index
        self._given.check(index.filter(pl.col("index").is_in([place.scene for place in places])))
        settings.check_size(index.select(pl.min_horizontal("width", "height").min()).item())
        self.plan = Plan(places, settings, config.conditions)
        self._about = {row["index"]: row for row in index.select("index", "kind", "emissive").to_dicts()}
        self._most_lights = max(LEAST, index.select(pl.col("lights").list.len().max()).item())
        self._lights: dict[int, SceneLights] = {}
        # Shared memory, so that workers that live on from epoch to epoch learn of a new one.
        self._epoch = torch.zeros(1, dtype=torch.int64).share_memory_()
        tints()

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch that the next samples belong to."""
        self._epoch[0] = epoch

    @property
    def epoch(self) -> int:
        """The epoch that samples belong to."""
        return int(self._epoch[0])

    def __len__(self) -> int:
        return self.settings.length

    def __getitem__(self, index: int) -> Sample:
        if not 0 <= index < len(self):
            raise IndexError(f"sample {index} is outside 0..{len(self) - 1}")
        draw = self.plan.draw(self.epoch, index)
        views = [self.source.view(draw.place.scene, number) for number in draw.views]
        samples = make_samples(views, draw, self.settings, self.lights(draw.place.scene, views[0].lights), self._given)
        about = self._about[draw.place.scene]
        if self.settings.views == 1:
            sample: Sample = dict(samples[0])
        else:
            sample = {name: torch.stack([s[name] for s in samples]) for name in samples[0]}
        sample["meta"] = {
            "scene": draw.place.scene,
            "view": draw.views[0],
            "object": draw.place.object,
            "kind": about["kind"],
            "emissive": int(about["emissive"]),
        }
        return sample

    def lights(self, scene: int, names: tuple[str, ...]) -> SceneLights:
        """Return a scene's lights in the order of `names`, its layers; raises `StoreError`."""
        if scene not in self._lights:
            self._lights[scene] = read_lights(self.source.source.place, scene, names, self._most_lights)
        return self._lights[scene]


class MultiLightStream(IterableDataset[Sample]):
    """The samples of a `MultiLightDataset`, scene after scene, so that remote scenes are fetched once.

    The samples of an epoch are cut into equal parts, one for each rank and worker.
    """

    def __init__(
        self, address: str | Path, settings: SampleSettings, *, rank: int | None = None, world: int | None = None
    ) -> None:
        """Open a dataset; `rank` of `world` processes (default: as torch.distributed says, where it runs)."""
        distributed = torch.distributed.is_available() and torch.distributed.is_initialized()
        self.rank = rank if rank is not None else torch.distributed.get_rank() if distributed else 0
        self.world = world if world is not None else torch.distributed.get_world_size() if distributed else 1
        self.samples = MultiLightDataset(address, settings)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch that the next iteration shows."""
        self.samples.set_epoch(epoch)

    def __len__(self) -> int:
        return len(self.samples) // self.world

    def __iter__(self) -> Iterator[Sample]:
        for index in self._own_indices():
            yield self.samples[int(index)]

    def _own_indices(self) -> np.ndarray:
        """Return the indices of this rank's and worker's samples, scene after scene."""
        plan, epoch = self.samples.plan, self.samples.epoch
        scenes = np.array([plan.places[plan.place(epoch, i)].scene for i in range(len(self.samples))])
        order = np.argsort(scenes, kind="stable")
        own = order[self.rank * len(self) : (self.rank + 1) * len(self)]
        worker = get_worker_info()
        return own if worker is None else np.array_split(own, worker.num_workers)[worker.id]


@dataclass(frozen=True)
class Given:
    """Conditions that are not drawn: of the object in the composite, and of all else."""

    insert: LightingCondition | None = None
    base: LightingCondition | None = None

    def check(self, index: pl.DataFrame) -> None:
        """Raise `UserError` where a scene of the index lacks a light that a condition names."""
        for condition in filter(None, (self.insert, self.base)):
            for light in condition.gains:
                lacking = index.filter(~pl.col("lights").list.contains(light))
                if len(lacking):
                    scene, there = lacking.select("index", "lights").row(0)
                    raise UserError(
                        f"condition {condition.name!r}: scene {scene} has no light {light!r} but {', '.join(there)}; "
                        "choose the scenes that it was made for by where, 'index = 3' say"
                    )


def _read(condition: Path | str | LightingCondition | None) -> LightingCondition | None:
    return read_condition(Path(condition)) if isinstance(condition, (Path, str)) else condition


def make_samples(
    views: list[PackedView], draw: Draw, settings: SampleSettings, lights: SceneLights, given: Given
) -> list[dict[str, Tensor]]:
    """Light, mix, augment and frame the views of one sample: a dict of tensors each, without the view axis."""
    rng, own = draw.rng, lights.glow[draw.place.object][: len(views[0].lights)]
    if draw.conditions is None:
        temperature = lights.temperature[: len(views[0].lights)]
        insert, base = lit_conditions(rng, views, 2, temperature, wild=settings.lighting == "wild")
    else:
        insert, base = (views[0].conditions[number] for number in draw.conditions)
    if given.base:
        base = gain_matrix(views[0].lights, given.base)
    if given.insert:
        insert = gain_matrix(views[0].lights, given.insert)
    elif draw.conditions is None:
        insert[own] = base[own]  # its glow is the object's own, and stays
    right = settings.right if settings.right is not None else RIGHT * settings.augment
    if right and rng.random() < right and not given.insert:
        insert = base
    camera = draw_camera(rng) if settings.augment else PLAIN
    mirrored = bool(settings.augment and rng.random() < 0.5)
    faulty, painter = rng.spawn(2)  # of their own, so that samples without a fault are as they were
    paint = draw_paint(painter) if settings.augment else UNPAINTED
    faults = faulty.random() < settings.faults
    fault = settings.kinds[faulty.integers(len(settings.kinds))] if faults else None
    lit: Lit = {"insert": insert, "base": base, "own": own, "camera": camera}
    result = []
    for view in views:
        pictures = _mixed(view, draw.place.object, draw_placement(faulty, fault), paint, lit)
        crop = centre_crop(*view.z_depth.shape)
        if settings.augment:
            crop = draw_crop(rng, pictures.mask[0].numpy(), mirrored=mirrored)
        result.append(cropped_sample(view, pictures, crop, settings.size))
    largest = max(float(sample["z_depth"].max()) for sample in result)
    common = {
        "insert_gains": lights.filled(insert * camera.gain),
        "base_gains": lights.filled(base * camera.gain),
        "light_fraction": lights.filled(light_fractions(views, base)),
    }
    for view, sample in zip(views, result, strict=True):
        sample |= common | lights.seen(view.c2w, draw.place.object, mirrored=mirrored)
        nothing = (sample["z_depth"] <= 0).float()
        sample["depth"] = sample["z_depth"].div(max(largest, 1e-6)).add_(nothing)
        if fault:
            sample["depth"] = wrong_depth(sample["depth"], fault, faulty)
    return result


def _mixed(view: PackedView, name: str, place: Placement | None, paint: Float32, lit: Lit) -> Pictures:
    """Mix an object's tuple, repainted and where it is, or pasted at `place` as it is."""
    return mix_tuple(view, name, paint=paint, **lit) if place is None else misplaced_tuple(view, name, place, **lit)


def cropped_sample(view: PackedView, pictures: Pictures, crop: Crop, size: int) -> dict[str, Tensor]:
    """Crop and resize what was mixed; the sample lacks only `depth`, which is relative to the group's largest."""
    parts = [cropped(picture, crop) for picture in vars(pictures).values()]
    if crop.side != size:  # all in one go, which is cheaper
        parts = list(resize(torch.cat(parts), size).clamp_(0.0, 1.0).split((3, 3, 3, 1, 1)))
    composite, background, target, mask, glow = parts
    intrinsics, c2w = cropped_camera(view.K, view.c2w, crop, size)
    return {
        "composite": composite,
        "background": background,
        "target": target,
        "effect": target - background,
        "mask": mask,
        "glow": glow,
        "z_depth": resize(cropped(torch.from_numpy(view.z_depth)[None], crop), size, nearest=True),
        "K": torch.from_numpy(intrinsics),
        "c2w": torch.from_numpy(c2w),
    }
