"""The export of a dataset's scenes as USD stages: a folder a scene."""

from pathlib import Path

from multilight.datagen.errors import UserError
from multilight.datagen.production.library import open_library_again
from multilight.datagen.storage.copies import Report, making
from multilight.datagen.storage.manifest import scene_part
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.source import DatasetSource
from multilight.datagen.usd.check import stage_faults
from multilight.datagen.usd.stage import STAGE, write_stage
from multilight.scenes.assets.library import AssetLibrary


def export_usd(
    source: DatasetSource, out: Path, report: Report, *, scene: int | None = None, assets: tuple[Path, ...] = ()
) -> list[Path]:
    """Write a stage for each scene of a dataset, or for one; return the stages, `out/scene_000003/scene.usdc`.

    A scene's folder appears only when its stage is whole and passes USD's validators; folders that are there, and
    undamaged, are kept.
    `assets` are the folders of models that the dataset was made with, and its background where that has moved. Raises
    `UserError` naming what is wrong.
    """
    if scene is not None and scene not in source.indices:
        raise UserError(f"--scene {scene} is not in {source.address}; it has {len(source.indices)} scene(s)")
    records, total = (source.scenes(), len(source.indices)) if scene is None else (iter([source.scene(scene)]), 1)
    library = open_library_again(source.record, Path(source.address), assets)
    made = []
    with making(out, "usd", source, {}) as copy:
        for done, record in enumerate(records):
            report(done, total)
            name, part = f"scene_{record.index:06d}", scene_part(source, record.index)
            if not copy.keeps(name, part):
                with copy.filling_part(name, part) as folder:
                    _write(record, library, folder)
            made.append(out / name / STAGE)
        copy.finish()
    report(total, total)
    return made


def _write(record: SceneRecord, library: AssetLibrary, folder: Path) -> None:
    """Write one scene and check it."""
    path = write_stage(record, library, folder)
    if faults := stage_faults(path):
        raise UserError(f"scene {record.index}: its stage does not pass USD's validators: {faults[0]}")
