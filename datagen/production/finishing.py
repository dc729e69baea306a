"""What is there of a dataset that is continued, and finishing it: index, credits and hashes in `dataset.json`."""

import hashlib
import shutil
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.index import index_bytes, index_row, table_of
from multilight.datagen.storage.place import find_place
from multilight.datagen.storage.records import AssetCredit, DatasetRecord, SceneRecord
from multilight.datagen.storage.source import read_index, read_record, scene_names
from multilight.datagen.storage.store import write_text
from multilight.datagen.verification.dataset import check_files, credits_in_order
from multilight.scenes.files.whole import write_whole


@dataclass(frozen=True)
class Survey:
    """Sound scenes by their rows of the index, the credits they ask for, and damaged scenes with the reason.

    `stated` are the hashes of records by the index that was found, empty where that was not whole.
    """

    rows: dict[int, dict[str, Any]] = field(default_factory=dict)
    credits: dict[str, AssetCredit] = field(default_factory=dict)
    damaged: dict[int, str] = field(default_factory=dict)
    stated: dict[int, str] = field(default_factory=dict)

    def add(self, record: SceneRecord) -> None:
        """Count a sound scene in."""
        self.rows[record.index] = index_row(record)
        self.credits.update((credit.id, credit) for credit in record.assets)


def survey(root: Path, dataset: DatasetRecord, *, contents: bool) -> Survey:
    """Look at all scenes in a dataset's folder: names, sizes and records, with `contents` the hashes of views too.

    Then a file too many is damage as well: what is made anew has none.
    """
    place, found = find_place(root), Survey()
    try:
        table = read_index(place, dataset)
        found.stated.update(table.select("index", "record_sha256").iter_rows())
    except StoreError:  # it is written anew
        pass
    for index in (number for number in scene_names(place) or () if number < dataset.config.scenes):
        files = check_files(place, index, dataset, contents=contents, extras=contents)
        if files.record is None or files.faults:
            found.damaged[index] = files.faults[0].message
        elif found.stated.get(index, files.record.record_sha256) != files.record.record_sha256:
            found.damaged[index] = "scene.json is not the one that the index states"
        else:
            found.add(files.record)
    return found


def finish(root: Path, dataset: DatasetRecord, there: Survey, made: Iterable[int] = ()) -> tuple[int, ...]:
    """Write the index and `dataset.json` anew where they do not agree with the scenes, those just `made` among them.

    Returns the scenes made that are not as the index stated them.
    """
    place = find_place(root)
    logs = root / "logs"
    if logs.is_dir() and not any(logs.iterdir()):
        shutil.rmtree(logs)
    changed = []
    for index in made:
        record = read_record(place, index)
        there.add(record)
        if there.stated.get(index, record.record_sha256) != record.record_sha256:
            changed.append(index)
    content = index_bytes(table_of(there.rows.values()))
    if not (root / "index.parquet").is_file() or (root / "index.parquet").read_bytes() != content:
        with write_whole(root / "index.parquet") as work:
            work.write_bytes(content)
    finished = dataset.model_copy(
        update={
            "assets": credits_in_order(there.credits),
            "index_sha256": hashlib.sha256(content).hexdigest(),
            "index_rows": len(there.rows),
        }
    ).sealed()
    if finished != dataset:
        write_text(root / "dataset.json", finished.model_dump_json(indent=1))
    return tuple(changed)
