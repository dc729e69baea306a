"""A dataset opened for reading, wherever it lies: a folder, or any address that fsspec opens.

    source = open_dataset("s3://bucket/set", where="kind = 'room' and emissive", on_broken="skip")
    for record in source.scenes():
        view = source.view(record, 0)

Files are fetched whole, one by one as they are asked for; nothing is ever written at the address.
"""

import contextlib
import multiprocessing
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import polars as pl

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.address import Place, find_place
from multilight.datagen.storage.blocks import Index, joined, read_blocks
from multilight.datagen.storage.index import index_table
from multilight.datagen.storage.records import DatasetRecord, SceneRecord
from multilight.datagen.storage.store import (
    COPIES,
    MOST_RECORD,
    ViewData,
    parse_dataset,
    parse_scene,
    read_view,
    scene_folder,
    scene_number,
)
from multilight.datagen.text import did_you_mean, plain
from multilight.scenes.files.limits import shown

OnBroken = Literal["raise", "skip"]
LONGEST_WHERE = 4000
"""Characters of the longest expression over the index, without its lists of numbers."""


@dataclass(frozen=True)
class DatasetSource:
    """An opened dataset; reads only, so many processes may share one.

    `address` is a folder or an fsspec address (`s3://bucket/set`, `memory://set`); `record` is its `dataset.json`;
    `table` is its index, a row a scene, of the scenes for which `where` holds; `indices` are these, in order. With
    `on_broken` "skip", scenes that cannot be read are passed over by `scenes` and `passing_over`, and counted in
    `skipped` (scene index → reason).
    """

    place: Place
    record: DatasetRecord
    table: pl.DataFrame = field(repr=False)
    where: str | None = None
    on_broken: OnBroken = "raise"
    skipped: dict[int, str] = field(default_factory=dict)

    @property
    def address(self) -> str:
        """The folder or address, as it was given."""
        return self.place.address

    @property
    def is_local(self) -> bool:
        """Whether the dataset is a folder of this machine."""
        return self.place.is_local

    @cached_property
    def indices(self) -> tuple[int, ...]:
        """The scenes' indices, in order."""
        return tuple(self.table["index"].to_list())

    def scene(self, index: int) -> SceneRecord:
        """Read a scene's record; raises `StoreError` naming file and reason."""
        with self._remedy_told():
            record = read_record(self.place, index)
            if (stated := self._hashes.get(index, record.record_sha256)) != record.record_sha256:
                raise StoreError(
                    f"{self.address}/{scene_folder(index)}/scene.json is not the one of the index: "
                    f"its hash is {record.record_sha256[:12]}…, not {stated[:12]}…"
                )
            return record

    def alone(self, index: int) -> "DatasetSource":
        """Return the dataset with one scene: little to hand to a process, which need not open the whole then."""
        return replace(self, table=self.table.select("index", "record_sha256").filter(pl.col("index") == index))

    def scenes(self) -> Iterator[SceneRecord]:
        """Yield the scenes in order, passing over what cannot be read where that was asked for."""
        for index in self.indices:
            record = None
            with self.passing_over(index):
                record = self.scene(index)
            if record is not None:
                yield record

    def views(self, record: SceneRecord) -> Iterator[ViewData]:
        """Read the views of a scene, one after the other; raises `StoreError` as `view` does."""
        return (self.view(record, number) for number in range(len(record.views)))

    @contextlib.contextmanager
    def passing_over(self, index: int) -> Iterator[None]:
        """Let a `StoreError` inside end this scene's work only, and count the scene, where skipping was asked for."""
        try:
            yield
        except StoreError as error:
            if self.on_broken == "raise":
                raise
            self.skipped[index] = str(error)

    def view(self, record: SceneRecord, number: int) -> ViewData:
        """Read one view of a scene; raises `StoreError` naming file and reason."""
        stated = record.views[number]
        name = f"{scene_folder(record.index)}/{stated.file}"
        shown = f"{self.address}/{name}"
        with self._remedy_told(), self.local(name) as path:
            try:
                if path.is_file() and (size := path.stat().st_size) != stated.bytes:
                    raise StoreError(f"{path} is truncated or replaced: {size} bytes, scene.json states {stated.bytes}")
                return read_view(path, (record, number))
            except StoreError as error:
                raise StoreError(str(error).replace(str(path), shown)) from None

    def local(self, name: str) -> AbstractContextManager[Path]:
        """Lend a file of the dataset as a local one: of a remote dataset a copy, gone afterwards."""
        return self.place.local(name)

    @cached_property
    def _hashes(self) -> dict[int, str]:
        """The hashes of the scenes' records by the index."""
        return dict(self.table.select("index", "record_sha256").iter_rows())

    @contextlib.contextmanager
    def _remedy_told(self) -> Iterator[None]:
        """Add to what is wrong with a native dataset's scene how it is repaired."""
        try:
            yield
        except StoreError as error:
            if not self.is_local or any(self.place.exists(name) for name in COPIES):
                raise
            raise StoreError(f"{error}; made anew by: {repair_command(self.address)}") from None


