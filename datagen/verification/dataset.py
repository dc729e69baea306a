"""Check that a dataset is what was made: everything there under its own name and unchanged, and nothing else.

`dataset.json` states the hash of the index, the index those of the records, a record those of its files.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field

import polars as pl

from multilight.datagen.errors import StoreError
from multilight.datagen.report import Report, silent
from multilight.datagen.storage.index import index_row, parse_index
from multilight.datagen.storage.place import Place, find_place
from multilight.datagen.storage.records import GHOSTS, AssetCredit, DatasetRecord, SceneRecord
from multilight.datagen.storage.source import MOST_INDEX, read_record, scene_names
from multilight.datagen.storage.store import MOST_RECORD, file_sha256, parse_dataset, scene_folder, scene_number
from multilight.datagen.verification.views import Fault, Lend, verify_views

PREVIEW = "preview.png"
ANEW = (
    "pieces of a removed object may stand in the backgrounds of datasets of schema 2: "
    "make it anew in another folder, it cannot be repaired"
)
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
class _Index:
    """The rows of an index by scene; `whole` where it is the one that `dataset.json` states."""

    table: pl.DataFrame | None
    places: dict[int, int]
    whole: bool

    def faults(self, record: SceneRecord) -> Iterator[str]:
        """Say what of a scene's row is wrong; that there is none is told of the dataset."""
        place = self.places.get(record.index)
        if self.table is None or place is None:
            return
        if self.whole and self.table["record_sha256"][place] == record.record_sha256:
            return
        row, wanted = self.table.row(place, named=True), index_row(record)
        if wrong := [name for name, value in wanted.items() if name in row and row[name] != value]:
            yield f"index.parquet states another {', '.join(wrong)} than scene.json"


def verify_dataset(address: str, *, quick: bool = False, report: Report = silent) -> Verification:
    """Check a dataset at any address; `quick` leaves out what the pictures hold; `report` is told of scenes.

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
    return Verification(version or "unknown", list(_results(place, record, faults, report, quick=quick)))


def _results(
    place: Place, record: DatasetRecord | None, faults: list[Fault], report: Report, *, quick: bool
) -> Iterator[Result]:
    if record is not None and record.schema_version <= GHOSTS:
        faults.append(_of_all(ANEW))
    index = _read_index(place, record, faults)
    scenes = _scenes(place, record, index, faults)
    yield None, faults
    credits: dict[str, AssetCredit] = {}
    unread = False
    for done, number in enumerate(scenes):
        report(done, len(scenes))
        try:
            files = check_files(place, number, record)
            found = files.faults
            if files.record is not None:
                credits |= {credit.id: credit for credit in files.record.assets}
                found += [Fault(number, None, "index", message) for message in index.faults(files.record)]
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


def _read_index(place: Place, record: DatasetRecord | None, faults: list[Fault]) -> _Index:
    """Read the index as far as it can be, and say what is wrong with it as a whole."""
    whole = False
    try:
        content = place.read("index.parquet", MOST_INDEX)
        older = record is not None and record.schema_version <= GHOSTS
        if record is not None and not older:
            whole = hashlib.sha256(content).hexdigest() == record.index_sha256
            if not whole:
                faults.append(Fault(None, None, "index", "index.parquet is not the one that dataset.json states"))
        table = parse_index(content, "index.parquet", older=older)
    except StoreError as error:
        faults.append(Fault(None, None, "index", str(error)))
        return _Index(None, {}, whole=False)
    if record is not None and whole and record.index_rows != len(table):
        told = f"index.parquet has {len(table)} rows, dataset.json states {record.index_rows}"
        faults.append(Fault(None, None, "index", told))
    return _Index(table, {number: place for place, number in enumerate(table["index"])}, whole)


def _scenes(place: Place, record: DatasetRecord | None, index: _Index, faults: list[Fault]) -> list[int]:
    """List the scenes to check, and name those that are missing or too many."""
    names = place.names("scenes")
    if names is None:  # the place cannot list
        return sorted(index.places)
    found = {number for name in names if (number := scene_number(name)) is not None}
    for name in names:
        if scene_number(name) is None:
            faults.append(_of_all(f"scenes/{name} is no scene of this dataset; remove it"))
    for number in sorted(set(index.places) - found):
        faults.append(Fault(number, None, "files", f"{scene_folder(number)} is missing, the index has a row of it"))
    if index.table is not None:
        for number in sorted(found - set(index.places)):
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
