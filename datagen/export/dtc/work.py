"""One scene in the DTC-MultiLight layouts: views are read twice, to meter the lightings and to write them.

Of a view only what is being written is held in memory. The 3D maps take their colours from the very pictures that
the 2D layout stores.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.errors import StoreError
from multilight.datagen.export.dtc import maps2d, maps3d
from multilight.datagen.export.dtc.request import DtcExport
from multilight.datagen.export.dtc.scene import Frame, Geometry, Lighting, survey
from multilight.datagen.storage.copies import files_of, whole_folder
from multilight.datagen.storage.manifest import FileEntry
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.tuples import compose
from multilight.lights.display.reinhard import tone_map
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.gaussians.from_views import SceneGaussians
from multilight.scenes.random_streams import Streams


@dataclass(frozen=True)
class Job:
    """One scene to export, the only one of `source`; `flat` and `maps` are the 2D and 3D folders in `request.out`, None
    where there already."""

    request: DtcExport
    source: DatasetSource
    index: int
    views: int
    evaluation: bool
    flat: str | None
    maps: str | None


@dataclass(frozen=True)
class _Scene:
    """An opened scene, surveyed under the lightings that are written, and its folders in the making."""

    source: DatasetSource
    record: SceneRecord
    frame: Frame
    lightings: tuple[Lighting, ...]
    geometry: Geometry
    name: str
    flat: Path | None
    maps: Path | None

    def picture(self, radiance: Float32, lighting: Lighting, step: int) -> UInt8:
        """Tone-map and shrink a rendered picture, in this order, as published."""
        return self.frame.shrink(tone_map(radiance, lighting.metering, step))


@dataclass(frozen=True)
class Choice:
    """What an evaluation scene shows: an object lit by `insert` in pictures lit by `base`, each at an exposure."""

    object: int
    base: LightingCondition
    insert: LightingCondition
    base_step: int
    insert_step: int


def export_scene(job: Job) -> dict[str, dict[str, FileEntry]]:
    """Write one scene; returns the files of each folder. Raises `StoreError` where it cannot be read, or is empty."""
    request, source = job.request, job.source
    record = source.scene(job.index)
    frame = Frame.fit(request.size, record.views[0].height, record.views[0].width)
    conditions = record.conditions[: request.conditions]
    choice = choose(record, conditions, request.exposures)
    lightings, geometry = survey(source, record, frame, (choice.base, choice.insert) if job.evaluation else conditions)
    folders = [folder for folder in (job.flat, job.maps) if folder]
    with contextlib.ExitStack() as stack:
        flat, maps = (stack.enter_context(whole_folder(request.out, f)) if f else None for f in (job.flat, job.maps))
        scene = _Scene(source, record, frame, lightings, geometry, Path(folders[0]).name, flat, maps)
        colors = maps3d.ColorMaps(_gaussians(scene, request.map_size)) if maps else None
        if job.evaluation:
            _evaluation(scene, choice, colors)
        else:
            _training(scene, request.exposures, colors)
    return {folder: files_of(request.out, folder) for folder in folders}


def choose(record: SceneRecord, conditions: Sequence[LightingCondition], exposures: int) -> Choice:
    """Choose what an evaluation scene shows: two different lightings where there are two, from the scene's own seed."""
    rng = Streams(record.seed, record.index)("export/dtc-multilight")
    base, insert = rng.permutation(max(len(conditions), 2))[:2] % len(conditions)
    steps = rng.integers(exposures, size=2)
    number = int(rng.integers(len(record.scene.insertable)))
    return Choice(number, conditions[int(base)], conditions[int(insert)], int(steps[0]), int(steps[1]))


def _gaussians(scene: _Scene, side: int) -> SceneGaussians:
    spec = scene.record.scene
    try:
        return maps3d.make_gaussians(scene.geometry, [spec.instance_id(name) for name in spec.insertable], side)
    except ValueError as error:
        raise StoreError(f"scene {spec.index}: {error}") from None


def _training(scene: _Scene, exposures: int, colors: maps3d.ColorMaps | None) -> None:
    objects = scene.record.scene.insertable
    folders = [lighting.folder(step) for lighting in scene.lightings for step in range(exposures)]
    if scene.flat:
        maps2d.write_training_geometry(scene.flat, scene.name, folders, scene.geometry)
    for number, view in enumerate(scene.source.views(scene.record)):
        for lighting in scene.lightings:
            lit = lighting.condition
            radiances = [compose.target(view, lit), *(compose.background(view, name, lit) for name in objects)]
            for step in range(exposures):
                folder = lighting.folder(step)
                image, *backgrounds = (scene.picture(radiance, lighting, step) for radiance in radiances)
                if scene.flat:
                    maps2d.write_training_pictures(scene.flat / folder, number, image, backgrounds)
                if colors:
                    colors.fill(f"{folder}/img", number, image)
                    for j, background in enumerate(backgrounds):
                        colors.fill(f"{folder}/bg{j}", number, background)
    if scene.maps and colors:
        maps3d.write_training_maps(scene.maps, scene.name, folders, colors, objects=len(objects))


def _evaluation(scene: _Scene, choice: Choice, colors: maps3d.ColorMaps | None) -> None:
    name = scene.record.scene.insertable[choice.object]
    base, insert = scene.lightings
    for number, view in enumerate(scene.source.views(scene.record)):
        target = scene.picture(compose.target(view, base.condition), base, choice.base_step)
        background = scene.picture(compose.background(view, name, base.condition), base, choice.base_step)
        inserted = scene.picture(compose.target(view, insert.condition), insert, choice.insert_step)
        composite = maps2d.paste(inserted, background, scene.geometry.masks[number, choice.object])
        if scene.flat:
            depth, mask = scene.geometry.depths[number], scene.geometry.environments[number]
            maps2d.write_evaluation_pictures(
                scene.flat, number, composite=composite, bg=background, gt=target, depth=depth, mask=mask
            )
        if colors:
            colors.fill("composite", number, composite)
            colors.fill("gt", number, target)
    if scene.flat:
        maps2d.write_evaluation_transforms(scene.flat, scene.name, scene.geometry)
    if scene.maps and colors:
        maps3d.write_evaluation_maps(scene.maps, colors)
