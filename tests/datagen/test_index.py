"""The index grows by blocks: the same bytes in whatever order scenes came, read again only where something changed."""

import hashlib
import random
import shutil
from operator import methodcaller
from pathlib import Path

import polars as pl
import pytest

from multilight.datagen.cli import main
from multilight.datagen.production import finishing
from multilight.datagen.production.finishing import Survey, finish, survey
from multilight.datagen.storage import blocks
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.index import ADDED, index_bytes, index_row
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.open_training import open_training
from multilight.datagen.storage.store import file_sha256, read_dataset, scene_dir, scene_folder
from multilight.datagen.verification.dataset import check_files, verify_dataset
from tests.datagen.chain import Json, rewrite_json
from tests.datagen.servers import http_server, in_memory

SCENES = 7


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (blocks, finishing):
        monkeypatch.setattr(module, "BLOCK", 3)


@pytest.fixture
def many(spheres_copy: Path) -> Path:
    """Records of seven scenes, all like the first, that are not in the index yet."""
    for index in range(1, SCENES):
        shutil.rmtree(scene_dir(spheres_copy, index), ignore_errors=True)
        shutil.copytree(scene_dir(spheres_copy, 0), scene_dir(spheres_copy, index))
        reason = ["contacts: nothing carries it"] * (index % 2)
        path = scene_dir(spheres_copy, index) / "scene.json"
        changed: Json = {"index": index, "thrown_away": reason, "split": "train"}
        rewrite_json(path, methodcaller("update", changed))
    (spheres_copy / "index.parquet").unlink()
    empty = {"index_sha256": "", "index_rows": 0, "assets": []}

    def begin(record: dict[str, object]) -> None:
        record["config"]["scenes"] = SCENES  # type: ignore[index]
        record["config"]["splits"] = {"train": 1.0, "val": 0.0, "test": 0.0, "test_ood": 0.0}  # type: ignore[index]
        record.update(empty)

    rewrite_json(spheres_copy / "dataset.json", begin)
    return spheres_copy


def look(root: Path) -> Survey:
    record = read_dataset(root)
    return survey(root, record, blocks.read_blocks(find_place(root), record), contents=False)


def written(root: Path) -> dict[str, str]:
    return {p.relative_to(root).as_posix(): file_sha256(p) for p in (*root.glob("*.*"), *root.glob("index/*"))}


def in_pieces(root: Path, order: list[int], size: int) -> None:
    """Finish after every few scenes."""
    for start in range(0, len(order), size):
        there = Survey()
        for index in order[start : start + size]:
            record = open_dataset(root).scene(index)
            there.add(index_row(record), record.assets)
        finish(root, there)


@pytest.mark.usefixtures("small_blocks")
def test_whatever_the_order_the_bytes_are_the_same(many: Path) -> None:
    finish(many, look(many))
    whole = written(many)
    assert set(whole) == {"dataset.json", "index.parquet", "index/000001.parquet", "index/000002.parquet"}
    assert read_dataset(many).thrown_away == {"contacts": 3}
    assert verify_dataset(str(many), quick=True).results[0][1] == []
    for size in (1, 2, 5):
        again = many.with_name(f"again-{size}")
        shutil.copytree(many, again)
        for name in set(whole) - {"dataset.json"}:
            (again / name).unlink()
        rewrite_json(
            again / "dataset.json",
            lambda r: r.update(index_sha256="", index_more=[], index_rows=0, assets=[], thrown_away={}),
        )
        in_pieces(again, random.Random(size).sample(range(SCENES), SCENES), size)
        assert written(again) == whole


@pytest.mark.usefixtures("small_blocks")
def test_one_more_scene_changes_its_own_block(many: Path) -> None:
    last = many.with_name("last")
    scene_dir(many, SCENES - 1).rename(last)
    finish(many, look(many))
    before = written(many)
    last.rename(scene_dir(many, SCENES - 1))
    there = look(many)
    assert list(there.rows) == [SCENES - 1]
    finish(many, there)
    after = written(many)
    assert {name for name in after if after[name] != before.get(name)} == {"dataset.json", "index/000002.parquet"}


