"""The commands and the code in the documents run as they are printed, one after the other, in an empty folder.

Only sizes are others: datasets are of closed-form spheres, and trainings take no minutes.
"""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from multilight.datagen.cli import COMMANDS as MAKING
from multilight.datagen.cli import main
from multilight.datagen.commands.arguments import parsed
from multilight.model.cli import COMMANDS as LEARNING
from multilight.model.data import MultiLightDataset
from tests import ROOT
from tests.conftest import SPHERES
from tests.model.test_harmonize import depth_onnx
from tests.scenes.custom_scenes import room
from tests.test_documents import blocks, printed

PAGES = (
    "tutorial", "making", "own_models", "own_rooms", "own_settings", "dataset", "viewing", "exports", "training",
    "scale_out", "published_layout", "write_an_export", "model",
)  # fmt: skip
SIZES = {
    "dataset": [*SPHERES, "--views", "4", "--scenes", "3", "--config", "demo.toml"],
    "plan": [*SPHERES, "--scenes", "3", "--minutes", "0.01"],
    "train": ["--minutes", "0.001"],
    "evaluate": ["--size", "32", "--groups", "1", "--splits", "train"],
    "insert": ["--side", "16"],
    "export dtc-multilight": ["--size", "32", "--map-size", "16"],
}
"""What a command is given besides, so that it takes seconds."""
INSIDE = ["--scenes", "1", "--views", "1", "--width", "32", "--height", "32", "--spp", "1"]
"""What scenes in a file of one's own are given, which need a renderer."""
SPLITS = "kind = 'spheres'\nood_kinds = []\nsplits = {train = 0.5, val = 0.2, test = 0.2, test_ood = 0.1}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, capture_folders: dict[str, Path]) -> Path:
    """An empty folder, but for the set that `make dataset` makes and the files of one's own that are named."""
    here = tmp_path_factory.mktemp("documents")
    (here / "demo.toml").write_text(SPLITS)
    made = ["dataset", "--out", str(here / "out" / "dataset"), *SPHERES, "--views", "4", "--scenes", "8"]
    assert main([*made, "--config", str(here / "demo.toml"), "--seed", "275"]) == 0
    shutil.copytree(capture_folders["nerfstudio"], here / "CAPTURE")
    rng = np.random.default_rng(0)
    for name, mode in {"a": "RGB", "b": "RGB", "m": "L"}.items():
        values = rng.integers(0, 255, (48, 64, 3) if mode == "RGB" else (48, 64), np.uint8)
        Image.fromarray(values, mode).save(here / f"{name}.png")
    for name in ("OURS", "THEIRS", "COMPOSITES"):
        (here / name).mkdir()
        shutil.copy(here / "a.png", here / name)
    (here / "mine").mkdir()
    for place in (here, here / "mine"):
        trimesh.creation.icosphere(radius=0.1).export(place / "vase.glb")
    room().export(here / "room.glb")
    depth_onnx(here / "depth_anything_v2.onnx")
    return here


def as_spheres(text: str) -> str:
    return text.replace("'room'", "'spheres'").replace("plant", "sphere_0")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_commands_run_as_printed(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "mine.toml").write_text(blocks(ROOT / "docs" / "own_settings.md", "toml")[0])
    (folder / "published.toml").write_text(blocks(ROOT / "docs" / "published_layout.md", "toml")[0])
    for program, *words in printed(ROOT / "docs" / f"{page}.md"):
        assert program == "multilight", words
        words = [as_spheres(word) for word in words]
        if words[0] == "view":  # which serves until it is stopped: tests/datagen/test_view.py
            continue
        given = INSIDE if "custom" in words else SIZES.get(words[0], SIZES.get(" ".join(words[:2]), []))
        code = main([*words, *given], MAKING | LEARNING)
        # Spheres do not glow: a look-up may find none.
        assert code == 0 or (code == 1 and words[0] == "query"), words


@pytest.mark.slow
def test_long_trainings_pass_their_own_checks(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    lines = [words[1:] for words in printed(ROOT / "docs" / "measurements.md") if words[:2] == ["multilight", "ablate"]]
    assert len(lines) == 7
    for words in lines:
        parsed([re.sub(r"(training|volume)-packed", "dataset", word) for word in words], LEARNING).check()


@pytest.mark.slow
def test_code_runs_as_printed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    pictures = {name: np.asarray(Image.open(f"{name}.png")) for name in "abm"}
    names: dict[str, object] = {
        "composite": pictures["a"], "background": pictures["b"], "mask": pictures["m"] / 255.0,
        "depth": np.full((48, 64), 0.5, np.float32),
    }  # fmt: skip
    ran = 0
    for page in PAGES:
        for code in blocks(ROOT / "docs" / f"{page}.md", "python"):
            if "import multilight" in code or "from multilight" in code:
                code = re.sub(r"emissive or mirror", "objects > 0", as_spheres(code))
                exec(compile(re.sub("out/(packed|first)", "out/dataset", code), f"{page}.md", "exec"), names)
                ran += 1
    assert ran == 5
    assert isinstance(names["data"], MultiLightDataset)
