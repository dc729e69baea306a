"""The main path with Cycles on a real scene: one small dataset, its identities read back by OpenEXR alone."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import trimesh

from multilight.datagen.cli import main
from multilight.datagen.storage.store import file_sha256, scene_dir, scene_indices

pytestmark = pytest.mark.slow

TINY = ["--preset", "smoke", "--width", "96", "--height", "72", "--views", "2", "--spp", "4", "--seed", "5"]
Channels = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("cycles") / "dataset"
    assert main(["dataset", "--out", str(root), "--scenes", "1", "--renderer", "cycles", *TINY]) == 0
    return root


def views(root: Path) -> list[tuple[dict, Channels]]:
    """Read every view with nothing but JSON and OpenEXR."""
    found = []
    for index in scene_indices(root):
        record = json.loads((scene_dir(root, index) / "scene.json").read_text())
        for view in record["views"]:
            parts = OpenEXR.File(str(scene_dir(root, index) / view["file"]), separate_channels=True).parts
            found.append((record, {n: c.pixels.astype("f4") for part in parts for n, c in part.channels.items()}))
    return found


def rgb(channels: Channels, prefix: str) -> np.ndarray:
    return np.stack([channels[f"{prefix}.{c}"] for c in "RGB"], axis=-1)


def lit(channels: Channels, variant: str, condition: dict) -> np.ndarray:
    layers = [np.array(gain) * rgb(channels, f"{variant}.{light}") for light, gain in condition["gains"].items()]
    return 2.0 ** condition["exposure_ev"] * np.sum(layers, axis=0)


def insertable(record: dict) -> list[str]:
    return [body["name"] for body in record["scene"]["bodies"] if body["insertable"]]


def test_verify_agrees(dataset: Path) -> None:
    assert main(["verify", str(dataset)]) == 0


def test_layers_sum_to_the_renderers_own_picture(dataset: Path) -> None:
    for record, channels in views(dataset):
        total = np.sum([rgb(channels, f"all.{light['name']}") for light in record["rig"]["lights"]], axis=0)
        combined = rgb(channels, "combined")
        assert total.mean() == pytest.approx(combined.mean(), rel=0.3)
        blocks = [a[:72, :96].reshape(3, 24, 4, 24, 3).mean(axis=(1, 3)) for a in (total, combined)]
        off = np.abs(blocks[0] - blocks[1]) > 0.5 * blocks[1] + 0.1 * combined.mean()
        assert off.mean() < 0.05  # four samples may find a highlight in a block that the denoiser takes for noise
        assert all(view["additivity"] < 1e-4 for view in record["views"])


def test_composite_identities(dataset: Path) -> None:
    for record, channels in views(dataset):
        condition = record["conditions"][-1]
        target = lit(channels, "all", condition)
        for name in insertable(record):
            alpha = channels[f"coverage_{name}.A"][..., None]
            background = lit(channels, f"without_{name}", condition)
            composite = lit(channels, f"foreground_{name}", condition) + (1 - alpha) * background
            inside, outside = alpha[..., 0] >= 1, alpha[..., 0] <= 0
            np.testing.assert_array_equal(composite[outside], background[outside])
            np.testing.assert_allclose(composite[inside], target[inside], rtol=1e-5)
            edge = ~inside & ~outside
            assert (composite[edge] >= (1 - alpha)[edge] * background[edge] - 1e-6).all()


def test_masks_are_disjoint_and_ids_whole(dataset: Path) -> None:
    for record, channels in views(dataset):
        ids = channels["instance_id.ID"]
        assert set(np.unique(ids)) <= set(range(len(record["scene"]["bodies"]) + 1))
        covered = sum((channels[f"coverage_{name}.A"] for name in insertable(record)), channels["environment.A"])
        assert covered.max() <= 1.02


def test_effect_is_zero_far_from_a_small_object(dataset: Path) -> None:
    """Common random numbers: somewhere in every view no path knows of the object."""
    shares = []
    for record, channels in views(dataset):
        for name in insertable(record):
            for light in record["rig"]["lights"]:
                if light["kind"] == "emissive":
                    continue
                change = rgb(channels, f"all.{light['name']}") - rgb(channels, f"without_{name}.{light['name']}")
                shares.append((change == 0).all(axis=-1).mean())
    assert np.median(shares) > 0.2


def test_credits_name_creator_and_licence(dataset: Path) -> None:
    record = json.loads((dataset / "dataset.json").read_text())
    assert len(record["assets"]) >= 8
    assert all(asset["licence"] and asset["creator"] for asset in record["assets"])
    assert record["versions"]["bpy"]


def test_a_kill_threads_and_workers_change_no_byte(dataset: Path, tmp_path: Path) -> None:
    """The dataset was made by workers of one thread each; a scene that is made after a kill, alone, takes all cores."""
    root = tmp_path / "killed"
    shutil.copytree(dataset, root)
    shutil.rmtree(scene_dir(root, 0))
    command = [sys.executable, "-m", "multilight", "dataset", "--out", str(root), "--scenes", "1"]
    command += ["--renderer", "cycles", "--workers", "1", *TINY]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    while not list((root / "work").glob("000000-*/views/00.exr")):
        assert process.poll() is None
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert scene_indices(root) == []
    assert main(["dataset", "--out", str(root), "--scenes", "1", "--renderer", "cycles", *TINY]) == 0
    for file in ("scene.json", "views/00.exr", "views/01.exr", "preview.png"):
        assert file_sha256(scene_dir(root, 0) / file) == file_sha256(scene_dir(dataset, 0) / file), file


def test_a_broken_model_is_named_and_passed_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    (folder / "broken.glb").write_bytes(b"glTF but not really")
    trimesh.creation.cylinder(radius=0.05, height=0.2).export(folder / "can.glb")
    assert main(["assets", "check", str(folder)]) == 1
    shown = capsys.readouterr().out
    assert "broken.glb" in shown
    assert "2 assets, 1 broken" in shown
    size = ["--width", "32", "--height", "24", "--views", "1", "--spp", "1"]  # by whichever renderer is there
    assert main(["scene", "--out", str(tmp_path / "d"), *size, "--assets", str(folder)]) == 0
    errors = capsys.readouterr().err
    assert "passed over 1 broken assets" in errors
    assert "broken.glb" in errors
