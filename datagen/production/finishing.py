"""What is there of a dataset that is continued, and finishing it: index, credits and hashes in `dataset.json`."""

import contextlib
import hashlib
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISREG

import polars as pl

from multilight.datagen.production.aside import FOLDER
from multilight.datagen.storage.address import Place, find_place
from multilight.datagen.storage.blocks import BLOCK, Index, block_file, joined, read_blocks, stated_blocks
from multilight.datagen.storage.index import Row, index_bytes, index_row, index_table, table_of
from multilight.datagen.storage.open_dataset import scene_names
from multilight.datagen.storage.records import AssetCredit, DatasetRecord, view_file
from multilight.datagen.storage.store import read_dataset, scene_dir, write_text
from multilight.datagen.verification.dataset import PREVIEW, check_files, credits_in_order
from multilight.scenes.files.atomic import write_whole


@dataclass(frozen=True)
class Survey:
    """Sound scenes, damaged ones with the reason, and what is to be written into the index and `dataset.json`.

    `rows` and `credits` are those of scenes that the index lacks; `stated` are the hashes of records by the index that
    was found, `unread` its blocks that were not whole, `looked` those of which records were read again.
    """

    sound: set[int] = field(default_factory=set)
    damaged: dict[int, str] = field(default_factory=dict)
    rows: dict[int, Row] = field(default_factory=dict)
    credits: dict[str, AssetCredit] = field(default_factory=dict)
    stated: dict[int, str] = field(default_factory=dict)
    unread: set[int] = field(default_factory=set)
    looked: set[int] = field(default_factory=set)

    def add(self, row: Row, credits: Iterable[AssetCredit]) -> None:
        """Count a sound scene in that the index lacks."""
        self.rows[row["index"]] = row
        self.credits.update((credit.id, credit) for credit in credits)
        self.sound.add(row["index"])


def survey(root: Path, dataset: DatasetRecord, index: Index, *, contents: bool) -> Survey:
    """Look at all scenes in a dataset's folder: names, sizes and records, with `contents` the hashes of views too.

    Records are read of scenes that the index does not have, and of those of which a file was changed after the index
    was written. With `contents` a file too many is damage as well: what is made anew has none.
    """
    place, written = find_place(root), dict[int, int]()
    for block, table in index.sound().items():
        written.update(dict.fromkeys(table["index"], (root / block_file(block)).stat().st_ctime_ns))
    numbers = [number for number in scene_names(place) or () if number < dataset.config.scenes]

    def untouched(number: int, views: int, size: int) -> bool:
        return _untouched(str(scene_dir(root, number)), views, size, written[number])

    return look(place, numbers, dataset, index, untouched, contents=contents)