@pytest.mark.usefixtures("small_blocks")
@pytest.mark.parametrize("where", ["folder", "memory", "http"])
def test_blocks_are_read_at_any_address(many: Path, where: str) -> None:
    finish(many, look(many))
    if where == "folder":
        assert open_dataset(many).indices == tuple(range(SCENES))
    elif where == "memory":
        with in_memory(many) as address:
            assert open_dataset(address).indices == tuple(range(SCENES))
    else:
        with http_server(many) as (address, asked):
            assert open_dataset(address, where="index > 4").indices == (5, 6)
            assert not any("scenes" in name for name in asked)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Which scenes' records are read to look at what is there."""
    found: list[int] = []

    def counting(place: object, index: int, *rest: object, **more: object) -> object:
        found.append(index)
        return check_files(place, index, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(finishing, "check_files", counting)
    return found


@pytest.mark.usefixtures("small_blocks")
def test_records_that_the_index_covers_are_not_read(many: Path, asked: list[int]) -> None:
    finish(many, look(many))
    asked.clear()
    there = look(many)
    assert there.sound == set(range(SCENES))
    assert asked == []
    (scene_dir(many, 4) / "scene.json").touch()
    there = look(many)
    assert asked == [4]
    finish(many, there)
    asked.clear()
    assert look(many).sound == set(range(SCENES))
    assert asked == []
    content = bytearray((scene_dir(many, 5) / "scene.json").read_bytes())
    content[500] ^= 1
    (scene_dir(many, 5) / "scene.json").write_bytes(content)
    assert list(look(many).damaged) == [5]


@pytest.mark.usefixtures("small_blocks")
def test_an_index_in_one_file_of_before_goes_on(many: Path, asked: list[int], tmp_path: Path) -> None:
    finish(many, look(many))
    now = written(many)
    table = open_dataset(many).table.drop(ADDED)
    shutil.rmtree(many / "index")
    (many / "index.parquet").write_bytes(index_bytes(table))
    digest = hashlib.sha256((many / "index.parquet").read_bytes()).hexdigest()
    rewrite_json(many / "dataset.json", lambda r: r.update(index_sha256=digest, index_more=[], thrown_away={}))
    assert main(["query", str(many), "index > 5"]) == 0
    assert verify_dataset(str(many), quick=True).results[0][1] == []
    asked.clear()
    finish(many, look(many))
    assert asked == list(range(SCENES))
    assert written(many) == now


@pytest.mark.usefixtures("small_blocks")
def test_a_damaged_block_is_made_up_alone(many: Path, capsys: pytest.CaptureFixture[str]) -> None:
    finish(many, look(many))
    whole = open_dataset(many).table
    (many / "index/000001.parquet").write_bytes(b"PAR1 and no more PAR1")
    assert open_dataset(many).table.equals(whole)
    assert "made up from the 3 scenes" in capsys.readouterr().err
    (many / "index/000007.parquet").write_bytes(b"stray")
    found = [fault.message for fault in verify_dataset(str(many), quick=True).results[0][1]]
    assert any("index/000001.parquet cannot be read" in message for message in found)
    assert "index/000007.parquet is no file of this dataset; remove it" in found


def test_a_sample_of_scenes_is_verified(many: Path) -> None:
    finish(many, look(many))
    shutil.rmtree(scene_dir(many, 3) / "views")
    checked = verify_dataset(str(many), quick=True, sample=2).results
    assert [index for index, _ in checked] == [None, 0, 3]
    assert checked[2][1]
    assert main(["verify", str(many), "--sample", "0"]) == 1


def test_what_can_be_seen_is_known_from_the_index(spheres_dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stated = open_training(spheres_dataset).visible.sort("scene", "view", "object")
    monkeypatch.setattr("multilight.datagen.storage.open_training._stated", None)
    source = open_dataset(spheres_dataset)
    measured = [
        (record.index, number, name, float(alpha.sum(dtype="float64")))
        for record in source.scenes()
        for number, view in enumerate(source.views(record))
        for name, alpha in view.coverage.items()
    ]
    assert sorted(stated.select("scene", "view", "object", "pixels").iter_rows()) == sorted(measured)
    assert stated.schema["view"] == pl.Int64


def test_ten_thousand_rows_are_printed_in_a_second(
    many: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import time

    from multilight.datagen.commands.look_up import print_rows

    finish(many, look(many))
    table = open_dataset(many).table
    rows = pl.concat([table] * (10_000 // len(table) + 1)).head(10_000)
    for terminal in (True, False):
        monkeypatch.setattr("sys.stdout.isatty", lambda terminal=terminal: terminal)
        start = time.process_time()
        print_rows(
            rows.select("index", "kind", "split", "emissive", "mirror", "hardest_deg", "insertable"), as_json=False
        )
        assert time.process_time() - start < 1.0
        assert capsys.readouterr().out.count(scene_folder(0)) == 0
