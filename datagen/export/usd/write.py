"""The export of a dataset's scenes as USD stages: a folder a scene."""

import shutil
import uuid
from collections.abc import Callable
from pathlib import Path

from datagen.background import open_library
from datagen.errors import UserError, full_disk_told
from datagen.export.usd.check import stage_faults
from datagen.export.usd.stage import STAGE, write_stage
from datagen.records import SceneRecord
from datagen.source import DatasetSource
from scenes.assets.library import AssetLibrary

Report = Callable[[float, float], None]
"""Called with the scenes finished and the scenes planned."""


def export_usd(
    source: DatasetSource, out: Path, report: Report, *, scene: int | None = None, assets: tuple[Path, ...] = ()
) -> list[Path]:
    """Write a stage for each scene of a dataset, or for one; return the stages, `out/scene_000003/scene.usdc`.

    A scene's folder appears only when its stage is whole and passes USD's validators; folders that are there are kept.
    `assets` are the folders of models that the dataset was made with. Raises `UserError` naming what is wrong.
    """
    if scene is not None and scene not in source.indices:
        raise UserError(f"--scene {scene} is not in {source.address}; it has {len(source.indices)} scene(s)")
    records, total = (source.scenes(), len(source.indices)) if scene is None else (iter([source.scene(scene)]), 1)
    library = open_library(source.record.config, assets)
    made = []
    for done, record in enumerate(records):
        report(done, total)
        folder = out / f"scene_{record.index:06d}"
        if not (folder / STAGE).is_file():
            with full_disk_told(out if out.exists() else Path.cwd()):
                _write(record, library, folder)
        made.append(folder / STAGE)
    report(total, total)
    return made


def _write(record: SceneRecord, library: AssetLibrary, folder: Path) -> None:
    """Write one scene under a temporary name, check it and rename it."""
    work = folder.with_name(f".{folder.name}-{uuid.uuid4().hex[:8]}.tmp")
    try:
        work.mkdir(parents=True)
        path = write_stage(record, library, work)
        if faults := stage_faults(path):
            raise UserError(f"scene {record.index}: its stage does not pass USD's validators: {faults[0]}")
        work.rename(folder)
    finally:
        shutil.rmtree(work, ignore_errors=True)
