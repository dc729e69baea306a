"""Make the packed training copy of a dataset: the command `pack`.

Same layout as the native one, but a view is `views/03.safetensors` (`datagen.packed`), and `visible.parquet` beside the
index says which objects can be seen where.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl

from datagen.errors import StoreError, UserError, full_disk_told
from datagen.packed import PackedView, pack_view, read_packed, write_packed
from datagen.source import DatasetSource, open_dataset
from datagen.store import ViewData, scene_dir, scene_indices
from datagen.training import VISIBLE, packed_file, visible_rows

Report = Callable[[float, float], None]


@dataclass(frozen=True)
class Packed:
    """What a packed dataset amounts to: views, and bytes of the native and of the packed ones."""

    views: int
    native: int
    packed: int


def pack_dataset(address: str, out: Path, *, workers: int, report: Report) -> Packed:
    """Pack every scene that `out` lacks; a scene gets its name only when whole and read back.

    Raises `UserError` where `out` holds something else, `StoreError` where a scene cannot be read.
    """
    source = open_dataset(address)
    if source.filesystem.exists(f"{source.root}/{VISIBLE}"):
        raise UserError(f"{address} is a packed dataset already")
    _begin(source, out)
    missing = sorted(set(source.indices) - set(scene_indices(out)))
    report(0, len(missing))
    with full_disk_told(out):
        for done, _ in enumerate(_pack_all(address, missing, out, workers), 1):
            report(done, len(missing))
    return _finish(source, out)


def _pack_all(address: str, indices: Sequence[int], out: Path, workers: int) -> Iterator[None]:
    """Pack scenes, and tell of each as it is done."""
    if workers == 1:
        for index in indices:
            pack_scene(address, index, out)
            yield
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(pack_scene, address, index, out) for index in indices]
        try:
            for job in as_completed(jobs):
                job.result()
                yield
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def pack_scene(address: str, index: int, out: Path) -> None:
    """Pack one scene."""
    source = open_dataset(address, where=f"index = {index}")
    record = source.scene(index)
    work = out / "work" / f"{index:06d}"
    shutil.rmtree(work, ignore_errors=True)
    for number in range(len(record.views)):
        view = source.view(record, number)
        path = work / "views" / Path(packed_file(index, number)).name
        write_packed(path, pack_view(view, record, number))
        if fault := _difference(view, read_packed(path)):
            raise StoreError(f"{path} does not read back as it was written: {fault}")
    _copy(source, f"scenes/{index:06d}/scene.json", work / "scene.json")
    scene_dir(out, index).parent.mkdir(parents=True, exist_ok=True)
    work.replace(scene_dir(out, index))


def _begin(source: DatasetSource, out: Path) -> None:
    """Make the folder, or see that it belongs to this dataset."""
    out.mkdir(parents=True, exist_ok=True)
    begun = out / "dataset.json"
    if not begun.exists():
        if any(out.iterdir()):
            raise UserError(f"--out {out} is not empty and not a packed dataset; give another folder")
        _copy(source, "dataset.json", begun)
        return
    with source.local("dataset.json") as path:
        same = path.read_bytes() == begun.read_bytes()
        if not same or path == begun or any(out.glob("scenes/*/views/*.exr")):
            raise UserError(f"--out {out} holds another dataset than a packed {source.address}; give another folder")


def _finish(source: DatasetSource, out: Path) -> Packed:
    """Write what marks a dataset as whole, the index and the list of what can be seen, and count."""
    rows, views, native, packed = [], 0, 0, 0
    for record in source.scenes():
        for number, view in enumerate(record.views):
            path = out / packed_file(record.index, number)
            rows += visible_rows(record, number, read_packed(path))
            views, native, packed = views + 1, native + view.bytes, packed + path.stat().st_size
    for name, table in (("index.parquet", source.table), (VISIBLE, pl.DataFrame(rows))):
        temporary = out / (name + ".tmp")
        table.write_parquet(temporary)
        temporary.replace(out / name)
    shutil.rmtree(out / "work", ignore_errors=True)
    return Packed(views, native, packed)


def _difference(view: ViewData, packed: PackedView) -> str:
    """Name the first variant whose values are not those of the native view, or nothing."""
    for name, layers in view.variants.items():
        if not np.array_equal(packed.variant(name), layers):
            return name
    for name, alpha in view.coverage.items():
        if not np.array_equal(packed.object_coverage(name), alpha):
            return f"coverage of {name}"
    return "" if np.array_equal(packed.z_depth, view.geometry.z_depth) else "z_depth"


def _copy(source: DatasetSource, name: str, path: Path) -> None:
    with source.local(name) as original:
        temporary = path.with_name(path.name + ".tmp")
        shutil.copyfile(original, temporary)
        temporary.replace(path)
