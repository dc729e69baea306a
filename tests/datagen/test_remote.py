"""Datasets at any address: memory, a real HTTP server and a real S3 server."""

import multiprocessing
import pickle
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import fsspec
import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.store import ViewData
from tests.datagen.servers import http_server, in_memory, s3_server


@pytest.fixture(scope="module", params=["memory", "http", "s3"])
def address(request: pytest.FixtureRequest, spheres_dataset: Path) -> Iterator[str]:
    match request.param:
        case "memory":
            with in_memory(spheres_dataset, "kept") as found:
                yield found
        case "http":
            with http_server(spheres_dataset) as (found, _):
                yield found
        case _:
            with s3_server(spheres_dataset) as found:
                yield found


def same_view(one: ViewData, other: ViewData) -> None:
    assert one.lights == other.lights
    for variant, layers in one.variants.items():
        np.testing.assert_array_equal(layers, other.variants[variant])
    np.testing.assert_array_equal(one.geometry.z_depth, other.geometry.z_depth)


def test_a_remote_dataset_reads_as_the_folder(address: str, spheres_dataset: Path) -> None:
    there, here = open_dataset(address), open_dataset(spheres_dataset)
    assert there.table.equals(here.table)
    assert [r.canonical_json() for r in there.scenes()] == [r.canonical_json() for r in here.scenes()]
    record = here.scene(1)
    same_view(there.view(record, 2), here.view(record, 2))


def test_missing_things_are_named_by_their_address(address: str) -> None:
    with pytest.raises(StoreError, match=r"elsewhere/dataset\.json is missing"):
        open_dataset(f"{address}/elsewhere")
    source = open_dataset(address)
    with pytest.raises(StoreError, match=r"scenes/000007/scene\.json is missing") as caught:
        source.scene(7)
    assert address in str(caught.value)


def test_opening_fetches_no_scene_and_a_view_one_file(spheres_dataset: Path) -> None:
    with http_server(spheres_dataset) as (address, asked):
        source = open_dataset(address)
        assert asked == ["/dataset.json", "/index.parquet"]
        record = next(source.scenes())
        source.view(record, 1)
        assert asked[2:] == ["/scenes/000000/scene.json", "/scenes/000000/views/01.exr"]


def test_reading_writes_nothing(spheres_dataset: Path, tmp_path: Path) -> None:
    with in_memory(spheres_dataset) as address:
        memory = fsspec.filesystem("memory")
        before = {name: memory.cat_file(name) for name in memory.find("/sets")}
        source = open_dataset(address)
        for record in source.scenes():
            source.view(record, 0)
        assert {name: memory.cat_file(name) for name in memory.find("/sets")} == before


def read_in_child(source: DatasetSource, results: "multiprocessing.SimpleQueue[float]") -> None:
    results.put(float(source.view(source.scene(0), 0).combined.sum()))


def test_an_opened_source_works_in_other_processes(spheres_dataset: Path) -> None:
    with http_server(spheres_dataset) as (address, _):
        source = open_dataset(address)
        here = float(source.view(source.scene(0), 0).combined.sum())
        context = multiprocessing.get_context("spawn")
        results = context.SimpleQueue()
        child = context.Process(target=read_in_child, args=(source, results))
        child.start()
        child.join(60)
        assert child.exitcode == 0
        assert results.get() == here
        assert pickle.loads(pickle.dumps(source)).indices == source.indices


def test_an_opened_source_survives_a_fork(spheres_dataset: Path) -> None:
    """In a process of its own: forking this one, with all its libraries' threads, may hang."""
    code = (
        "import os, sys; from multilight.datagen.storage.open_dataset import open_dataset\n"
        "source = open_dataset(sys.argv[1]); here = float(source.view(source.scene(0), 0).combined.sum())\n"
        "if os.fork() == 0: os._exit(0 if float(source.view(source.scene(0), 0).combined.sum()) == here else 1)\n"
        "sys.exit(os.waitstatus_to_exitcode(os.wait()[1]))"
    )
    with http_server(spheres_dataset) as (address, _):
        subprocess.run([sys.executable, "-c", code, address], check=True, timeout=120)


def test_commands_take_addresses(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run(*words: str) -> int:
        return main([*words])

    with in_memory(spheres_dataset) as address:
        for name, place in (("here", str(spheres_dataset)), ("there", address)):
            assert run("mix", place, "--scene", "1", "--out", str(tmp_path / f"{name}.png")) == 0
            assert run("sheet", place, "--out", str(tmp_path / f"{name}-sheet.png")) == 0
        assert run("verify", address) == 0
        assert run("query", address, "index = 1") == 0
    for kind in ("", "-sheet"):
        here, there = (np.asarray(Image.open(tmp_path / f"{name}{kind}.png")) for name in ("here", "there"))
        np.testing.assert_array_equal(here, there)


@pytest.mark.parametrize("word", ["gopher://set", "nothing-like-this://x"])
def test_an_unknown_kind_of_address(word: str) -> None:
    with pytest.raises(UserError, match="cannot be opened"):
        open_dataset(word)


def test_nobody_answers() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{unused.getsockname()[1]}/set"
        with pytest.raises(StoreError, match=r"dataset\.json cannot be read"):
            open_dataset(address)
