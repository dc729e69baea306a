"""Scenes made by a real Ray cluster of several nodes on this machine, on loopback, of which one is killed meanwhile."""

import contextlib
import hashlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import RunStoppedError
from multilight.datagen.production.crew import Limits
from multilight.datagen.production.worker import WorkerSetup
from multilight.datagen.storage.store import read_dataset, scene_indices
from tests.conftest import SPHERES
from tests.datagen.servers import FaultyBucket
from tests.datagen.test_drivers import SETTINGS, contents, start
from tests.ray_nodes import RayNodes

pytest.importorskip("ray")


@pytest.fixture(scope="module")
def ray_nodes(s3_server: FaultyBucket) -> Iterator[RayNodes]:
    """A Ray cluster on loopback: a head that makes nothing itself, and two nodes that may write to the bucket."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in s3_server.environment.items():
            patch.setenv(name, value)
        # Ray's own switch for clusters that do not leave loopback, for all who join it.
        patch.setenv("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        patch.setattr("ray._private.ray_constants.ENABLE_RAY_CLUSTER", False)
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        with contextlib.closing(RayNodes()) as nodes:
            nodes.add()
            nodes.add()
            yield nodes


@pytest.mark.slow
def test_a_cluster_that_loses_a_node_and_gains_one_leaves_the_bytes_of_a_single_run(
    ray_nodes: RayNodes, tmp_path: Path
) -> None:
    root, words = tmp_path / "set", ("--scenes", "8", "--views", "4")
    run = start(root, *words, "--executor", "ray", "--address", ray_nodes.address)
    alone = ["dataset", "--out", str(tmp_path / "alone"), *SETTINGS, *words]
    while len(scene_indices(root)) < 3 or len(list((root / "work").iterdir())) < 2:
        assert run.poll() is None, run.communicate()
        time.sleep(0.02)
    ray_nodes.kill(0)
    ray_nodes.add()
    assert main(alone) == 0
    said, told = run.communicate(timeout=120)
    assert run.returncode == 0, told
    assert "all 8 scenes ok: 8 made" in said
    assert contents(root) == contents(tmp_path / "alone")


@pytest.mark.slow
def test_nodes_need_no_shared_folder_but_a_bucket(
    bucket: FaultyBucket, ray_nodes: RayNodes, spheres_dataset: Path
) -> None:
    words = ["--scenes", "2", *SPHERES, "--executor", "ray", "--address", ray_nodes.address]
    assert main(["dataset", "--out", "s3://bucket/set", *words]) == 0
    found = {name: hashlib.sha256(content).hexdigest() for name, content in bucket.contents("set").items()}
    assert found == contents(spheres_dataset)


def test_what_cannot_be_is_told(
    spheres_copy: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "")
    words = ["dataset", "--out", str(spheres_copy), "--scenes", "3", "--executor", "ray"]
    for address in ("127.0.0.1:1", "nonsense"):
        assert main([*words, "--address", address]) == 1
        assert f"error: no Ray cluster at {address} (" in capsys.readouterr().err
    from multilight.datagen.production.cluster import make_on_node

    setup = WorkerSetup(read_dataset(spheres_copy).config, "analytic", spheres_copy, (), 1, 0, "token")
    told = make_on_node(setup, Limits(1), 0, False)
    assert isinstance(told, RunStoppedError)
    assert "all nodes need that folder" in str(told)
