"""What is on disk is what was made: each kind of damage is found and named, and repaired to equal bytes."""

import contextlib
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import polars as pl
import pytest

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError
from multilight.datagen.production.running import Work
from multilight.datagen.production.scene import SceneMaker, make_scene
from multilight.datagen.production.worker import report_of
from multilight.datagen.storage.index import index_bytes, parse_index
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import file_sha256, read_scene, read_view, write_text
from multilight.datagen.verification.dataset import verify_dataset
from multilight.scenes.assets.library import AssetLibrary
from tests.conftest import SPHERES
from tests.datagen.chain import Json, chain, rewrite_json
from tests.datagen.servers import http_server, in_memory, s3_server


def run(*words: object) -> int:
    return main([str(word) for word in words])


def contents(root: Path) -> dict[str, str]:
    """Hash every file that belongs to the data."""
    files = [p for p in root.rglob("*") if p.is_file() and p.name != ".lock"]
    return {p.relative_to(root).as_posix(): file_sha256(p) for p in files}


def told(root: str | Path, *, quick: bool = False) -> list[str]:
    """Verify and return each fault as a line that says where."""
    faults = [fault for _, found in verify_dataset(str(root), quick=quick).results for fault in found]
    return [f"{fault.scene} {fault.view} {fault.message}" for fault in faults]


def edit(file: str, old: str, new: str) -> Callable[[Path], None]:
    """Change a text in a file, as a hand or a failing disk would."""

    def change(root: Path) -> None:
        text = (root / file).read_text()
        assert old in text
        (root / file).write_text(text.replace(old, new, 1))

    return change


def number(file: str, *keys: str | int, by: float) -> Callable[[Path], None]:
    """Multiply a number of a record, which keeps its old hash."""

    def change(root: Path) -> None:
        content = json.loads((root / file).read_text())
        inner = content
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = inner[keys[-1]] * by
        (root / file).write_text(json.dumps(content))

    return change


