"""Check that a dataset is what was made: everything there under its own name and unchanged, and nothing else.

`dataset.json` states the hash of the index, the index those of the records, a record those of its files.
"""

import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from multilight.datagen.errors import StoreError
from multilight.datagen.report import Report, silent
from multilight.datagen.storage.address import Place, find_place
from multilight.datagen.storage.blocks import Index, block_file, read_blocks, stated_blocks
from multilight.datagen.storage.index import ADDED, index_row
from multilight.datagen.storage.open_dataset import read_record, scene_names, spread
from multilight.datagen.storage.records import AssetCredit, DatasetRecord, SceneRecord
from multilight.datagen.storage.store import MOST_RECORD, file_sha256, parse_dataset, scene_folder, scene_number
from multilight.datagen.verification.views import Fault, Lend, verify_views

PREVIEW = "preview.png"
Result = tuple[int | None, list[Fault]]
"""What was found in a scene, or in the dataset as a whole (None)."""


@dataclass(frozen=True)
class Verification:
    """What is verified: who wrote it (schema and version), and the results."""

    written_by: str
    results: list[Result]


@dataclass(frozen=True)
class Files:
    """What the names, sizes and hashes of a scene tell: its record, where that is sound, and the views not to read."""

    record: SceneRecord | None
    faults: list[Fault]
    unread: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class _Rows:
    """An index, and for each scene its block and place in there."""

    index: Index
    places: dict[int, tuple[int, int]]

    def faults(self, record: SceneRecord) -> Iterator[str]:
        """Say what of a scene's row is wrong; that there is none is told of the dataset."""
        if record.index not in self.places:
            return
        block, place = self.places[record.index]
        table = self.index.tables[block]
        row = table.row(place, named=True)
        if block not in self.index.faults and row["record_sha256"] == record.record_sha256:
            return
        wanted = index_row(record)
        new = {name for name in ADDED if row[name] is None}
        if wrong := [name for name in wanted if row[name] != wanted[name] and name not in new]:
            yield f"index.parquet states another {', '.join(wrong)} than scene.json"


def verify_dataset(
    address: str, *, quick: bool = False, sample: int | None = None, report: Report = silent
) -> Verification:
    """Check a dataset at any address; `quick` leaves out what the pictures hold; `report` is told of scenes.

    With `sample` only so many scenes are looked into, spread evenly, besides the index and which scenes there are.
    Raises `StoreError` where there is no dataset.
    """
    place = find_place(address)
    faults: list[Fault] = []
    record: DatasetRecord | None = None
    try:
        record = parse_dataset(place.read("dataset.json", MOST_RECORD), f"{place.address}/dataset.json")
    except StoreError as error:
        if not scene_names(place):
            raise
        faults.append(_of_all(str(error)))
    version = "" if record is None else f"schema {record.schema_version}, "
    version += "" if record is None else f"multilight {record.versions.get('multilight', 'of unknown version')}"
    return Verification(version or "unknown", list(_results(place, record, faults, report, quick=quick, sample=sample)))


def _results(
    place: Place, record: DatasetRecord | None, faults: list[Fault], report: Report, *, quick: bool, sample: int | None
) -> Iterator[Result]:
    rows = _read_index(place, record, faults)
    scenes = _scenes(place, record, rows, faults)
    yield None, faults
    credits: dict[str, AssetCredit] = {}
    chosen = spread(scenes, sample)
    unread = len(chosen) < len(scenes)
    for done, number in enumerate(chosen):
        report(done, len(chosen))
        try:
            files = check_files(place, number, record)
            found = files.faults
            if files.record is not None:
                credits |= {credit.id: credit for credit in files.record.assets}
                found += [Fault(number, None, "index", message) for message in rows.faults(files.record)]
                if not quick:
                    lend = _lender(place, number)
                    found += verify_views(files.record, lend, left_out=files.unread)
            unread |= files.record is None
        except Exception as error:  # whatever a broken scene makes checks stumble over, the others are checked
            found = [Fault(number, None, "files", f"cannot be checked: {type(error).__name__}: {error}")]
        yield number, found
    if record is not None and not unread and record.assets != credits_in_order(credits):
        yield None, [_of_all("dataset.json lists other assets and licences than its scenes use")]


