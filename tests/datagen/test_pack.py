"""The packed copy: the same values as the native views, and clear words where a file is damaged."""

import json
import pickle
import shutil
from dataclasses import replace
from operator import methodcaller
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import torch
from safetensors.numpy import load, save

from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.report import silent
from multilight.datagen.storage.manifest import read_manifest
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.open_training import open_training, packed_file
from multilight.datagen.storage.pack import pack_dataset
from multilight.datagen.storage.packed import SAME, pack_view, read_packed, write_packed
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, read_scene, read_view, scene_dir, write_view
from multilight.model.data import MultiLightDataset, SampleSettings
from multilight.scenes.colour import luminance
from tests.datagen.chain import chain, rewrite_json

pytestmark = pytest.mark.usefixtures("own_cache")


def pack(native: Path, out: Path) -> Path:
    pack_dataset(str(native), out, workers=1, report=silent)
    return out


@pytest.fixture
def damaged(packed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(packed, tmp_path / "damaged"))


def test_every_value_is_the_native_one(spheres_dataset: Path, packed: Path) -> None:
    source = open_dataset(spheres_dataset)
    for record in source.scenes():
        for number, stated in enumerate(record.views):
            native, view = source.view(record, number), read_packed(packed / packed_file(record.index, number))
            assert view.lights == native.lights
            assert set(view.objects) == set(record.scene.insertable)
            for name, layers in native.variants.items():
                np.testing.assert_array_equal(view.variant(name), layers, err_msg=name)
            for name, alpha in native.coverage.items():
                np.testing.assert_array_equal(view.object_coverage(name), alpha, err_msg=name)
            np.testing.assert_array_equal(view.z_depth, native.geometry.z_depth)
            np.testing.assert_array_equal(view.K, stated.K)
            np.testing.assert_array_equal(view.c2w, stated.c2w)
            assert len(view.conditions) == len(record.conditions)


