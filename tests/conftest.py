"""Shared fixtures: a small closed-form dataset that needs no renderer."""

import ctypes
import gc
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import fsspec
import pytest

from multilight.datagen.backends.machine.mitsuba_variant import choose_variant, prepare_environment
from multilight.datagen.cli import main
from multilight.datagen.report import silent
from multilight.datagen.storage.pack import pack_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, read_scene, read_view, scene_dir
from multilight.scenes.assets import mesh_memory
from tests.browsing import launched
from tests.datagen.servers import FaultyBucket, faulty_bucket

if TYPE_CHECKING:
    from multilight.model.captures.capture import Capture

if "PYTEST_XDIST_WORKER" in os.environ:  # each process has a core of its own
    os.environ.setdefault("OMP_NUM_THREADS", "1")
mesh_memory.MOST_BYTES = 1 << 28  # many libraries live in a process of the tests
# Before any test imports Dr.Jit, which takes the first libLLVM it finds.
prepare_environment(choose_variant())

SPHERES = [
    "--renderer",
    "analytic",
    "--kind",
    "spheres",
    "--width",
    "64",
    "--height",
    "48",
    "--views",
    "3",
    "--spp",
    "4",
]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_cmdline_main() -> Iterator[None]:
    """End without Blender's own clean-up, which now and then waits for ever on its sound thread."""
    status = yield
    if "bpy" in sys.modules:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(int(status or 0))
    return status


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the files that take long, so that at the end none is left for one process alone."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="module", autouse=True)
def memory_given_back() -> Iterator[None]:
    """Give back after each file what renderers and the allocator keep for reuse: a process of the tests stays small."""
    yield
    gc.collect()
    if "drjit" in sys.modules:
        sys.modules["drjit"].flush_malloc_cache()
    ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Headless Chromium."""
    with launched() as browser:
        yield browser


@pytest.fixture(scope="session")
def spheres_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of two closed-form scenes; tests must not change it."""
    root = tmp_path_factory.mktemp("spheres") / "dataset"
    assert main(["dataset", "--out", str(root), "--scenes", "2", "--workers", "2", *SPHERES]) == 0
    return root


@pytest.fixture
def spheres_copy(spheres_dataset: Path, tmp_path: Path) -> Path:
    """A copy to damage."""
    return Path(shutil.copytree(spheres_dataset, tmp_path / "dataset"))


@pytest.fixture(scope="session")
def sphere_view(spheres_dataset: Path) -> tuple[SceneRecord, ViewData]:
    """One stored view and its scene's record."""
    folder = scene_dir(spheres_dataset, 0)
    record = read_scene(folder)
    return record, read_view(folder / record.views[0].file)


@pytest.fixture(scope="session")
def capture_folders(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The first closed-form scene as others' captures, by layout; tests must not change them."""
    found = {}
    for kind in ("nerfstudio", "colmap"):
        out = tmp_path_factory.mktemp(kind)
        words = ["export", kind, str(spheres_dataset), "--out", str(out), "--conditions", "1", "--points", "500"]
        assert main([*words, "--where", "index = 0"]) == 0
        found[kind] = next((out / "scene_000000").iterdir())
    return found


@pytest.fixture(scope="session")
def capture(capture_folders: dict[str, Path]) -> "Capture":
    """The nerfstudio capture, read."""
    from multilight.model.captures.read import read_capture  # torch is an extra

    return read_capture(capture_folders["nerfstudio"])


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MULTILIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def packed(spheres_dataset: Path, own_cache: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The packed copy of the closed-form dataset, and a cache of the tests' own."""
    out = tmp_path_factory.mktemp("packed") / "copy"
    pack_dataset(str(spheres_dataset), out, workers=1, report=silent)
    return out


@pytest.fixture(scope="module")
def s3_server() -> Iterator[FaultyBucket]:
    with faulty_bucket() as found:
        yield found


@pytest.fixture
def bucket(s3_server: FaultyBucket, monkeypatch: pytest.MonkeyPatch) -> Iterator[FaultyBucket]:
    """A bucket, so far empty, and the environment in which `s3://bucket` means it."""
    for name, value in s3_server.environment.items():
        monkeypatch.setenv(name, value)
    fsspec.config.conf.clear()
    fsspec.config.set_conf_env(fsspec.config.conf)
    yield s3_server
    s3_server.clear()
    fsspec.config.conf.clear()
