"""A dataset opened for reading, wherever it lies: a folder, or any address that fsspec opens."""

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import fsspec
import polars as pl
from fsspec import AbstractFileSystem

from datagen.errors import StoreError, UserError
from datagen.records import DatasetRecord, SceneRecord
from datagen.store import ViewData, parse_dataset, parse_scene, read_view

OnBroken = Literal["raise", "skip"]


@dataclass(frozen=True)
class DatasetSource:
    """An opened dataset; reads only, so many processes may share one.

    `address` is a folder or an fsspec address (`s3://bucket/set`, `memory://set`); `record` is its `dataset.json`;
    `indices` are its scenes, in order. With `on_broken` "skip", scenes that cannot be read are passed over by
    `scenes` and counted in `skipped` (scene index → reason).
    """

    address: str
    record: DatasetRecord
    indices: tuple[int, ...]
    filesystem: AbstractFileSystem = field(repr=False)
    root: str = field(repr=False)
    on_broken: OnBroken = "raise"
    skipped: dict[int, str] = field(default_factory=dict)

    def scene(self, index: int) -> SceneRecord:
        """Read a scene's record; raises `StoreError` naming file and reason."""
        return parse_scene(self._bytes(f"{_folder(index)}/scene.json"), f"{self.address}/{_folder(index)}/scene.json")

    def scenes(self) -> Iterator[SceneRecord]:
        """Yield the scenes in order, passing over what cannot be read where that was asked for."""
        for index in self.indices:
            try:
                yield self.scene(index)
            except StoreError as error:
                if self.on_broken == "raise":
                    raise
                self.skipped[index] = str(error)

    def view(self, record: SceneRecord, number: int) -> ViewData:
        """Read one view of a scene; raises `StoreError` naming file and reason."""
        name = f"{_folder(record.index)}/{record.views[number].file}"
        with self.local(name) as path:
            return read_view(path)

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """Lend a file of the dataset as a local one; a copy that is gone afterwards where the dataset is remote."""
        if "file" in self._protocols:
            yield Path(self.root) / name
            return
        with tempfile.TemporaryDirectory(prefix="multilight-") as folder:
            path = Path(folder) / Path(name).name
            path.write_bytes(self._bytes(name))
            yield path

    @property
    def _protocols(self) -> tuple[str, ...]:
        protocol = self.filesystem.protocol
        return (protocol,) if isinstance(protocol, str) else tuple(protocol)

    def _bytes(self, name: str) -> bytes:
        return _read(self.filesystem, self.root, name, self.address)


def open_dataset(address: str | Path, *, where: str | None = None, on_broken: OnBroken = "raise") -> DatasetSource:
    """Open a dataset for reading.

    `where` is an SQL expression over the columns of the index, `kind = 'room' and emissive`, say. Raises `StoreError`
    where there is no dataset or it is damaged, `UserError` where the expression cannot be understood.
    """
    filesystem, root = fsspec.core.url_to_fs(str(address))
    text = str(address).rstrip("/")
    record = parse_dataset(_read(filesystem, root, "dataset.json", text), f"{text}/dataset.json")
    source = DatasetSource(text, record, (), filesystem, root, on_broken)
    with source.local("index.parquet") as path:
        table = read_index(path)
    indices = tuple(int(i) for i in (table if where is None else select(table, where))["index"])
    return DatasetSource(text, record, indices, filesystem, root, on_broken)


def read_index(path: Path) -> pl.DataFrame:
    """Read `index.parquet`: a row a scene, ordered by scene."""
    try:
        return pl.read_parquet(path).sort("index")
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StoreError(f"{path} cannot be read: {error}; run `multilight dataset` again to write it anew") from None


def select(table: pl.DataFrame, where: str) -> pl.DataFrame:
    """Keep the rows for which an SQL expression holds; raises `UserError` with the expression and the columns."""
    try:
        return table.filter(pl.sql_expr(where))
    except pl.exceptions.PolarsError as error:
        reason = str(error).splitlines()[0]
        raise UserError(f"where {where!r}: {reason}; the columns are {', '.join(table.columns)}") from None


def _folder(index: int) -> str:
    return f"scenes/{index:06d}"


def _read(filesystem: AbstractFileSystem, root: str, name: str, address: str) -> bytes:
    try:
        return bytes(filesystem.cat_file(f"{root}/{name}"))
    except FileNotFoundError:
        raise StoreError(f"{address}/{name} is missing: not a dataset, or not finished") from None
    except OSError as error:
        raise StoreError(f"{address}/{name} cannot be read: {error}") from None