def check_files(
    place: Place, index: int, dataset: DatasetRecord | None, *, contents: bool = False, extras: bool = True
) -> Files:
    """Check names, sizes, record and preview of a scene; with `contents` the hashes of its views too.

    `dataset` is what the record must fit, where that is known; `extras` tells whether a file too many counts.
    """
    folder = scene_folder(index)
    try:
        record = read_record(place, index)
    except StoreError as error:
        return Files(None, [Fault(index, None, "files", str(error))])
    faults: list[Fault] = []
    if dataset is not None and (reason := dataset.misfit(record)):
        faults.append(Fault(index, None, "files", f"scene.json is of another dataset: {reason}"))
    sizes = place.files(folder)
    wanted: dict[str, tuple[int | None, int | None]] = {
        view.file: (n, view.bytes) for n, view in enumerate(record.views)
    }
    unread = set()
    for name, (number, size) in ({"scene.json": (None, None), PREVIEW: (None, None)} | wanted).items():
        if told := _file_fault(place, f"{folder}/{name}", sizes, name, size):
            faults.append(Fault(index, number, "files", told))
            unread |= set() if number is None else {number}
            continue
        stated, found = "", ""
        if name == PREVIEW and (stated := record.preview_sha256):
            found = hashlib.sha256(place.read(f"{folder}/{name}", MOST_RECORD)).hexdigest()
        elif number is not None and contents:
            with place.local(f"{folder}/{name}") as path:
                stated, found = record.views[number].file_sha256, file_sha256(path)
        if found != stated:
            told = f"{name} was changed: its hash is not the one in scene.json"
            faults.append(Fault(index, number, "files", told))
    for name in sorted(set(sizes or ()) - set(wanted) - {"scene.json", PREVIEW, "views"}) if extras else ():
        faults.append(Fault(index, None, "files", f"{folder}/{name} is no file of this dataset; remove it"))
    return Files(record, faults, unread)


def credits_in_order(credits: dict[str, AssetCredit]) -> tuple[AssetCredit, ...]:
    """Return credits as `dataset.json` lists them: each asset once, by id."""
    return tuple(credits[name] for name in sorted(credits))


def _file_fault(place: Place, path: str, sizes: dict[str, int | None] | None, name: str, stated: int | None) -> str:
    """Say what is wrong with a file by its name and size, or nothing."""
    if name not in sizes if sizes is not None else not place.exists(path):
        return f"{name} is missing"
    size = place.size(path) if sizes is None or sizes[name] is None else sizes[name]
    if size == -1:
        return f"{name} is a link or folder, not a file"
    if stated is not None and size is not None and size != stated:
        return f"{name} is truncated or replaced: {size} bytes, scene.json states {stated}"
    return ""


def _lender(place: Place, index: int) -> Lend:
    return lambda name: place.local(f"{scene_folder(index)}/{name}")


def _of_all(message: str) -> Fault:
    return Fault(None, None, "files", message)


def _read_index(place: Place, record: DatasetRecord | None, faults: list[Fault]) -> _Rows:
    """Read the index as far as it can be, and say what is wrong with it as a whole."""
    if record is None:  # nothing states which files it has
        return _Rows(Index(), {})
    index = read_blocks(place, record)
    told = [message.removeprefix(f"{place.address}/") for message in index.faults.values()]
    count = sum(map(len, index.tables.values()))
    if not told and record.index_rows != count:
        told.append(f"index.parquet has {count} rows, dataset.json states {record.index_rows}")
    if place.is_local:
        there = {f"index/{name}" for name in place.names("index") or ()}
        strays = sorted(there - {block_file(number) for number in stated_blocks(record)})
        told += [f"{name} is no file of this dataset; remove it" for name in strays]
    thrown: Counter[str] = Counter()
    for table in index.tables.values() if not told else ():
        thrown.update(table["thrown_away"].explode().drop_nulls())
    if not told and record.thrown_away != thrown:
        told.append("dataset.json counts other draws that were thrown away than its scenes")
    faults += [Fault(None, None, "index", message) for message in told]
    return _Rows(index, {n: (b, place) for b, t in index.tables.items() for place, n in enumerate(t["index"])})


def _scenes(place: Place, record: DatasetRecord | None, rows: _Rows, faults: list[Fault]) -> list[int]:
    """List the scenes to check, and name those that are missing or too many."""
    names = place.names("scenes")
    if names is None:  # the place cannot list
        return sorted(rows.places)
    found = {number for name in names if (number := scene_number(name)) is not None}
    for name in names:
        if scene_number(name) is None:
            faults.append(_of_all(f"scenes/{name} is no scene of this dataset; remove it"))
    for number in sorted(set(rows.places) - found):
        faults.append(Fault(number, None, "files", f"{scene_folder(number)} is missing, the index has a row of it"))
    if rows.index.tables:
        for number in sorted(found - set(rows.places)):
            faults.append(Fault(number, None, "index", "index.parquet has no row of it"))
    if record is not None:
        for number in sorted(n for n in found if n >= record.config.scenes):
            faults.append(
                Fault(number, None, "files", f"it lies beyond the dataset's {record.config.scenes} scenes; remove it")
            )
        made = sum(number < record.config.scenes for number in found)
        if made < record.config.scenes:
            faults.append(_of_all(
                f"{made} of {record.config.scenes} scenes are there; the others are made by: "
                f"multilight dataset --out {place.address}"
            ))  # fmt: skip
    return sorted(found)
