"""Make the packed training copy of a dataset: the command `pack`.

Same layout as the native one, but a view is `views/03.safetensors` (`datagen.storage.packed`), `visible.parquet` beside
the index says which objects can be seen where, and `manifest.json` (`datagen.storage.manifest`) names every file with
its hash.
"""

import hashlib
import shutil
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import Copy, files_of, in_processes, making, whole_folder
from multilight.datagen.storage.index import index_bytes
from multilight.datagen.storage.manifest import FileEntry
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.open_training import VISIBLE, packed_file, visible_rows
from multilight.datagen.storage.packed import PackedView, pack_view, read_packed, value_fault, write_packed
from multilight.datagen.storage.store import ViewData, scene_folder, write_text
from multilight.scenes.files.atomic import write_whole


@dataclass(frozen=True)
class Packed:
    """What a packed dataset amounts to: scenes made and kept, views, and bytes of the native and of the packed ones."""

    made: int
    kept: int
    views: int
    native: int
    packed: int


def pack_dataset(address: str, out: Path, *, workers: int, report: Report) -> Packed:
    """Pack every scene that `out` lacks or holds damaged or from another state of the dataset.

    A scene gets its name only when whole and read back. Raises `UserError` where `out` holds something else,
    `StoreError` where a scene cannot be read.
    """
    source = open_dataset(address)
    if source.place.exists(VISIBLE):
        raise UserError(f"{address} is a packed dataset already")
    with making(out, "packed", source, {}) as copy:
        missing = [index for index in source.indices if not copy.keeps(scene_folder(index), index)]
        report(0, len(missing))
        packing = in_processes(partial(pack_scene, out), [source.alone(index) for index in missing], workers)
        for done, (scene, files) in enumerate(packing, 1):
            (index,) = scene.indices
            copy.add(scene_folder(index), index, files())
            report(done, len(missing))
        return _finish(source, copy, len(missing))


def pack_scene(out: Path, source: DatasetSource) -> dict[str, FileEntry]:
    """Pack the one scene of a dataset; returns the hashes of its files."""
    (index,) = source.indices
    record = source.scene(index)
    with whole_folder(out, scene_folder(index)) as work:
        for number, stated in enumerate(record.views):
            view = source.view(record, number)
            packed = pack_view(view, record, number)
            if fault := value_fault(packed):
                shown = f"{source.address}/{scene_folder(index)}/{stated.file}"
                raise StoreError(f"{shown}: {fault}; see: multilight verify {source.address}")
            path = work / "views" / Path(packed_file(index, number)).name
            write_packed(path, packed)
            if fault := _difference(view, read_packed(path)):
                raise StoreError(f"{path} does not read back as it was written: {fault}")
        with source.local(f"{scene_folder(index)}/scene.json") as path:
            shutil.copyfile(path, work / "scene.json")
    return files_of(out, scene_folder(index))


def _finish(source: DatasetSource, copy: Copy, made: int) -> Packed:
    """Write what marks a dataset as whole, the index and the list of what can be seen, and count."""
    rows, views, native, packed = [], 0, 0, 0
    for record in source.scenes():
        for number, view in enumerate(record.views):
            path = copy.root / packed_file(record.index, number)
            rows += visible_rows(record, number, read_packed(path))
            views, native, packed = views + 1, native + view.bytes, packed + path.stat().st_size
    content = index_bytes(source.table)  # as it was read: the file may be damaged, or not there yet, or be several
    stated = {"index_sha256": hashlib.sha256(content).hexdigest(), "index_more": (), "index_rows": len(source.indices)}
    if stated == source.record.model_dump(include=set(stated)):
        _copy(source, "dataset.json", copy.root)
    else:
        own = source.record.model_copy(update=stated).sealed()
        write_text(copy.root / "dataset.json", own.model_dump_json(indent=1))
    with write_whole(copy.root / "index.parquet") as work:
        work.write_bytes(content)
    with write_whole(copy.root / VISIBLE) as work:
        pl.DataFrame(rows).write_parquet(work)
    copy.finish("dataset.json", "index.parquet", VISIBLE)
    return Packed(made, len(source.indices) - made, views, native, packed)


def _copy(source: DatasetSource, name: str, root: Path) -> None:
    with source.local(name) as original, write_whole(root / name) as work:
        shutil.copyfile(original, work)


def _difference(view: ViewData, packed: PackedView) -> str:
    """Name the first variant whose values are not those of the native view, or nothing."""
    for name, layers in view.variants.items():
        if not np.array_equal(packed.variant(name), layers):
            return name
    for name, alpha in view.coverage.items():
        if not np.array_equal(packed.object_coverage(name), alpha):
            return f"coverage of {name}"
    return "" if np.array_equal(packed.z_depth, view.geometry.z_depth) else "z_depth"
