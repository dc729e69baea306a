"""Broken, truncated and foreign datasets: an error that names file and reason, or a scene skipped and counted."""

import contextlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import polars as pl
import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError
from multilight.datagen.storage.open_dataset import open_dataset
from tests.datagen.chain import rewrite_json
from tests.datagen.servers import in_memory


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def damage_pixels(path: Path) -> None:
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 4000] = bytes(4000)
    path.write_bytes(content)


def foreign_exr(path: Path) -> None:
    shutil.copy(path.parent.parent.parent / "000000" / "views" / "00.exr", path)


Damage = tuple[str, Callable[[Path], object], str]
DAMAGES: dict[str, Damage] = {
    "truncated view": ("scenes/000001/views/00.exr", truncate, "truncated or replaced: .* bytes"),
    "empty view": ("scenes/000001/views/00.exr", lambda path: path.write_bytes(b""), "truncated or replaced: 0 bytes"),
    "zeros as view": (
        "scenes/000001/views/00.exr",
        lambda path: path.write_bytes(bytes(path.stat().st_size)),
        "cannot be decoded",
    ),
    "damaged pixels": ("scenes/000001/views/00.exr", damage_pixels, "truncated or damaged|is damaged"),
    "view of another scene": ("scenes/000001/views/00.exr", foreign_exr, "truncated or replaced"),
    "missing view": ("scenes/000001/views/00.exr", Path.unlink, "missing"),
    "truncated record": ("scenes/000001/scene.json", truncate, "damaged"),
    "binary record": ("scenes/000001/scene.json", lambda path: path.write_bytes(b"\xff\xfe\x00"), "cannot be read"),
    "missing record": ("scenes/000001/scene.json", Path.unlink, "missing"),
    "record of another scene": (
        "scenes/000001/scene.json",
        lambda path: shutil.copy(path.parent.parent / "000000" / "scene.json", path),
        "record of scene 0",
    ),
}
FATAL: dict[str, Damage] = {
    "truncated dataset.json": ("dataset.json", truncate, "damaged"),
    "missing dataset.json": ("dataset.json", Path.unlink, "not a dataset"),
    "other schema": (
        "dataset.json",
        lambda path: path.write_text(path.read_text().replace('"schema_version": 3', '"schema_version": 99')),
        "schema version 99",
    ),
    "changed dataset.json": (
        "dataset.json",
        lambda path: path.write_text(path.read_text().replace('"seed": 0', '"seed": 1')),
        "it was changed",
    ),
}
INDICES: dict[str, Callable[[Path], object]] = {
    "truncated": truncate,
    "text": lambda path: path.write_bytes(b"nonsense"),
    "empty": lambda path: path.write_bytes(b""),
    "foreign": lambda path: pl.DataFrame({"name": ["a"]}).write_parquet(path),
    "missing": Path.unlink,
    "a row less": lambda path: pl.read_parquet(path).head(1).write_parquet(path),
    "a row twice": lambda path: pl.concat([pl.read_parquet(path)] * 2).write_parquet(path),
    "a wrong row": lambda path: pl.read_parquet(path).with_columns(views=pl.lit(7, pl.Int64)).write_parquet(path),
}


@contextlib.contextmanager
def placed(where: str, folder: Path) -> Iterator[str]:
    if where == "folder":
        yield str(folder)
    else:
        with in_memory(folder) as address:
            yield address


@pytest.mark.parametrize("where", ["folder", "memory"])
@pytest.mark.parametrize("name", DAMAGES)
def test_damage_in_a_scene_is_named_or_skipped(name: str, where: str, spheres_copy: Path) -> None:
    file, damage, reason = DAMAGES[name]
    damage(spheres_copy / file)
    with placed(where, spheres_copy) as address:
        source = open_dataset(address)
        with pytest.raises(StoreError, match=reason) as caught:
            [source.view(record, 0) for record in source.scenes()]
        assert f"{address}/{file}" in str(caught.value)
        patient = open_dataset(address, on_broken="skip")
        read = []
        for record in patient.scenes():
            with patient.passing_over(record.index):
                patient.view(record, 0)
                read.append(record.index)
        assert read == [0]
        assert list(patient.skipped) == [1]
        assert f"{address}/{file}" in patient.skipped[1]


@pytest.mark.parametrize("where", ["folder", "memory"])
@pytest.mark.parametrize("name", FATAL)
def test_damage_to_the_whole_is_named(name: str, where: str, spheres_copy: Path) -> None:
    file, damage, reason = FATAL[name]
    damage(spheres_copy / file)
    with placed(where, spheres_copy) as address:
        with pytest.raises(StoreError, match=reason) as caught:
            open_dataset(address, on_broken="skip")
        assert f"{address}/{file}" in str(caught.value)


@pytest.mark.parametrize("where", ["folder", "memory"])
@pytest.mark.parametrize("name", INDICES)
def test_a_wrong_index_is_made_up_and_told(
    name: str, where: str, spheres_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = open_dataset(spheres_copy).table
    INDICES[name](spheres_copy / "index.parquet")
    with placed(where, spheres_copy) as address:
        assert open_dataset(address).table.equals(before)
        told = capsys.readouterr().err
        assert told.count("\n") == 1
        assert f"{address}/index.parquet" in told
        assert f"multilight dataset --out {address} --repair" in told
        assert main(["query", address, "views = 3", "--json"]) == 0
        assert len(json.loads(capsys.readouterr().out)) == 2


def test_a_foreign_folder_is_no_dataset(tmp_path: Path) -> None:
    (tmp_path / "cat.png").write_bytes(b"")
    with pytest.raises(StoreError, match=r"dataset\.json is missing: not a dataset"):
        open_dataset(tmp_path)


def test_a_mistyped_folder_is_told_of_the_dataset_beside_it(spheres_copy: Path) -> None:
    with pytest.raises(StoreError, match=rf"is missing: did you mean '{spheres_copy.name}'\? not a dataset"):
        open_dataset(spheres_copy.with_name(spheres_copy.name + "s"))


@pytest.mark.parametrize("where", ["folder", "memory"])
def test_an_unfinished_dataset_is_read_from_its_scenes(where: str, spheres_copy: Path) -> None:
    finished = open_dataset(spheres_copy).table
    (spheres_copy / "index.parquet").unlink()
    rewrite_json(spheres_copy / "dataset.json", lambda record: record.update(index_sha256="", index_rows=0, assets=[]))
    with placed(where, spheres_copy) as address:
        assert open_dataset(address).table.equals(finished)
        truncate(spheres_copy / "scenes/000001/scene.json")
    assert open_dataset(spheres_copy, on_broken="skip").indices == (0,)
    shutil.rmtree(spheres_copy / "scenes")
    with pytest.raises(StoreError, match=r"index\.parquet is missing"):
        open_dataset(spheres_copy)


def test_skipping_is_counted_aloud(spheres_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truncate(spheres_copy / "scenes/000001/views/02.exr")
    words = ["export", "nerfstudio", str(spheres_copy), "--conditions", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert "000001/views/02.exr is truncated" in capsys.readouterr().err
    assert not (tmp_path / "out" / "scene_000001" / "all").exists()
    assert main([*words, "--on-broken", "skip"]) == 0
    shown = capsys.readouterr().out
    assert "passed over 1 of 2 scenes" in shown
    assert "1 captures" in shown


def test_verify_finds_a_damaged_view_at_an_address(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truncate(spheres_copy / "scenes/000001/views/00.exr")
    with in_memory(spheres_copy) as address:
        assert main(["verify", address]) == 1
    assert "scene 1, view 0: files" in capsys.readouterr().out
