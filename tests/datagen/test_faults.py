"""A short run of `tests/datagen/faults.py` with fixed seeds: damage x commands, a kill, a full disk, closed streams."""

import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from multilight.scenes.assets.cache import tell_thrown_away
from tests.datagen import driver_faults, faults
from tests.datagen.faults import DAMAGES, DATASET_FILES, Bench, bad


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    yield Bench(tmp_path_factory.mktemp("faults"), ("pack", "nerfstudio"))
    tell_thrown_away()


@pytest.mark.parametrize("name", DATASET_FILES)
def test_damage_in_a_dataset_is_found_or_refused_or_harmless(bench: Bench, name: str) -> None:
    quick = ("verify", "verify --quick", "query", "mix", "pack")
    assert bad([bench.dataset_row(name, damage, "7", quick) for damage in DAMAGES]) == []


@pytest.mark.parametrize(("name", "damage"), [("scenes/000000/views/00.exr", "flip"), ("index.parquet", "cut")])
def test_damage_in_a_dataset_is_repaired_to_the_same_bytes(bench: Bench, name: str, damage: str) -> None:
    assert bench.dataset_row(name, damage, "7", ("dataset --repair",)).cells == {"dataset --repair": "repaired"}


@pytest.mark.parametrize("copy", ["pack", "nerfstudio"])
def test_damage_in_copies_and_exports_is_found_and_made_anew(bench: Bench, copy: str) -> None:
    names = faults.copy_files(bench.copies[copy])
    assert len(names) > 3
    assert bad([bench.copy_row(copy, name, damage, "7") for name in names for damage in DAMAGES]) == []


def test_a_killed_run_is_continued_to_the_same_bytes(bench: Bench) -> None:
    assert faults.killed(bench, signal.SIGKILL, True, random.Random(7)) == "repaired"


def test_a_full_disk_is_one_line(bench: Bench) -> None:
    assert faults.full_disk(bench, "pack", 60) in ("repaired", "refused")


def test_the_bench_tells_silence_from_refusal() -> None:
    good = faults.Ran(0, "", {"a": "1"})
    assert faults.judge_reader(faults.Ran(0, "", {"a": "2"}), good) == "SILENT"
    assert faults.judge_reader(faults.Ran(0, "index made up\n", {"a": "1"}), good) == "rebuilt"
    assert faults.judge_reader(faults.Ran(1, "error: a\n", {}), good) == "refused"
    assert faults.judge_reader(faults.Ran(1, "error: a\nerror: b\n", {}), good) == "MANY LINES"
    assert faults.judge_reader(faults.Ran(-1, "Traceback: ValueError\n", {}), good) == "TRACEBACK"
    assert faults.judge_verify(faults.Ran(0, "", {}), quick=True, same_size=False) == "MISSED"
    assert faults.judge_verify(faults.Ran(0, "", {}), quick=False, same_size=True) == "MISSED"


def test_drivers_that_are_killed_stopped_and_starved_leave_the_bytes_of_a_run_alone(tmp_path: Path) -> None:
    bench = driver_faults.disturbed(tmp_path, seed=7, kills=6, scenes=10)
    assert bench.wrong == []
    assert bench.done["killed"] >= 6