def look(
    place: Place,
    numbers: Iterable[int],
    dataset: DatasetRecord,
    index: Index,
    untouched: Callable[[int, int, int], bool],
    *,
    contents: bool,
) -> Survey:
    """Look at scenes at any place; of those with a row `untouched`, given number of views and bytes, saves the rest."""
    found = Survey(unread=set(index.faults))
    stated, complete = _stated(dataset, index)
    found.stated.update((number, row[0]) for number, row in stated.items())
    for number in numbers:
        known = stated.get(number) if complete else None
        if known is not None and not contents and untouched(number, *known[1:]):
            found.sound.add(number)
            continue
        files = check_files(place, number, dataset, contents=contents, extras=contents)
        if files.record is None or files.faults:
            found.damaged[number] = files.faults[0].message
        elif found.stated.get(number, files.record.record_sha256) != files.record.record_sha256:
            found.damaged[number] = "scene.json is not the one that the index states"
        elif known is not None:
            found.sound.add(number)
            found.looked.add(number // BLOCK)
        else:
            found.add(index_row(files.record), files.record.assets)
    return found


def _stated(dataset: DatasetRecord, index: Index) -> tuple[dict[int, tuple[str, int, int]], bool]:
    """Return what the index states of each scene: hash, views, bytes.

    And whether it has all that `dataset.json` is made from; one of version 0.2.0 and before has not.
    """
    whole = joined(index.sound().values())
    rows = whole.select("index", "record_sha256", "views", "bytes").iter_rows()
    stated = {scene: (digest, views, size) for scene, digest, views, size in rows}
    return stated, not whole["assets"].has_nulls() and {*_used(whole)} <= {credit.id for credit in dataset.assets}


def _untouched(folder: str, views: int, size: int, since: int) -> bool:
    """Whether a scene's files are all there, their views of that size in all, and none changed since a time [ns]."""
    try:
        about = [os.lstat(f"{folder}/{name}") for name in ("scene.json", PREVIEW, *map(view_file, range(views)))]
        changed = max(os.lstat(folder).st_ctime_ns, *(file.st_ctime_ns for file in about))
    except OSError:
        return False
    whole = all(S_ISREG(file.st_mode) for file in about) and sum(file.st_size for file in about[2:]) == size
    return whole and changed < since


def finish(root: Path, there: Survey, scenes: Place | None = None) -> None:
    """Bring index and `dataset.json` up to what is `there`, in the blocks that have changed, and forget its rows.

    Rows of other scenes stay, so that several runs may do so, one after the other, in any order; to be called under
    the folder's lock. `scenes` is where the scenes lie, if not in the folder.
    """
    place, dataset = find_place(root), read_dataset(root)
    for name in ("logs", FOLDER):
        with contextlib.suppress(OSError):
            (root / name).rmdir()
    index = read_blocks(place, dataset)
    if set(index.faults) - there.unread:  # damaged since, or not finished by a run that was killed
        again = survey(root, dataset, index, contents=False)
        there.rows.update(again.rows | there.rows)
        there.credits.update(again.credits)
    lost = {
        n for n in there.stated.keys() - there.sound if check_files(scenes or place, n, dataset, extras=False).faults
    }
    tables = _in_blocks(index.sound())
    changed = {number // BLOCK for number in (*there.rows, *lost)} | index.faults.keys() | there.looked
    changed |= {number for number in tables.keys() | {0} if tables.get(number) is not index.tables.get(number)}
    hashes = stated_blocks(dataset)
    rows: dict[int, list[Row]] = defaultdict(list)
    for number, row in there.rows.items():
        rows[number // BLOCK].append(row)
    for number in changed:
        kept = tables.get(number, index_table([]))
        kept = kept.filter(~pl.col("index").is_in([*lost, *(row["index"] for row in rows[number])]))
        tables[number] = joined([kept, table_of(rows[number])])
        hashes[number] = _write_block(root, number, tables[number], hashes.get(number, ""))
    whole, last = joined(tables.values()), max(number for number in hashes if hashes[number] or not number)
    credits = {credit.id: credit for credit in dataset.assets} | there.credits
    finished = dataset.model_copy(
        update={
            "assets": credits_in_order({name: credits[name] for name in _used(whole)}),
            "index_sha256": hashes[0],
            "index_more": tuple(hashes.get(number, "") for number in range(1, last + 1)),
            "index_rows": len(whole),
            "thrown_away": dict(sorted(Counter(whole["thrown_away"].explode().drop_nulls()).items())),
        }
    ).sealed()
    if finished != dataset:
        write_text(root / "dataset.json", finished.model_dump_json(indent=1))
    there.rows.clear()
    there.looked.clear()


def _used(table: pl.DataFrame) -> list[str]:
    """List the assets of all scenes by id, each once."""
    return sorted(table["assets"].explode().drop_nulls().unique())


def _in_blocks(tables: dict[int, pl.DataFrame]) -> dict[int, pl.DataFrame]:
    """Put rows that an older index has in its one file into their own blocks."""
    if 0 not in tables or not (tables[0]["index"] >= BLOCK).any():
        return dict(tables)
    parts = tables[0].with_columns(block=pl.col("index") // BLOCK).partition_by("block", include_key=False)
    return dict(tables) | {int(part["index"][0]) // BLOCK: part for part in parts}


def _write_block(root: Path, number: int, table: pl.DataFrame, stated: str) -> str:
    """Write a block where it is another than stated, else say that it was looked at; returns its hash, "" for none."""
    path = root / block_file(number)
    if number and not len(table):
        path.unlink(missing_ok=True)
        return ""
    content = index_bytes(table)
    digest = hashlib.sha256(content).hexdigest()
    if digest == stated and path.is_file() and path.read_bytes() == content:
        os.utime(path)
        return digest
    path.parent.mkdir(exist_ok=True)
    with write_whole(path) as work:
        work.write_bytes(content)
    return digest