def swapped(first: str, second: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        (root / first).rename(root / "aside")
        (root / second).rename(root / first)
        (root / "aside").rename(root / second)

    return change


def flipped(file: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        content = bytearray((root / file).read_bytes())
        content[len(content) // 2] ^= 16
        (root / file).write_bytes(content)

    return change


def index_with(change: Callable[[pl.DataFrame], pl.DataFrame]) -> Callable[[Path], None]:
    return lambda root: change(pl.read_parquet(root / "index.parquet")).write_parquet(root / "index.parquet")


def removed(name: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        shutil.rmtree(root / name) if (root / name).is_dir() else (root / name).unlink()

    return change


def added(name: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(b"stray")

    return change


def moved(old: str, new: str) -> Callable[[Path], object]:
    return lambda root: (root / old).rename(root / new)


def copied(old: str, new: str) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        if (root / old).is_dir():
            shutil.copytree(root / old, root / new, dirs_exist_ok=True)
        else:
            shutil.copy(root / old, root / new)

    return change


S0, S1 = "scenes/000000", "scenes/000001"
CREDIT = {"id": "a/b", "pack": "a", "name": "b", "creator": "c", "licence": "CC0"}
QUICK: dict[str, tuple[Callable[[Path], object], str]] = {
    "scene folder missing": (removed(S1), "1 None scenes/000001 is missing"),
    "record missing": (removed(f"{S1}/scene.json"), r"1 None .*scene\.json is missing"),
    "record cut": (lambda root: os.truncate(root / S1 / "scene.json", 1000), r"1 None .*scene\.json is damaged"),
    "record empty": (lambda root: os.truncate(root / S1 / "scene.json", 0), r"1 None .*scene\.json is damaged"),
    "view missing": (removed(f"{S1}/views/02.exr"), r"1 2 views/02\.exr is missing"),
    "views missing": (removed(f"{S1}/views"), r"1 0 views/00\.exr is missing"),
    "view cut": (lambda root: os.truncate(root / S1 / "views/01.exr", 1000), r"1 1 views/01\.exr is truncated"),
    "views swapped": (swapped(f"{S1}/views/00.exr", f"{S1}/views/01.exr"), r"1 0 views/00\.exr is truncated"),
    "preview missing": (removed(f"{S1}/preview.png"), r"1 None preview\.png is missing"),
    "preview flipped": (flipped(f"{S1}/preview.png"), r"1 None preview\.png was changed"),
    "preview of another": (copied(f"{S0}/preview.png", f"{S1}/preview.png"), r"1 None preview\.png was changed"),
    "scenes swapped": (swapped(S0, S1), "0 None .*is the record of scene 1, not of scene 0"),
    "scene copied over another": (copied(S0, S1), "1 None .*is the record of scene 0"),
    "scene renamed": (moved(S1, "scenes/000005"), "5 None it lies beyond the dataset's 2 scenes"),
    "extra scene": (copied(S1, "scenes/000007"), "7 None it lies beyond"),
    "extra folder": (added("scenes/000001 (copy)/x"), r"None None scenes/000001 \(copy\) is no scene"),
    "oddly named": (added("scenes/²/x"), "None None scenes/² is no scene"),
    "extra file among scenes": (added("scenes/notes.txt"), r"None None scenes/notes\.txt is no scene"),
    "extra file in a scene": (added(f"{S1}/notes.txt"), r"1 None scenes/000001/notes\.txt is no file"),
    "extra view": (copied(f"{S1}/views/00.exr", f"{S1}/views/03.exr"), r"1 None .*/views/03\.exr is no file"),
    "empty folder in a scene": (lambda root: (root / S1 / "views" / "old").mkdir(), "1 None .*views/old is no file"),
    "gain": (number(f"{S1}/scene.json", "conditions", 0, "gains", "environment", 0, by=1.01), "1 None .*was changed"),
    "exposure": (number(f"{S1}/scene.json", "conditions", 0, "exposure_ev", by=1.01), "1 None .*it was changed"),
    "K": (number(f"{S1}/scene.json", "views", 0, "K", 0, 0, by=2), "1 None .*it was changed"),
    "c2w": (number(f"{S1}/scene.json", "views", 0, "c2w", 0, 3, by=2), "1 None .*it was changed"),
    "camera": (number(f"{S1}/scene.json", "scene", "cameras", 0, "fx", by=2), "1 None .*it was changed"),
    "split": (edit(f"{S1}/scene.json", '"split": "', '"split": "test_ood", "was": "'), "1 None .*it was changed"),
    "attempt": (edit(f"{S1}/scene.json", '"attempt": 0', '"attempt": 1'), "1 None .*it was changed"),
    "index missing": (removed("index.parquet"), r"None None .*index\.parquet is missing"),
    "index cut": (lambda root: os.truncate(root / "index.parquet", 900), r"None None index\.parquet cannot be read"),
    "index row missing": (index_with(lambda table: table.head(1)), "1 None index.parquet has no row of it"),
    "index row doubled": (index_with(lambda t: pl.concat([t, t.head(1)])), "None None .* has 2 rows of scene 0"),
    "index row wrong": (
        index_with(lambda table: table.with_columns(views=pl.Series([3, 4], dtype=pl.Int64))),
        "1 None index.parquet states another views than",
    ),
    "index row of no scene": (
        index_with(lambda table: pl.concat([table, table.head(1).with_columns(index=pl.lit(1_0, pl.Int64))])),
        "10 None scenes/000010 is missing",
    ),
    "index rows swapped": (
        index_with(lambda table: table.with_columns(index=pl.col("index").reverse())),
        "0 None index.parquet states another .*record_sha256",
    ),
    "index lacks a column": (index_with(lambda t: t.drop("kind")), "None None index.parquet has no column 'kind'"),
    "dataset.json cut": (lambda root: os.truncate(root / "dataset.json", 500), r"None None .*dataset\.json is damaged"),
    "dataset.json missing": (removed("dataset.json"), r"None None .*dataset\.json is missing"),
    "dataset.json changed": (edit("dataset.json", '"spp": 4', '"spp": 5'), r"None None .*it was changed"),
    "credits lost": (
        lambda root: rewrite_json(root / "dataset.json", lambda record: record.update(assets=[CREDIT])),
        "None None dataset.json lists other assets",
    ),
    "more scenes announced": (
        lambda root: rewrite_json(root / "dataset.json", lambda record: record["config"].update(scenes=20)),
        "None None 2 of 20 scenes are there; the others are made by: multilight dataset --out ",
    ),
    "record changed and hashed": (
        lambda root: rewrite_json(root / S1 / "scene.json", lambda record: record.update(split="test_ood")),
        "1 None scene.json is of another dataset: its split is 'test_ood'",
    ),
    "stale record": (
        lambda root: rewrite_json(root / S1 / "scene.json", lambda record: record.update(attempt=2)),
        "1 None index.parquet states another attempt, record_sha256",
    ),
}  # fmt: skip
FULL: dict[str, tuple[Callable[[Path], object], str]] = {
    "view flipped": (flipped(f"{S1}/views/01.exr"), r"1 1 views/01\.exr was changed"),
    "view zeroed": (
        lambda root: (root / S1 / "views/01.exr").write_bytes(bytes((root / S1 / "views/01.exr").stat().st_size)),
        r"1 1 views/01\.exr was changed",
    ),
}
WHOLE = ("dataset.json cut", "dataset.json missing", "dataset.json changed")
"""What a repair needs the options for that the dataset was made with."""
LEFT = ("extra folder", "oddly named", "extra file among scenes", "extra scene", "scene renamed")
"""What no repair removes: nobody knows whose it is."""
PASSED = ("extra file in a scene", "extra view", "empty folder in a scene", "more scenes announced")
"""What plain continuing leaves as it is, or what asks for more scenes."""


@pytest.fixture(params=[2, 4])
def foreign(request: pytest.FixtureRequest, spheres_copy: Path) -> Path:
    """A dataset of another schema."""
    for path in (*spheres_copy.glob("scenes/*/scene.json"), spheres_copy / "dataset.json"):
        path.write_text(json.dumps(json.loads(path.read_text()) | {"schema_version": request.param}))
    return spheres_copy


@pytest.mark.parametrize(
    "words",
    [("dataset", "--out"), ("dataset", "--repair", "--scenes", "2", *SPHERES, "--out"), ("verify",), ("query",)],
)
def test_datasets_of_another_schema_are_refused_and_left_alone(
    foreign: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    before = contents(foreign)
    assert run(*words, foreign) == 1
    said = "".join(capsys.readouterr())
    assert "this program reads 3" in said
    assert contents(foreign) == before


@pytest.mark.parametrize("kind", QUICK)
def test_damage_is_found_by_a_quick_look_and_by_a_full_one(spheres_copy: Path, kind: str) -> None:
    damage, expected = QUICK[kind]
    damage(spheres_copy)
    for quick in (True, False):
        found = told(spheres_copy, quick=quick)
        assert any(re.search(expected, line) for line in found), found


@pytest.mark.parametrize("kind", FULL)
def test_damage_to_contents_is_found_by_a_full_look(spheres_copy: Path, kind: str) -> None:
    damage, expected = FULL[kind]
    damage(spheres_copy)
    assert told(spheres_copy, quick=True) == []
    found = told(spheres_copy)
    assert any(re.search(expected, line) for line in found), found


def test_a_flip_in_any_file_is_found(spheres_copy: Path) -> None:
    for name in sorted(contents(spheres_copy)):
        kept = (spheres_copy / name).read_bytes()
        flipped(name)(spheres_copy)
        assert told(spheres_copy), name
        (spheres_copy / name).write_bytes(kept)
    assert told(spheres_copy) == []


def test_a_quick_look_takes_milliseconds_a_scene(spheres_dataset: Path) -> None:
    told(spheres_dataset, quick=True)
    start = time.process_time()
    for _ in range(5):
        assert told(spheres_dataset, quick=True) == []
    assert (time.process_time() - start) / 10 < 0.05


@pytest.mark.parametrize("kind", ["record cut", "views missing", "scenes swapped", "view cut"])
def test_scenes_after_a_broken_one_are_checked(spheres_copy: Path, kind: str) -> None:
    QUICK[kind][0](spheres_copy)
    flipped("scenes/000000/views/00.exr")(spheres_copy)
    assert {line.split()[0] for line in told(spheres_copy)} >= {"0", "1"}


@pytest.mark.parametrize("where", ["memory", "http", "s3"])
def test_damage_is_found_at_an_address(spheres_copy: Path, where: str) -> None:
    kinds = ("view missing", "view cut", "preview flipped", "gain", "index row wrong", "dataset.json changed")
    for kind in kinds:
        root = spheres_copy.with_name(f"{where}-{kind.replace(' ', '-')}")
        shutil.copytree(spheres_copy, root)
        QUICK[kind][0](root)
        with contextlib.ExitStack() as stack:
            if where == "http":
                address = stack.enter_context(http_server(root))[0]
            else:
                address = stack.enter_context(in_memory(root) if where == "memory" else s3_server(root))
            found = told(address, quick=True)
            assert any(re.search(QUICK[kind][1], line) for line in found), (kind, found)


def test_json_is_all_that_is_printed(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("verify", spheres_copy, "--json", "--quick") == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown == {"written_by": shown["written_by"], "scenes": 2, "faults": []}
    assert shown["written_by"].startswith("schema 3, multilight ")
    QUICK["view missing"][0](spheres_copy)
    assert run("verify", spheres_copy, "--json") == 1
    faults = json.loads(capsys.readouterr().out)["faults"]
    assert [(fault["scene"], fault["view"], fault["check"]) for fault in faults] == [(1, 2, "files")]


def test_the_command_that_repairs_is_named(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.truncate(spheres_copy / S1 / "views/01.exr", 1000)
    command = f"multilight dataset --out {spheres_copy} --repair"
    assert run("verify", spheres_copy) == 1
    assert command in capsys.readouterr().out
    assert run("mix", spheres_copy, "--scene", 1, "--view", 1, "--out", spheres_copy / "x.png") == 1
    assert command in capsys.readouterr().err


@pytest.fixture
def in_one_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make scenes in this process: many repairs, each with workers of its own, would take minutes."""
    library = AssetLibrary()

    def make(work: Work, missing: tuple[int, ...], _: tuple[int, ...]) -> None:
        with AnalyticBackend() as backend:
            maker = SceneMaker(work.plan.config, work.renderer, work.plan.root, library, backend, 1)
            for index in missing:
                work.take(report_of(make_scene(maker, index), {}))

    monkeypatch.setattr("multilight.datagen.production.dataset.run_scenes", make)


def timed(root: Path) -> dict[str, int]:
    """Return when each view was written."""
    return {p.relative_to(root).as_posix(): p.stat().st_mtime_ns for p in root.rglob("*.exr")}


@pytest.mark.usefixtures("in_one_process")
@pytest.mark.parametrize("kind", [kind for kind in (*QUICK, *FULL) if kind not in (*WHOLE, "more scenes announced")])
def test_damage_is_repaired_to_equal_bytes(spheres_dataset: Path, spheres_copy: Path, kind: str) -> None:
    before = timed(spheres_copy)
    (QUICK | FULL)[kind][0](spheres_copy)
    assert run("dataset", "--out", spheres_copy, "--repair") == 0
    after = contents(spheres_copy)
    strays = {name for name in after if name not in contents(spheres_dataset)}
    assert bool(strays) == (kind in LEFT)
    assert {name: after[name] for name in after if name not in strays} == contents(spheres_dataset)
    if strays:
        assert told(spheres_copy, quick=True)
        return
    assert told(spheres_copy) == []
    kept = {name: when for name, when in timed(spheres_copy).items() if S0 in name}
    assert kept.items() <= before.items() or kind == "scenes swapped"


@pytest.mark.usefixtures("in_one_process")
@pytest.mark.parametrize("kind", [kind for kind in QUICK if kind not in (*WHOLE, *LEFT, *PASSED)])
def test_what_names_and_sizes_show_is_mended_in_passing(spheres_dataset: Path, spheres_copy: Path, kind: str) -> None:
    QUICK[kind][0](spheres_copy)
    assert run("dataset", "--out", spheres_copy) == 0
    assert contents(spheres_copy) == contents(spheres_dataset)


@pytest.mark.usefixtures("in_one_process")
@pytest.mark.parametrize("kind", WHOLE)
def test_a_damaged_dataset_json_is_written_anew_from_the_options(
    spheres_dataset: Path, spheres_copy: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    QUICK[kind][0](spheres_copy)
    damaged = contents(spheres_copy)
    for words, expected in (
        (("--scenes", 2, *SPHERES), "give --repair and the options"),
        (("--repair",), "its .* is .*, not"),
        (("--repair", "--scenes", 2, *SPHERES, "--seed", 5), "its seed is 0, not 5"),
        (("--repair", "--scenes", 2, *SPHERES, "--views", 4), "its views is 3, not 4"),
    ):
        assert run("dataset", "--out", spheres_copy, *words) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert re.search(expected, error), error
        assert contents(spheres_copy) == damaged
    assert run("dataset", "--out", spheres_copy, "--repair", "--scenes", 2, *SPHERES) == 0
    assert contents(spheres_copy) == contents(spheres_dataset)


@pytest.mark.usefixtures("in_one_process")
def test_further_scenes_need_no_other_flags(spheres_copy: Path, tmp_path: Path) -> None:
    assert run("dataset", "--out", spheres_copy, "--scenes", 3) == 0
    assert run("dataset", "--out", tmp_path / "whole", "--scenes", 3, *SPHERES) == 0
    assert contents(spheres_copy) == contents(tmp_path / "whole")


def unfinished(root: Path) -> None:
    """Bring a dataset to where it is when the last scene has its name, and no more was done."""
    (root / "index.parquet").unlink()
    rewrite_json(root / "dataset.json", lambda record: record.update(index_sha256="", index_rows=0, assets=[]))


def half_finished(root: Path) -> None:
    """Bring it to where the index is written, `dataset.json` not."""
    rewrite_json(root / "dataset.json", lambda record: record.update(index_sha256="", index_rows=0, assets=[]))


def grown(root: Path) -> None:
    """Bring it to where a scene was added after it had been finished, and no more was done."""
    aside = root.with_name("aside")
    (root / S1).rename(aside)
    chain(root)
    aside.rename(root / S1)


@pytest.mark.parametrize("state", [unfinished, half_finished, grown])
@pytest.mark.parametrize("command", ["dataset", "dataset --repair", "scene --index 1"])
def test_finishing_is_part_of_the_work(
    spheres_dataset: Path, spheres_copy: Path, state: Callable[[Path], None], command: str
) -> None:
    state(spheres_copy)
    assert told(spheres_copy, quick=True)
    assert open_dataset(spheres_copy).indices == (0, 1)
    name, *words = command.split()
    assert run(name, "--out", spheres_copy, *words) == 0
    assert contents(spheres_copy) == contents(spheres_dataset)


@pytest.mark.parametrize("delay", [0.0, 0.03])
def test_a_kill_after_the_last_scene(spheres_dataset: Path, tmp_path: Path, delay: float) -> None:
    root = tmp_path / "killed"
    command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), "--scenes", "2", *SPHERES]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not all((root / name).exists() for name in (S0, S1)):
        assert process.poll() is None
        time.sleep(0.002)
    time.sleep(delay)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert open_dataset(root).indices == (0, 1)
    assert run("dataset", "--out", root) == 0
    assert contents(root) == contents(spheres_dataset)


@pytest.mark.usefixtures("in_one_process")
def test_a_scene_that_comes_out_otherwise_is_told(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite_json(spheres_copy / S1 / "scene.json", lambda record: record.update(attempt=2))
    chain(spheres_copy)
    assert told(spheres_copy) == []
    os.truncate(spheres_copy / S1 / "views/01.exr", 1000)
    assert run("dataset", "--out", spheres_copy) == 0
    assert "scene 1 is not what it was" in capsys.readouterr().err
    assert told(spheres_copy) == []


@pytest.mark.usefixtures("in_one_process")
def test_other_makers_are_told(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scenes that are drawn from other packs, or made by other versions, would come out otherwise."""

    def by_others(record: Json) -> None:
        assert record["versions"]["processor"].startswith(platform.machine())
        record["versions"].update(numpy="0.1", processor="x86_64 avx9")

    rewrite_json(spheres_copy / "dataset.json", by_others)
    os.truncate(spheres_copy / S1 / "views/01.exr", 1000)
    assert run("dataset", "--out", spheres_copy) == 0
    error = capsys.readouterr().err
    assert "was made with numpy 0.1, now" in error
    assert "processor x86_64 avx9, now" in error
    assert "scene 1 is damaged and made anew: views/01.exr is truncated" in error
    rewrite_json(spheres_copy / "dataset.json", lambda record: record.update(assets=[CREDIT]))
    os.truncate(spheres_copy / S1 / "views/01.exr", 1000)
    assert run("dataset", "--out", spheres_copy) == 1
    error = capsys.readouterr().err
    assert "with the pack 'a', which is not there" in error
    assert "--assets" in error


def test_a_packed_copy_is_not_continued(spheres_dataset: Path, tmp_path: Path) -> None:
    packed = tmp_path / "packed"
    assert run("pack", spheres_dataset, "--out", packed) == 0
    before = contents(packed)
    assert run("dataset", "--out", packed, "--repair") == 1
    assert contents(packed) == before


def record_of(root: Path) -> SceneRecord:
    return read_scene(root / S0)


def larger(record: SceneRecord) -> SceneRecord:
    """The record of pictures twice as wide, all of it in agreement."""
    cameras = tuple(camera.model_copy(update={"width": 2 * camera.width}) for camera in record.scene.cameras)
    scene = record.scene.model_copy(update={"cameras": cameras})
    views = tuple(view.model_copy(update={"width": 2 * view.width}) for view in record.views)
    return record.model_copy(update={"scene": scene, "scene_sha256": scene.sha256(), "views": views})


WRONG: dict[str, tuple[Callable[[Json], object], str]] = {
    "unknown light": (lambda r: r["conditions"][0]["gains"].update(moon=[1, 1, 1]), "names the light 'moon'"),
    "EV 5000": (lambda r: r["conditions"][0].update(exposure_ev=5000), r"conditions\.0\.exposure_ev"),
    "no conditions": (lambda r: r.update(conditions=[]), "it has 0 conditions"),
    "no views": (lambda r: r.update(views=[]), "0 views"),
    "a view more": (lambda r: r["views"].append(r["views"][0]), "4 views and 3 cameras"),
    "a view less": (lambda r: r["views"].pop(), "2 views and 3 cameras"),
    "views in another order": (lambda r: r["views"].reverse(), "view 0 is 'views/02.exr'"),
    "another size": (lambda r: r["views"][1].update(width=65), "view 1 is 65 x 48, its camera 64 x 48"),
    "a size of billions": (lambda r: r["views"][1].update(width=4 * 10**9), r"views\.1\.width"),
    "no size": (lambda r: r["views"][1].update(height=0), r"views\.1\.height"),
    "another K": (lambda r: r["views"][1]["K"][0].__setitem__(0, 1.0), "view 1 states another K or c2w"),
    "another c2w": (lambda r: r["views"][1]["c2w"][0].__setitem__(3, 9.0), "view 1 states another K or c2w"),
    "energy of no light": (lambda r: r["views"][0]["energy"]["all"].clear(), "view 0 states the energy of other"),
    "another index inside": (lambda r: r.update(index=1), "is the record of scene 1"),
    "NaN": (lambda r: r["views"][0].update(additivity=float("nan")), "damaged"),
    "a name of two words": (lambda r: r["rig"]["lights"][0].update(name="../sun"), r"rig\.lights\.0"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_records_that_contradict_themselves_are_one_line_each(
    spheres_copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    change, expected = WRONG[kind]
    rewrite_json(spheres_copy / S0 / "scene.json", change)
    flipped(f"{S1}/views/01.exr")(spheres_copy)
    found = told(spheres_copy)
    assert [line.split()[:2] for line in found if not line.startswith("None")] == [["0", "None"], ["1", "1"]]
    assert re.search(expected, found[0]), found
    with pytest.raises(StoreError, match=expected):
        open_dataset(spheres_copy).scene(0)
    assert run("sheet", spheres_copy, "--out", tmp_path / "sheet.png") == 1
    assert capsys.readouterr().err.count("\n") == 1
    skipping = ("--on-broken", "skip", "--out", tmp_path / "out", "--conditions", 1, "--where", "index = 0")
    run("export", "nerfstudio", spheres_copy, *skipping)
    assert "passed over 1 of 1 scenes" in capsys.readouterr().out


def test_views_are_of_the_size_that_their_record_states(spheres_copy: Path) -> None:
    write_text(spheres_copy / S0 / "scene.json", larger(record_of(spheres_copy)).sealed().model_dump_json())
    with pytest.raises(StoreError, match=r"is 64 x 48 pixels, scene\.json states 128 x 48"):
        read_view(spheres_copy / S0 / "views/00.exr", (record_of(spheres_copy), 0))


def test_a_picture_of_billions_of_pixels_is_not_decoded(spheres_copy: Path) -> None:
    path = spheres_copy / S0 / "views/00.exr"
    content = path.read_bytes()
    window = b"dataWindow\0box2i\0" + (16).to_bytes(4, "little")
    sizes = np.array([0, 0, 63, 47], "<i4").tobytes()
    assert window + sizes in content
    path.write_bytes(content.replace(window + sizes, window + np.array([0, 0, 60_000, 60_000], "<i4").tobytes()))
    with pytest.raises(StoreError, match=r"is 60001 x 60001 pixels, scene\.json states 64 x 48"):
        read_view(path, (record_of(spheres_copy), 0))


@pytest.mark.parametrize(
    ("lost", "expected"), [(True, "lacks the channel"), (False, "has a channel 'more.A' of nothing")]
)
def test_channels_are_those_of_the_record(spheres_copy: Path, lost: bool, expected: str) -> None:
    path = spheres_copy / S0 / "views/00.exr"
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    made = [OpenEXR.Part({}, {n: c.pixels for n, c in part.channels.items()}, part.name()) for part in parts]
    more = OpenEXR.Part({}, {"more.A": np.zeros((48, 64), np.float16)}, "more")
    OpenEXR.File(made[1:] if lost else [*made, more]).write(str(path))
    with pytest.raises(StoreError, match=expected):
        read_view(path, (record_of(spheres_copy), 0))


@pytest.mark.parametrize("name", [f"{S0}/scene.json", "dataset.json"])
def test_a_record_too_large_is_not_read(spheres_copy: Path, name: str) -> None:
    with (spheres_copy / name).open("ab") as file:
        file.truncate(1 << 31)
    assert any("bytes, at most" in line for line in told(spheres_copy, quick=True))


def test_a_record_of_many_views_is_refused_at_once(spheres_copy: Path) -> None:
    view = json.dumps({"file": "views/00.exr"})
    path = spheres_copy / S0 / "scene.json"
    path.write_text(path.read_text().replace('"views": [', '"views": [' + f"{view}," * 200_000))
    start = time.process_time()
    assert told(spheres_copy, quick=True)
    assert time.process_time() - start < 10


def test_an_index_that_unpacks_to_gigabytes_is_not_read(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = pl.DataFrame({"index": pl.zeros(1_000_001, dtype=pl.Int8, eager=True)})
    lists = pl.DataFrame({"index": [0], "lights": [[""] * 100_000]})
    monkeypatch.setattr("multilight.datagen.storage.parquet.MOST_VALUES", 1000)
    for table, expected in ((rows, "1000001 rows"), (lists, "1 rows, 100001 values")):
        with pytest.raises(StoreError, match=expected):
            parse_index(index_bytes(table), "index.parquet")


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_footer_is_said(spheres_copy: Path, seed: int) -> None:
    content = bytearray((spheres_copy / "index.parquet").read_bytes())
    rng = np.random.default_rng(seed)
    for place in rng.integers(len(content) - 800, len(content), 5):
        content[place] = rng.integers(256)
    with contextlib.suppress(StoreError):  # and nothing else
        parse_index(bytes(content), "index.parquet")
