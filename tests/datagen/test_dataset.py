"""Production: same seed same bytes, resuming, kills, full and unwritable outputs, refusals."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.backends.protocol import Backend, RenderJob
from multilight.datagen.cli import main
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.scene import SceneMaker, make_scene
from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.storage.records import DatasetRecord, record_hash
from multilight.datagen.storage.store import file_sha256, read_scene, scene_dir, scene_indices
from multilight.datagen.verification.views import verify_views
from multilight.scenes.assets.library import AssetLibrary
from tests.conftest import SPHERES


def run(*words: object) -> int:
    return main([str(word) for word in words])


def contents(root: Path) -> dict[str, str]:
    """Hash every file that belongs to the data."""
    files = [p for p in root.rglob("*") if p.is_file() and p.name != ".lock"]
    return {p.relative_to(root).as_posix(): file_sha256(p) for p in files}


def start(root: Path, *words: str) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), *SPHERES, *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def wait_for(condition: object, seconds: float = 180.0) -> None:
    assert callable(condition)
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def test_worker_count_and_order_change_nothing(spheres_dataset: Path, tmp_path: Path) -> None:
    root = tmp_path / "other"
    assert run("scene", "--out", root, "--index", 1, *SPHERES) == 0
    assert scene_indices(root) == [1]
    assert run("dataset", "--out", root, "--scenes", 2, "--workers", 1, *SPHERES) == 0
    assert contents(root) == contents(spheres_dataset)


def test_another_seed_is_another_scene(spheres_dataset: Path, tmp_path: Path) -> None:
    assert run("scene", "--out", tmp_path / "d", "--seed", 1, *SPHERES) == 0
    one, other = (json.loads((scene_dir(d, 0) / "scene.json").read_text()) for d in (spheres_dataset, tmp_path / "d"))
    assert one["scene_sha256"] != other["scene_sha256"]
    assert one["rig_sha256"] != other["rig_sha256"]


def test_a_second_call_finds_nothing_to_do(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(spheres_copy)
    assert run("dataset", "--out", spheres_copy, "--scenes", 2, *SPHERES) == 0
    assert "nothing to do" in capsys.readouterr().out
    assert contents(spheres_copy) == before


def test_index_has_a_row_a_scene(spheres_dataset: Path) -> None:
    table = pl.read_parquet(spheres_dataset / "index.parquet")
    assert table["index"].to_list() == [0, 1]
    assert set(table["kind"]) == {"spheres"}
    for row in table.iter_rows(named=True):
        assert row["bytes"] == sum(p.stat().st_size for p in scene_dir(spheres_dataset, row["index"]).rglob("*.exr"))


def test_kill_loses_at_most_the_scenes_in_work(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    words = ("--scenes", "6", "--workers", "2")
    process = start(killed, *words)
    wait_for(lambda: scene_indices(killed) and any((killed / "work").glob("*/views/*.exr")))
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    wait_for(lambda: not orphans(killed))  # they may still write, and finish a scene, for half a second
    assert 0 < len(scene_indices(killed)) < 6
    kept = {name: digest for name, digest in contents(killed).items() if name.startswith("scenes/")}
    assert run("dataset", "--out", killed, *words, *SPHERES) == 0
    assert run("dataset", "--out", whole, *words, *SPHERES) == 0
    assert contents(killed) == contents(whole)
    assert kept.items() <= contents(killed).items()


def orphans(root: Path) -> list[str]:
    """List worker processes that still run for a dataset's folder."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                open_files = [os.readlink(p) for p in (entry / "fd").iterdir()]
            except OSError:
                continue
            found += [entry.name for name in open_files if name.startswith(str(root))]
    return found


def test_the_scene_of_a_worker_that_dies_is_tried_again(tmp_path: Path) -> None:
    root = tmp_path / "d"
    words = ("--scenes", "3", "--views", "8")  # so long that the scene is still in work when its worker is killed
    process = start(root, *words, "--workers", "1")
    wait_for(lambda: list((root / "work").glob("000001-*")))
    worker = int(next((root / "work").glob("000001-*")).name.split("-")[1])
    os.kill(worker, signal.SIGKILL)
    assert process.wait(timeout=300) == 0
    assert scene_indices(root) == [0, 1, 2]
    assert not (root / "logs").exists()


class FaultyAtFirst:
    """The closed-form renderer, but its first scene loses light in the second view."""

    name = "analytic"

    def __init__(self, real: Backend) -> None:
        self.real, self.jobs = real, list[RenderJob]()

    def render(self, job: RenderJob) -> LayerStack:
        self.jobs.append(job)
        stack = self.real.render(job)
        if job.scene == self.jobs[0].scene and job.view == 1:
            return dataclasses.replace(stack, radiance=stack.radiance * np.float32(0.5))
        return stack


