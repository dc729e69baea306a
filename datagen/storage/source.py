"""A dataset opened for reading, wherever it lies: a folder, or any address that fsspec opens.

    source = open_dataset("s3://bucket/set", where="kind = 'room' and emissive", on_broken="skip")
    for record in source.scenes():
        view = source.view(record, 0)

Files are fetched whole, one by one as they are asked for; nothing is ever written at the address.
"""

import contextlib
import hashlib
import multiprocessing
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import polars as pl

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.index import index_table, parse_index
from multilight.datagen.storage.place import Place, find_place
from multilight.datagen.storage.records import GHOSTS, DatasetRecord, SceneRecord
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
MOST_INDEX = 1 << 29
"""Bytes of an index; that of a million scenes has about half as many."""
LONGEST_WHERE = 4000
"""Characters of the longest expression over the index."""


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

    @property
    def indices(self) -> tuple[int, ...]:
        """The scenes' indices, in order."""
        return tuple(self.table["index"].to_list())

    def scene(self, index: int) -> SceneRecord:
        """Read a scene's record; raises `StoreError` naming file and reason."""
        with self._remedy_told():
            record = read_record(self.place, index)
            if (stated := self._hashes.get(index, "")) not in ("", record.record_sha256):
                raise StoreError(
                    f"{self.address}/{scene_folder(index)}/scene.json is not the one of the index: "
                    f"its hash is {record.record_sha256[:12]}…, not {stated[:12]}…"
                )
            return record

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
        """The hashes of the scenes' records by the index, where that has them."""
        if "record_sha256" not in self.table.columns:
            return {}
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
    record = parse_dataset(place.read("dataset.json", MOST_RECORD), f"{place.address}/dataset.json")
    source = DatasetSource(place, record, index_table([]), where, on_broken)
    table = _index_of(source)
    return replace(source, table=table if where is None else select(table, where))


def read_record(place: Place, index: int) -> SceneRecord:
    """Read the record of a scene; raises `StoreError` naming file and reason."""
    name = f"{scene_folder(index)}/scene.json"
    record = parse_scene(place.read(name, MOST_RECORD), f"{place.address}/{name}")
    if record.index != index:
        raise StoreError(f"{place.address}/{name} is the record of scene {record.index}, not of scene {index}")
    return record


def read_index(place: Place, record: DatasetRecord) -> pl.DataFrame:
    """Read the index of a dataset; raises `StoreError` where it is missing, damaged, or not as `record` states it."""
    content, shown = place.read("index.parquet", MOST_INDEX), f"{place.address}/index.parquet"
    stated = record.index_sha256
    if record.schema_version > GHOSTS and hashlib.sha256(content).hexdigest() != stated:
        raise StoreError(f"{shown} is not the one that dataset.json states")
    return parse_index(content, shown, older=record.schema_version <= GHOSTS)


def repair_command(address: str) -> str:
    """Return the command that makes what is damaged in a dataset anew."""
    return f"multilight dataset --out {address} --repair"


def select(table: pl.DataFrame, where: str) -> pl.DataFrame:
    """Keep the rows for which an SQL expression holds; raises `UserError` with the nearest column."""
    if len(where) > LONGEST_WHERE or not where.isprintable():  # polars' parser overflows its stack on endless ones
        raise UserError(f"where {shown(where)}: an expression is one line of at most {LONGEST_WHERE} characters")
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


def scene_names(place: Place) -> list[int] | None:
    """List the scenes that have a folder; None where the place cannot list."""
    names = place.names("scenes")
    return None if names is None else sorted(n for name in names if (n := scene_number(name)) is not None)


def _index_of(source: DatasetSource) -> pl.DataFrame:
    """Read the index, or make it up, whole or for the scenes that it lacks, and tell."""
    place, record = source.place, source.record
    try:
        table = read_index(place, record)
    except StoreError as error:
        found = scene_names(place)
        if found is None:
            found = [
                index for index in range(record.config.scenes) if place.exists(f"{scene_folder(index)}/scene.json")
            ]
        if not found:
            raise
        if record.index_sha256:
            _tell(f"{error}; made up from the {len(found)} scenes, put right by: {repair_command(place.address)}")
        return index_table(_readable(source, found))
    lacks = sorted(set(scene_names(place) or ()) - set(table["index"])) if place.is_local else []
    if lacks:
        _tell(f"{place.address}/index.parquet lacks {len(lacks)} of the scenes; they are read from their records")
        table = pl.concat([table, index_table(_readable(source, lacks))], how="diagonal").sort("index")
    return table


def _tell(message: str) -> None:
    """Say something once, however many processes open the dataset."""
    if multiprocessing.parent_process() is None:
        print(plain(message), file=sys.stderr)


def _readable(source: DatasetSource, indices: Iterable[int]) -> Iterator[SceneRecord]:
    for index in indices:
        with source.passing_over(index):
            yield source.scene(index)
