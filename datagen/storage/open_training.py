"""A dataset opened for training: packed or native, a view comes as `PackedView` either way."""

import contextlib
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import polars as pl

from multilight.datagen.errors import StoreError, reason_of
from multilight.datagen.storage.manifest import MANIFEST, parse_manifest, read_manifest, remedy
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.packed import PackedView, pack_view, read_packed
from multilight.datagen.storage.records import SceneRecord, view_file
from multilight.datagen.storage.store import file_sha256, scene_folder
from multilight.scenes.assets.cache import default_cache
from multilight.scenes.files.atomic import write_whole

VISIBLE = "visible.parquet"
"""Marks a packed dataset: how much of each view every insertable object covers."""


@dataclass(frozen=True)
class TrainingSource:
    """A dataset that hands out packed views; reads only, so many processes may share one.

    `index` are the chosen rows of the dataset's index; `visible` has a row for each of their views and insertable
    objects: scene, view (int64), object (str), pixels (float64, the sum of its coverage). Of a packed copy `sizes` are
    the bytes of its files, and `remedy` says how to make it anew.
    """

    source: DatasetSource
    packed: bool
    sizes: Mapping[str, int] = field(repr=False)
    remedy: str
    index: pl.DataFrame = field(repr=False)
    visible: pl.DataFrame = field(repr=False)

    def view(self, scene: int, number: int) -> PackedView:
        """Read one view; raises `StoreError` naming file and reason."""
        if self.packed:
            name = packed_file(scene, number)
            with self.source.local(name) as path:
                try:
                    _check_size(path, self.sizes.get(name))
                    return _mapped(path) if self.source.is_local else read_packed(path)
                except StoreError as error:
                    shown = str(error).replace(str(path), f"{self.source.address}/{name}")
                    raise StoreError(f"{shown}; {self.remedy}") from None
        record = self.source.scene(scene)
        return pack_view(self.source.view(record, number), record, number)

    def size(self, scene: int, number: int) -> int:
        """Return the bytes of a view's file."""
        name = packed_file(scene, number) if self.packed else f"{scene_folder(scene)}/{view_file(number)}"
        return self.source.place.size(name) or 0


def open_training(address: str | Path, *, where: str | None = None) -> TrainingSource:
    """Open a native or a packed dataset; `where` is an SQL expression over the index, as in `open_dataset`.

    The first opening of a native dataset of version 0.2.0 or before reads every view once, to learn which objects can
    be seen, which later ones state; what it finds is kept in the cache folder of the assets. Of a packed copy the sizes
    of all files are held against its manifest, and the contents of those that are not views. Raises `StoreError` where
    there is no dataset or it is damaged.
    """
    source = open_dataset(address, where=where)
    packed = source.place.exists(VISIBLE)
    sizes, told = _checked(source) if packed else ({}, "")
    if packed:
        with source.local(VISIBLE) as path:
            visible = _read_visible(path)
    elif not source.table["pixels"].has_nulls():
        visible = _stated(source.table)
    else:
        visible = _seen_before(source)
    chosen = visible.filter(pl.col("scene").is_in(list(source.indices)))
    return TrainingSource(source, packed, sizes, told, source.table, chosen)


def _checked(source: DatasetSource) -> tuple[dict[str, int], str]:
    """Hold a packed copy against its manifest; returns the sizes of its files, and how to make it anew."""
    if source.is_local:
        manifest = read_manifest(Path(source.place.root))
    else:
        with source.local(MANIFEST) as path:
            manifest = parse_manifest(path.read_bytes(), f"{source.address}/{MANIFEST}")
    told = remedy(manifest, source.address)
    for name in ("dataset.json", "index.parquet", VISIBLE):
        stated = manifest.files.get(name)
        with source.local(name) as path:
            if stated is None or file_sha256(path) != stated.sha256:
                raise StoreError(f"{source.address}/{name} is not what {MANIFEST} states; {told}")
    if source.is_local:  # elsewhere each file as it is fetched
        for name, entry in manifest.files.items():
            try:
                _check_size(Path(source.place.root) / name, entry.bytes)
            except StoreError as error:
                raise StoreError(f"{error}; {told}") from None
    return {name: entry.bytes for name, entry in manifest.files.items()}, told


def _check_size(path: Path, stated: int | None) -> None:
    try:
        size = path.stat().st_size
    except OSError:
        raise StoreError(f"{path} is missing") from None
    if size != stated:
        raise StoreError(f"{path} is truncated or damaged: {size} bytes, {MANIFEST} states {stated}")


def _mapped(path: Path) -> PackedView:
    """Read a packed view, or return it where it is mapped already and the file is the same still."""
    about = path.stat()
    return _read_once(path, about.st_size, about.st_mtime_ns)


@lru_cache(maxsize=1024)
def _read_once(path: Path, size: int, changed: int) -> PackedView:
    return read_packed(path)


def packed_file(scene: int, number: int) -> str:
    """Return a packed view's file name inside its dataset."""
    return f"{scene_folder(scene)}/views/{number:02d}.safetensors"


def visible_rows(record: SceneRecord, number: int, view: PackedView) -> list[dict[str, object]]:
    """List the insertable objects of a view and the pixels that each covers."""
    return [
        {"scene": record.index, "view": number, "object": name,
         "pixels": float(view.object_coverage(name).sum(dtype="float64"))}
        for name in view.objects
    ]  # fmt: skip


def _stated(index: pl.DataFrame) -> pl.DataFrame:
    """Lay out what an index states of its scenes, a row for each view and insertable object."""
    rows = index.select("insertable", "pixels", scene="index", number=pl.int_ranges(pl.col("pixels").list.len()))
    rows = rows.explode("pixels", "number").with_columns(objects=pl.col("insertable").list.len().cast(pl.Int64))
    place = pl.col("number") % pl.col("objects")
    return rows.select(
        "scene", "pixels", view=pl.col("number") // pl.col("objects"), object=pl.col("insertable").list.get(place)
    )


def _read_visible(path: Path) -> pl.DataFrame:
    try:
        return pl.read_parquet(path, columns=["scene", "view", "object", "pixels"])
    except (OSError, pl.exceptions.PolarsError) as error:
        raise StoreError(f"{path} cannot be read: {reason_of(error)}") from None


def _seen_before(source: DatasetSource) -> pl.DataFrame:
    """Return the rows of all chosen scenes, from the cache where they have been seen before."""
    state = f"{source.address}\n{source.record.canonical_json()}\n{source.table.to_dicts()}"
    key = hashlib.sha256(state.encode()).hexdigest()[:32]
    cache = default_cache() / f"visible-{key}.parquet"
    if cache.is_file():
        return _read_visible(cache)
    rows = [
        row
        for record in source.scenes()
        for number in range(len(record.views))
        for row in visible_rows(record, number, pack_view(source.view(record, number), record, number))
    ]
    table = pl.DataFrame(rows, {"scene": pl.Int64, "view": pl.Int64, "object": pl.String, "pixels": pl.Float64})
    with contextlib.suppress(OSError):  # a home that cannot be written costs time only
        cache.parent.mkdir(parents=True, exist_ok=True)
        with write_whole(cache) as work:
            table.write_parquet(work)
    return table
