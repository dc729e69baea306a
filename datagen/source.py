"""A dataset opened for reading, wherever it lies: a folder, or any address that fsspec opens.

    source = open_dataset("s3://bucket/set", where="kind = 'room' and emissive", on_broken="skip")
    for record in source.scenes():
        view = source.view(record, 0)

Files are fetched whole, one by one as they are asked for; nothing is ever written at the address.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import fsspec
import polars as pl
from fsspec import AbstractFileSystem

from datagen.errors import StoreError, UserError
from datagen.index import index_table
from datagen.records import DatasetRecord, SceneRecord
from datagen.store import ViewData, parse_dataset, parse_scene, read_view
from scenes.inside import OutsideError, held, inside, plain_name

OnBroken = Literal["raise", "skip"]


@dataclass(frozen=True)
class DatasetSource:
    """An opened dataset; reads only, so many processes may share one.

    `address` is a folder or an fsspec address (`s3://bucket/set`, `memory://set`); `record` is its `dataset.json`;
    `table` is its index, a row a scene, and `indices` are those scenes, in order. With `on_broken` "skip", scenes that
    cannot be read are passed over by `scenes` and `passing_over`, and counted in `skipped` (scene index → reason).
    """

    address: str
    record: DatasetRecord
    table: pl.DataFrame = field(repr=False)
    filesystem: AbstractFileSystem = field(repr=False)
    root: str = field(repr=False)
    on_broken: OnBroken = "raise"
    cache: Path | None = None
    skipped: dict[int, str] = field(default_factory=dict)

    @property
    def indices(self) -> tuple[int, ...]:
        """The scenes' indices, in order."""
        return tuple(self.table["index"].to_list())

    def scene(self, index: int) -> SceneRecord:
        """Read a scene's record; raises `StoreError` naming file and reason."""
        name = f"{_folder(index)}/scene.json"
        record = parse_scene(self._bytes(name), f"{self.address}/{name}")
        if record.index != index:
            raise StoreError(f"{self.address}/{name} is the record of scene {record.index}, not of scene {index}")
        return record

    def scenes(self) -> Iterator[SceneRecord]:
        """Yield the scenes in order, passing over what cannot be read where that was asked for."""
        for index in self.indices:
            record = None
            with self.passing_over(index):
                record = self.scene(index)
            if record is not None:
                yield record

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
        name = f"{_folder(record.index)}/{stated.file}"
        shown = f"{self.address}/{name}"
        with self.local(name) as path:
            if not path.is_file():
                raise StoreError(f"{shown} is missing")
            if path.stat().st_size != stated.bytes:
                raise StoreError(
                    f"{shown} is truncated or replaced: {path.stat().st_size} bytes, scene.json states {stated.bytes}"
                )
            try:
                return read_view(path)
            except StoreError as error:
                raise StoreError(str(error).replace(str(path), shown)) from None

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """Lend a file of the dataset as a local one.

        Of a remote dataset it is a copy: in the cache's folder, or gone afterwards where there is none.
        """
        if self.is_local:
            with _told(self.address):
                path = inside(Path(self.root), name)
            yield path
        elif self.cache is not None:
            yield self._cached(self.cache, name)
        else:
            with tempfile.TemporaryDirectory(prefix="multilight-") as folder:
                content = self._bytes(name)
                path = Path(folder) / Path(name).name
                path.write_bytes(content)
                yield path

    @contextlib.contextmanager
    def local_scene(self, index: int) -> Iterator[Path]:
        """Lend a scene's folder as a local one: its record and all its views; copies where the dataset is remote."""
        if self.is_local:
            with _told(self.address):
                found = inside(Path(self.root), _folder(index))
            yield found
            return
        with tempfile.TemporaryDirectory(prefix="multilight-") as temporary:
            folder = Path(temporary) / _folder(index)
            for name in ("scene.json", *(view.file for view in self.scene(index).views)):
                content = self._bytes(f"{_folder(index)}/{name}")
                path = inside(folder, name)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
            yield folder

    @property
    def is_local(self) -> bool:
        """Whether the dataset is a folder of this machine."""
        return "file" in self._protocols

    @property
    def _protocols(self) -> tuple[str, ...]:
        protocol = self.filesystem.protocol
        return (protocol,) if isinstance(protocol, str) else tuple(protocol)

    def _cached(self, cache: Path, name: str) -> Path:
        """Fetch a file once; the folder is named after what decides the content, so another dataset is fetched anew."""
        key = hashlib.sha256(f"{self.address}\n{self.record.canonical_json()}".encode()).hexdigest()[:16]
        with _told(self.address):
            path = inside(cache / key, name)
        if not path.is_file():
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")  # processes may fetch the same file at once
            temporary.write_bytes(self._bytes(name))
            temporary.replace(path)
        return path

    def _bytes(self, name: str) -> bytes:
        return _read(self.filesystem, self.root, name, self.address)