def test_a_draw_is_thrown_away_at_its_first_bad_view(tmp_path: Path) -> None:
    config = DatasetConfig(renderer="analytic", kind="spheres", width=64, height=48, views=3, spp=4)
    with AnalyticBackend() as real:
        backend = FaultyAtFirst(real)
        made = make_scene(SceneMaker(config, "analytic", tmp_path, AssetLibrary(), backend, 1), 0)
    first = [job.view for job in backend.jobs if job.scene == backend.jobs[0].scene]
    assert set(first) == {0, 1}
    folder = scene_dir(tmp_path, 0)
    record = read_scene(folder)
    assert record.attempt == len(record.thrown_away) >= 1
    assert made.record == record
    assert record.thrown_away[0].startswith("additivity: view 1: ")
    assert verify_views(record, lambda name: nullcontext(folder / name)) == []
    assert set(made.seconds) == {"draw", "contacts", "render", "write", "verify", "rest"}
    assert not list((tmp_path / "work").iterdir())


@pytest.mark.parametrize(
    ("denoise", "spp", "expected"), [("auto", 8, True), ("auto", 4096, False), ("on", 4096, True), ("off", 8, False)]
)
def test_denoising_is_automatic_on_or_off(denoise: str, spp: int, expected: bool) -> None:
    config = DatasetConfig.model_validate({"denoise": denoise, "spp": spp})
    with AnalyticBackend() as backend:
        assert SceneMaker(config, "cycles", Path(), AssetLibrary(), backend, 1).denoises == expected
        assert not SceneMaker(config, "analytic", Path(), AssetLibrary(), backend, 1).denoises


def test_the_last_line_says_how_it_went(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("scene", "--out", tmp_path / "d", *SPHERES) == 0
    (said,) = capsys.readouterr().out.splitlines()
    said = said.removeprefix(f"{tmp_path / 'd'}: scene ok: 1 made, 0 kept; 3 views, ")
    stages = ", ".join(rf"{stage} \d+%" for stage in ("draw", "contacts", "render", "write", "verify", "rest"))
    assert re.fullmatch(rf"\d+ kB; \d+ s \({stages}\)", said)


def test_all_that_differs_is_named(spheres_copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("dataset", "--out", spheres_copy, "--width", "32", "--seed", "5", "--views", "3") == 1
    said = capsys.readouterr().err
    assert "was made with seed = 0, not 5, width = 64, not 32; leave that away" in said


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--seed", "5"), "seed = 0, not 5"),
        (("--width", "80"), "width = 64, not 80"),
        (("--spp", "7"), "spp = 4, not 7"),
    ],
)
def test_continuing_with_other_values_is_refused(
    spheres_dataset: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], expected: str
) -> None:
    assert run("dataset", "--out", spheres_dataset, "--scenes", 3, *SPHERES, *words) == 1
    assert expected in capsys.readouterr().err


def test_continuing_with_another_renderer_is_refused(spheres_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["cycles" if word == "analytic" else word for word in SPHERES]
    assert run("dataset", "--out", spheres_dataset, "--scenes", 2, *options) == 1
    errors = capsys.readouterr().err
    assert "'analytic'" in errors
    assert "'cycles'" in errors


def test_a_folder_with_other_files_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    assert run("dataset", "--out", tmp_path, *SPHERES) == 1
    assert "holds other files" in capsys.readouterr().err


def test_unwritable_output(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("dataset", "--out", "/proc/nowhere", *SPHERES) == 1
    assert "/proc/nowhere cannot be written" in capsys.readouterr().err


@pytest.fixture
def small_disk(tmp_path: Path) -> Path:
    """A file system of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)], capture_output=True)
    if mounted.returncode:
        pytest.skip("a full disk needs a small file system, and mounting one needs root")
    return folder


def test_full_disk_is_said_and_finished_scenes_stay(small_disk: Path) -> None:
    try:
        root = small_disk / "d"
        command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), *SPHERES, "--scenes", "40"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=240)
        assert done.returncode == 1
        assert "no space left" in done.stderr
        assert "Traceback" not in done.stderr
        assert scene_indices(root)
        assert not (root / "work").exists() or not list((root / "work").rglob("*.exr"))
        check = subprocess.run([sys.executable, "-m", "multilight", "verify", "--json", str(root)], capture_output=True)
        assert check.returncode == 1
        found = json.loads(check.stdout)["faults"]
        told = f"{len(scene_indices(root))} of 40 scenes are there"
        assert [fault["message"].startswith(told) for fault in found if fault["check"] != "index"] == [True]
    finally:
        subprocess.run(["umount", "-l", str(small_disk)], check=True)


def test_continuing_with_mitsubas_former_scalar_variant_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "d"
    root.mkdir()
    config = DatasetConfig(renderer="mitsuba")
    for variant, told in (("scalar_rgb", True), ("llvm_ad_rgb", False)):
        record = DatasetRecord(config=config, renderer="mitsuba", variant=variant, versions={}).sealed()
        (root / "dataset.json").write_text(record.model_dump_json())
        assert run("dataset", "--out", root, "--renderer", "mitsuba", "--width", 32) == 1
        assert ("'scalar_rgb'" in capsys.readouterr().err) == told


def test_lights_were_wild_before_configurations_said_so() -> None:
    record = DatasetRecord(config=DatasetConfig(), renderer="mitsuba", versions={}).model_dump(mode="json")
    del record["config"]["wild"]
    record["record_sha256"] = record_hash(record)
    assert DatasetRecord.from_json(json.dumps(record)).config.wild
    assert not DatasetConfig().wild
