"""Export to DTC-MultiLight, the layouts of MV-CoLight: which scenes go where, and the processes that write them.

Scenes of split `train` go to `DTC-MultiLight-2D` and `-3D`, all others to `DTC-MultiLight-2DEval` and `-3DEval`. A
scene's folder gets its name when it is whole, so an export that was stopped goes on where it was. `train.json` and
`test.json` name roots and scenes as the published configuration files do.
"""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.errors import UserError
from multilight.datagen.export.dtc.readme import write_readme
from multilight.datagen.export.dtc.request import DtcExport
from multilight.datagen.export.dtc.scene import Frame
from multilight.datagen.export.dtc.work import Job, export_scene
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import Copy, in_processes, making
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import write_text
from multilight.scenes.gaussians.curves import fold

ROOTS: dict[str, str] = {
    "2d-train": "DTC-MultiLight-2D",
    "3d-train": "DTC-MultiLight-3D",
    "2d-eval": "DTC-MultiLight-2DEval",
    "3d-eval": "DTC-MultiLight-3DEval",
}
LISTS = {"train": "train.json", "eval": "test.json"}


@dataclass(frozen=True)
class DtcOutcome:
    """How many scenes were written and were there, and why others were passed over (scene index → one line)."""

    written: int
    kept: int
    skipped: dict[int, str]


def export_dtc(request: DtcExport, report: Report) -> DtcOutcome:
    """Write what is missing of the roots; reports (views written, views to write).

    Raises `UserError` where the dataset cannot be read or holds no scene for the part, where a number is out of its
    range, or where the output folder holds something else, or an export made otherwise.
    """
    source = open_dataset(request.address, where=request.where, on_broken=request.on_broken)
    every = list(source.scenes())
    records = [record for record in every if _kinds(record, request)]
    if every:
        _check(request, records)
    settings = {key: getattr(request, key) for key in ("conditions", "exposures", "size", "map_size")}
    with making(request.out, "dtc-multilight", source, settings) as copy:
        jobs = [_job(request, source, record, copy) for record in records]
        missing = [job for job in jobs if job.flat or job.maps]
        done, total = 0, sum(job.views for job in missing)
        workers = min(request.workers or len(os.sched_getaffinity(0)), max(len(missing), 1))
        written = 0
        for job, made in in_processes(export_scene, missing, workers):
            with source.passing_over(job.index):
                for folder, files in made().items():
                    copy.add(folder, job.index, files)
                written += 1
            done += job.views
            report(done, total)
        held = {part.scene for part in copy.parts.values()}
        there = [record for record in every if record.index in held]
        _write_lists(request.out, there)
        write_readme(request.out, request.address, there)
        copy.finish(*(name for name in (*LISTS.values(), "README.md") if (request.out / name).is_file()))
    return DtcOutcome(written, len(jobs) - len(missing), source.skipped)


def scene_name(index: int) -> str:
    """Return a scene's folder name: `scene_00042`."""
    return f"scene_{index:05d}"


def _kinds(record: SceneRecord, request: DtcExport) -> list[str]:
    """Return the parts, `2d-train` say, that a scene belongs to and that were asked for."""
    end = "train" if record.split == "train" else "eval"
    return [kind for kind in ROOTS if kind.endswith(end) and request.part in (kind, "all")]


def _check(request: DtcExport, records: Sequence[SceneRecord]) -> None:
    if not records:
        wanted = "of split train" if request.part.endswith("train") else "of another split than train"
        raise UserError(f"{request.address} holds no scene {wanted}, which --part {request.part} is made of")
    for option, value in (("exposures", request.exposures), ("workers", request.workers)):
        if value is not None and value < 1:
            raise UserError(f"--{option} {value} must be 1 or more")
    try:
        fold(request.map_size)
    except ValueError as error:
        raise UserError(f"--map-size {request.map_size}: {error}") from None
    for record in records:
        Frame.fit(request.size, record.views[0].height, record.views[0].width)
        most = len(record.conditions)
        if request.conditions is not None and not 1 <= request.conditions <= most:
            raise UserError(
                f"--conditions {request.conditions} must be 1 to {most}, as many as scene {record.index} has"
            )
        if not record.scene.insertable:
            raise UserError(f"scene {record.index} of {request.address} has no insertable object to composite")


def _job(request: DtcExport, source: DatasetSource, record: SceneRecord, copy: Copy) -> Job:
    """Plan what is missing of a scene."""
    folders = {kind[:2]: f"{ROOTS[kind]}/{scene_name(record.index)}" for kind in _kinds(record, request)}
    missing = {dimension: folder for dimension, folder in folders.items() if not copy.keeps(folder, record.index)}
    views, evaluation, scene = len(record.views), record.split != "train", source.alone(record.index)
    return Job(request, scene, record.index, views, evaluation, missing.get("2d"), missing.get("3d"))


def _write_lists(out: Path, records: Sequence[SceneRecord]) -> None:
    """Write `train.json` and `test.json`: a group a split, with the keys that the 2D and the 3D loader want."""
    for end, file in LISTS.items():
        flat, maps = (out.resolve() / ROOTS[f"{dimension}-{end}"] for dimension in ("2d", "3d"))
        groups: dict[str, list[str]] = {}
        for record in records:
            name = scene_name(record.index)
            if (record.split == "train") == (end == "train") and ((flat / name).is_dir() or (maps / name).is_dir()):
                groups.setdefault(record.split, []).append(name)
        roots = {"data_root": str(flat), "data_root_2d": str(flat), "data_root_3d": str(maps)}
        if groups:
            content = {split: roots | {"scenes": names} for split, names in groups.items()}
            write_text(out / file, json.dumps(content, indent=1) + "\n")