def open_dataset(address: str | Path, *, where: str | None = None, on_broken: OnBroken = "raise") -> DatasetSource:
    """Open a dataset for reading.

    `where` is an SQL expression over the columns of the index, `kind = 'room' and emissive`, say. Raises `StoreError`
    where there is no dataset or it is damaged, `UserError` where the address or the expression cannot be understood.
    The index of a dataset that is not finished, or one that is not as `dataset.json` states it, is made up from its
    scenes, which is told.
    """
    place = find_place(address)
    record = _dataset_record(place)
    index = read_blocks(place, record)
    while index.faults and (now := _dataset_record(place)) != record:  # written meanwhile, by a run that goes on
        record, index = now, read_blocks(place, now)
    source = DatasetSource(place, record, index_table([]), where, on_broken)
    table = _completed(source, index)
    return replace(source, table=table if where is None else select(table, where))


def _dataset_record(place: Place) -> DatasetRecord:
    return parse_dataset(place.read("dataset.json", MOST_RECORD), f"{place.address}/dataset.json")


def read_record(place: Place, index: int) -> SceneRecord:
    """Read the record of a scene; raises `StoreError` naming file and reason."""
    name = f"{scene_folder(index)}/scene.json"
    record = parse_scene(place.read(name, MOST_RECORD), f"{place.address}/{name}")
    if record.index != index:
        raise StoreError(f"{place.address}/{name} is the record of scene {record.index}, not of scene {index}")
    return record


def repair_command(address: str) -> str:
    """Return the command that makes what is damaged in a dataset anew."""
    return f"multilight dataset --out {address} --repair"


def select(table: pl.DataFrame, where: str) -> pl.DataFrame:
    """Keep the rows for which an SQL expression holds; raises `UserError` with the nearest column."""
    short = re.sub(r"\([\d, ]+\)", "()", where)
    if len(short) > LONGEST_WHERE or not where.isprintable():  # polars' parser overflows its stack on endless ones
        most = f"at most {LONGEST_WHERE} characters, lists of numbers aside"
        raise UserError(f"where {shown(where)}: an expression is one line of {most}")
    try:
        return table.filter(pl.sql_expr(where))
    except pl.exceptions.PolarsError as error:
        reason = str(error).splitlines()[0].partition("; valid columns")[0]
        missing = re.search('column "(.+)"', reason)
        near = did_you_mean(missing[1], table.columns) if missing else ""
        if missing and not near and re.search(rf"[=(,]\s*{re.escape(missing[1])}", where):
            near = f"a text is quoted: '{missing[1]}'. "
        raise UserError(
            f"where {shown(where)}: {reason}; {near}`multilight query DIR --describe` lists the columns"
        ) from None


def spread(scenes: Sequence[int], most: int | None) -> Sequence[int]:
    """Choose at most so many scenes, evenly spread over all."""
    if most is None or most >= len(scenes):
        return scenes
    return [scenes[place * len(scenes) // most] for place in range(most)]


def scene_names(place: Place) -> list[int] | None:
    """List the scenes that have a folder, elsewhere than here a record in it; None where the place cannot list."""
    names: Iterable[str] | None = place.names("scenes")
    if names and not place.is_local:
        found = place.files("scenes") or ()
        names = [name.removesuffix("/scene.json") for name in found if name.endswith("/scene.json")]
    return None if names is None else sorted(n for name in names if (n := scene_number(name)) is not None)


def _completed(source: DatasetSource, index: Index) -> pl.DataFrame:
    """Make up what the index lacks, or states other than `dataset.json`, from the scenes' records, and tell."""
    place, record = source.place, source.record
    sound = index.sound()
    table = joined(sound.values())
    if not index.faults and not place.is_local:
        return table
    found = scene_names(place)
    if found is None:
        found = [n for n in range(record.config.scenes) if place.exists(f"{scene_folder(n)}/scene.json")]
    lacks = sorted(set(found) - set(table["index"]))
    if index.faults and not found:
        raise StoreError(next(iter(index.faults.values())))
    if index.faults and record.index_sha256:
        told = "; ".join(index.faults.values())
        _tell(f"{told}; made up from the {len(lacks)} scenes, put right by: {repair_command(place.address)}")
    elif lacks and not index.faults:
        _tell(f"the index of {place.address} lacks {len(lacks)} of the scenes; they are read from their records")
    return joined([table, index_table(_readable(source, lacks))]) if lacks else table


def _tell(message: str) -> None:
    """Say something once, however many processes open the dataset."""
    if multiprocessing.parent_process() is None:
        print(plain(message), file=sys.stderr)


def _readable(source: DatasetSource, indices: Iterable[int]) -> Iterator[SceneRecord]:
    for index in indices:
        with source.passing_over(index):
            yield source.scene(index)