@pytest.mark.parametrize("stated", [{"index_sha256": "", "index_rows": 0}, {"index_more": ["0" * 64, "1" * 64]}])
def test_the_copy_states_its_own_index(
    stated: dict[str, object], spheres_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also of a dataset that is still being made, or whose index has several files."""
    rewrite_json(spheres_copy / "dataset.json", methodcaller("update", stated))
    indices = open_dataset(spheres_copy).indices
    out = pack(spheres_copy, tmp_path / "copy")
    capsys.readouterr()
    whole = open_dataset(out)
    assert capsys.readouterr().err == ""
    assert whole.indices == indices
    assert whole.record.index_rows == len(indices)


def test_what_equals_all_or_nothing_takes_no_pixels(packed: Path) -> None:
    view = read_packed(packed / packed_file(0, 0))
    same = [_equal_tiles(view.variant(f"without_{name}"), view.variant("all")) for name in view.objects]
    np.testing.assert_array_equal(view.without == SAME, same)
    assert np.mean(same) > 0.2
    assert len(np.unique(view.tiles.reshape(len(view.tiles), -1), axis=0)) == len(view.tiles)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_one_step_in_one_channel_of_one_pixel_is_kept(
    sphere_view: tuple[SceneRecord, ViewData], dtype: type, tmp_path: Path
) -> None:
    """Variants of the same luminance, of another sign of zero, or off by one step are not taken for `all`."""
    record, view = sphere_view
    rng = np.random.default_rng(0)
    whole: np.ndarray = rng.uniform(0.1, 1.0, view.variants["all"].shape).astype(dtype)
    if dtype is np.float32:
        whole *= np.float32(1e6)
    whole[:, :16, :16] = 0
    variants = {"all": whole}
    for name in set(view.variants) - {"all"}:
        variants[name] = whole.copy()
        light, row, column, channel = (int(rng.integers(0, count)) for count in whole.shape)
        variants[name][light, row, column, channel] = np.nextafter(whole[light, row, column, channel], dtype(np.inf))
        red, green = (float(luminance(np.eye(3)[i])) for i in range(2))
        hue = np.array([0.5 / red, -0.5 / green, 0.0]) * 0.1
        variants[name][0, 40, 40] = np.maximum(whole[0, 40, 40] + hue * whole[0, 40, 40, 1], 0)
        variants[name][0, 3, 3, 1] = dtype(-0.0)
    changed = replace(view, variants={name: layers.astype(np.float32) for name, layers in variants.items()})
    write_packed(tmp_path / "view.safetensors", pack_view(changed, record, 0))
    back = read_packed(tmp_path / "view.safetensors")
    for name, layers in variants.items():
        assert back.variant(name).dtype == dtype
        assert back.variant(name).tobytes() == layers.tobytes(), name


@pytest.mark.parametrize("value", [np.nan, np.inf, -0.5])
@pytest.mark.parametrize("name", ["all", "tiles", "alpha", "z_depth", "conditions"])
def test_values_that_no_view_has_are_named(packed: Path, tmp_path: Path, name: str, value: float) -> None:
    view = read_packed(packed / packed_file(0, 0))
    values = getattr(view, name).copy()
    values.reshape(-1)[len(values.reshape(-1)) // 2] = value
    write_packed(tmp_path / "view.safetensors", replace(view, **{name: values}))
    with pytest.raises(StoreError, match=f"damaged: {name} holds NaN, infinite or negative"):
        read_packed(tmp_path / "view.safetensors")


def test_a_damaged_dataset_is_not_packed(spheres_copy: Path, tmp_path: Path) -> None:
    """A layer that is not a number stays out of the copy, and nothing is left that looks like one."""
    folder = scene_dir(spheres_copy, 1)
    record = read_scene(folder)
    path = folder / record.views[1].file
    view = read_view(path)
    view.variants["all"][0, 5, 5, 2] = np.nan
    write_view(path, view)
    views = [
        v.model_copy(update={"bytes": path.stat().st_size}) if v.file == "views/01.exr" else v for v in record.views
    ]
    (folder / "scene.json").write_text(record.model_copy(update={"views": tuple(views)}).sealed().model_dump_json())
    chain(spheres_copy)
    with pytest.raises(StoreError, match=r"scenes/000001/views/01.exr: all holds NaN.*multilight verify"):
        pack(spheres_copy, tmp_path / "copy")
    assert not (tmp_path / "copy" / "manifest.json").exists()
    with pytest.raises(StoreError, match="not finished"):
        read_manifest(tmp_path / "copy")


def _equal_tiles(layers: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Compare (L, H, W, 3) tile by tile: (L, T) bool. The test's pictures are whole tiles."""
    lights, height, width, _ = layers.shape
    equal = (layers == others).reshape(lights, height // 16, 16, width // 16, 16, 3)
    return equal.all(axis=(2, 4, 5)).reshape(lights, -1)


def test_radiance_beyond_half_stays_float(spheres_dataset: Path, tmp_path: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    view = source.view(record, 0)
    bright = {name: layers * np.float32(1e6) for name, layers in view.variants.items()}
    write_packed(tmp_path / "view.safetensors", pack_view(replace(view, variants=bright), record, 0))
    np.testing.assert_array_equal(read_packed(tmp_path / "view.safetensors").variant("all"), bright["all"])


@pytest.mark.parametrize("views", [1, 2])
def test_training_reads_packed_and_native_alike(spheres_dataset: Path, packed: Path, views: int) -> None:
    settings = SampleSettings(size=40, views=views, split=None, visible=5, length=12)
    native, copy = MultiLightDataset(spheres_dataset, settings), MultiLightDataset(packed, settings)
    assert not native.source.packed
    assert copy.source.packed
    for index in range(12):
        one, other = native[index], copy[index]
        assert one.pop("meta") == other.pop("meta")
        for name, values in one.items():
            assert torch.equal(values, other[name]), (index, name)


def test_packing_again_adds_only_what_is_missing(spheres_dataset: Path, damaged: Path) -> None:
    before = {path: path.read_bytes() for path in damaged.rglob("*") if path.is_file()}
    kept = damaged / packed_file(0, 0)
    stamp = kept.stat().st_mtime_ns
    shutil.rmtree(damaged / "scenes" / "000001")
    pack(spheres_dataset, damaged)
    assert {path: path.read_bytes() for path in damaged.rglob("*") if path.is_file()} == before
    assert kept.stat().st_mtime_ns == stamp


def test_a_scene_alone_is_little_and_held_to_the_index(spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    alone = source.alone(source.indices[-1])
    assert alone.indices == source.indices[-1:]
    assert len(pickle.dumps(alone)) < 20_000
    digest = source.scene(source.indices[-1]).record_sha256
    swapped = replace(source, table=source.table.with_columns(record_sha256=pl.lit("0" * 64)))
    assert alone.scene(source.indices[-1]).record_sha256 == digest
    with pytest.raises(StoreError, match="is not the one of the index"):
        swapped.alone(source.indices[-1]).scene(source.indices[-1])


def test_foreign_folders_are_refused(spheres_dataset: Path, packed: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="packed dataset already"):
        pack(packed, tmp_path / "twice")
    with pytest.raises(UserError, match="not empty"):
        pack(spheres_dataset, spheres_dataset)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(UserError, match="not empty"):
        pack(spheres_dataset, tmp_path / "full")
    with pytest.raises(StoreError, match="nowhere"):
        pack(tmp_path / "nowhere", tmp_path / "out")


@pytest.mark.parametrize("kept", [0, 5, 100, 0.5, 0.999])
def test_truncated_views_are_named(damaged: Path, kept: float) -> None:
    path = damaged / packed_file(1, 2)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content)) if kept < 1 else int(kept)])
    with pytest.raises(StoreError, match=f"{path}.*truncated or damaged"):
        read_packed(path)
    with pytest.raises(StoreError, match=f"{path}.*truncated or damaged.*made anew by: multilight pack"):
        open_training(damaged)


