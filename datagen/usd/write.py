"""The export of a dataset's scenes as USD stages: a folder a scene."""

from pathlib import Path

from pxr import Usd, UsdValidation

from multilight.datagen.errors import UserError
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import making
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.usd.stage import STAGE, write_stage
from multilight.scenes.assets.library import AssetLibrary


def export_usd(
    source: DatasetSource, library: AssetLibrary, out: Path, report: Report, *, scene: int | None = None
) -> list[Path]:
    """Write a stage for each scene of a dataset, or for one; return the stages, `out/scene_000003/scene.usdc`.

    A scene's folder appears only when its stage is whole and passes USD's validators; folders that are there, and
    undamaged, are kept. `library` holds the assets that the dataset was made with. Raises `UserError` naming what is
    wrong.
    """
    if scene is not None and scene not in source.indices:
        raise UserError(f"--scene {scene} is not in {source.address}; it has {len(source.indices)} scene(s)")
    records, total = (source.scenes(), len(source.indices)) if scene is None else (iter([source.scene(scene)]), 1)
    made = []
    with making(out, "usd", source, {}) as copy:
        for done, record in enumerate(records):
            report(done, total)
            name = f"scene_{record.index:06d}"
            if not copy.keeps(name, record.index):
                with copy.filling_part(name, record.index) as folder:
                    if faults := stage_faults(write_stage(record, library, folder)):
                        raise UserError(f"scene {record.index}: its stage does not pass USD's validators: {faults[0]}")
            made.append(out / name / STAGE)
        copy.finish()
    report(total, total)
    return made


def stage_faults(path: Path) -> list[str]:
    """Return what USD's own validators (what `usdchecker` runs) find wrong with a stage, one line each."""
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))
    places = [", ".join(str(s.GetPrim().GetPath()) for s in error.GetSites() if s.IsPrim()) for error in found]
    return [f"{e.GetName()}: {e.GetMessage()} {place}".strip() for e, place in zip(found, places, strict=True)]