@contextlib.contextmanager
def _told(address: str) -> Iterator[None]:
    """Turn a name that leads out of a dataset into a `StoreError`."""
    try:
        yield
    except OutsideError as error:
        raise StoreError(f"{address}: {error}; it is not read") from None


def open_dataset(
    address: str | Path, *, where: str | None = None, on_broken: OnBroken = "raise", cache: Path | None = None
) -> DatasetSource:
    """Open a dataset for reading.

    `where` is an SQL expression over the columns of the index, `kind = 'room' and emissive`, say. What is read from a
    remote dataset is kept in the folder `cache`, where one is named. Raises `StoreError` where there is no dataset or
    it is damaged, `UserError` where the address or the expression cannot be understood. The index of a dataset that
    is not finished is made up from its scenes.
    """
    text = str(address).rstrip("/") or str(address)
    try:
        filesystem, root = fsspec.core.url_to_fs(text)
    except (ValueError, ImportError) as error:
        raise UserError(
            f"{text} cannot be opened: {error} (S3 and HTTP need: pip install 'multilight[remote]')"
        ) from None
    record = parse_dataset(_read(filesystem, root, "dataset.json", text), f"{text}/dataset.json")
    source = DatasetSource(text, record, index_table([]), filesystem, root, on_broken, cache)
    table = _index_of(source)
    return replace(source, table=table if where is None else select(table, where))


def read_index(content: bytes, name: str) -> pl.DataFrame:
    """Understand the content of an `index.parquet`: a row a scene, ordered by scene; `name` is for the error."""
    try:
        return pl.read_parquet(content).sort("index")
    except (OSError, pl.exceptions.PolarsError) as error:
        reason = (str(error).splitlines() or ["empty"])[0]
        raise StoreError(f"{name} cannot be read: {reason}; without the file, it is made up from the scenes") from None


def select(table: pl.DataFrame, where: str) -> pl.DataFrame:
    """Keep the rows for which an SQL expression holds; raises `UserError` with the expression and the columns."""
    try:
        return table.filter(pl.sql_expr(where))
    except pl.exceptions.PolarsError as error:
        reason = str(error).splitlines()[0].partition(";")[0]
        raise UserError(f"where {where!r}: {reason}; the columns are {', '.join(table.columns)}") from None


def _index_of(source: DatasetSource) -> pl.DataFrame:
    try:
        content = source._bytes("index.parquet")
    except StoreError as missing:
        found = _scene_folders(source)
        if not found:
            raise missing from None
        return index_table(_readable(source, found))
    return read_index(content, f"{source.address}/index.parquet")


def _scene_folders(source: DatasetSource) -> list[int]:
    try:
        names = source.filesystem.glob(f"{source.root}/scenes/*/scene.json")
    except Exception:  # backends that cannot list raise errors of many kinds
        return []
    folders = [str(name).split("/")[-2] for name in names]
    return sorted(int(folder) for folder in folders if folder.isdigit())


def _readable(source: DatasetSource, indices: Iterable[int]) -> Iterator[SceneRecord]:
    for index in indices:
        with source.passing_over(index):
            yield source.scene(index)


def _folder(index: int) -> str:
    return f"scenes/{index:06d}"


def _read(filesystem: AbstractFileSystem, root: str, name: str, address: str) -> bytes:
    with _told(address):
        plain_name(name)
        if "file" in filesystem.protocol:
            held(Path(root), Path(root, name))
    # In a forked process this makes a new connection; in the same one it returns the same object.
    alive = type(filesystem)(*filesystem.storage_args, **filesystem.storage_options)
    try:
        return bytes(alive.cat_file(f"{root}/{name}"))
    except FileNotFoundError:
        raise StoreError(f"{address}/{name} is missing: not a dataset, or not finished") from None
    except Exception as error:  # each backend has its own errors for a lost connection or a refused key
        raise StoreError(f"{address}/{name} cannot be read: {error or type(error).__name__}") from None