def test_foreign_and_contradictory_views_are_named(damaged: Path) -> None:
    path = damaged / packed_file(0, 1)
    content = path.read_bytes()
    arrays = load(content)
    length = int.from_bytes(content[:8], "little")
    stated = json.loads(json.loads(content[8 : 8 + length])["__metadata__"]["multilight"])
    named = {"multilight": json.dumps(stated)}
    short = {"tiles": arrays["tiles"][:-1], "alpha": arrays["alpha"][:-1], "all": arrays["all"][:1]}
    cases = [
        (save({"weights": np.zeros(3, np.float32)}), "not a 'multilight packed view"),
        (save(arrays, {"multilight": json.dumps(stated | {"format": "multilight packed view 99"})}), "view 99"),
        (save(arrays, {"multilight": "[1"}), "damaged"),
        (save({k: v for k, v in arrays.items() if k != "alpha"}, named), "alpha"),
        (save(arrays | {"tiles": short["tiles"]}, named), "tiles that are not there"),
        (save(arrays | {"alpha": short["alpha"]}, named), "coverage names"),
        (save(arrays | {"all": np.concatenate([arrays["all"], arrays["all"]])}, named), "all has shape"),
        (save(arrays | {"z_depth": arrays["z_depth"][0]}, named), "z_depth has shape"),
        (save(arrays | {"without": arrays["without"].astype(np.float32)}, named), "without is of type float32"),
    ]
    for written, words in cases:
        path.write_bytes(written)
        with pytest.raises(StoreError, match=words) as told:
            read_packed(path)
        assert str(path) in str(told.value)
    path.unlink()
    with pytest.raises(StoreError, match=f"{path} is missing"):
        read_packed(path)
    with pytest.raises(StoreError, match=f"{path} is missing.*made anew by: multilight pack"):
        open_training(damaged)


def test_damaged_list_is_named(damaged: Path) -> None:
    (damaged / "visible.parquet").write_bytes(b"PAR1 nonsense")
    with pytest.raises(StoreError, match=r"visible\.parquet is not what manifest\.json states; made anew by"):
        open_training(damaged)


def test_command_reports_bytes(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "copy"
    assert main(["pack", str(spheres_dataset), "--out", str(out), "--workers", "2"]) == 0
    size = sum(path.stat().st_size for path in out.rglob("*.safetensors")) / 6 / 1e6
    assert f"6 views of {size:.2f} MB (native: " in capsys.readouterr().out
    assert not (out / "work").exists()
