"""A wheel, installed beside a project that has a model.py, a scenes.py and a lights/ of its own."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from PIL import Image

from tests import ROOT

SOURCES = ("multilight", "scenes", "lights", "datagen", "model", "pyproject.toml", "README.md", "LICENSE")
THEIRS = {"model.py": "ANSWER = 42\n", "scenes.py": "", "datagen.py": "", "lights/__init__.py": "ANSWER = 43\n"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a copy, since setuptools writes beside the sources."""
    folder = tmp_path_factory.mktemp("wheel")
    (folder / "sources").mkdir()
    for name in SOURCES:
        if (ROOT / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__")
            shutil.copytree(ROOT / name, folder / "sources" / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy(ROOT / name, folder / "sources")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    words = ["wheel", "--no-deps", "--no-build-isolation", "--no-index", "--wheel-dir", folder, folder / "sources"]
    subprocess.run([*pip, *map(str, words)], check=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_holds_one_package_and_every_source(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"multilight"}
    data = ("*.py", "*.csv", "*.toml", "*.safetensors", "*.html", "*.js", "*.css")
    for folder in ("scenes", "lights", "datagen", "model"):
        for pattern in data:
            for path in (ROOT / folder).rglob(pattern):
                assert f"multilight/{path.relative_to(ROOT)}" in names, path
    assert "multilight/py.typed" in names


def test_installed_beside_a_project_with_the_same_names(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    for name, text in THEIRS.items():
        (tmp_path / "project" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "project" / name).write_text(text)
    code = (
        "import model, lights, scenes, datagen\n"
        "from multilight.datagen.storage.open_dataset import open_dataset\n"
        "from multilight.model.data import MultiLightDataset\n"
        "import multilight\n"
        "print(model.ANSWER, lights.ANSWER, multilight.__file__)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed")}
    run = [sys.executable, "-c", code]
    said = subprocess.check_output(run, cwd=tmp_path / "project", env=environment, text=True)
    assert said.split() == ["42", "43", str(tmp_path / "installed" / "multilight" / "__init__.py")]
    run = [sys.executable, "-m", "multilight", "--help"]
    assert "harmonize" in subprocess.check_output(run, cwd=tmp_path / "project", env=environment, text=True)


MODULES = {
    "render": "trimesh embreex fcl igl mujoco pebble mitsuba_oidn drjit mitsuba pxr bpy",
    "train": "torch torchmetrics tensorboard flip_evaluator",
    "captures": "onnxruntime pycolmap imageio_ffmpeg",
    "remote": "s3fs aiohttp",
}
"""What each extra brings that the rest of the installation does without."""
WITHOUT_EXTRAS = """
import sys
from importlib.machinery import PathFinder
from multilight.datagen import cli as generator
from multilight.model import cli as learner
class Bare(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        return None if name.split(".")[0] in {missing!r} else super().find_spec(name, path, target)
sys.meta_path[sys.meta_path.index(PathFinder)] = Bare
for line in sys.stdin.read().splitlines():
    code = generator.main(line.split(), generator.COMMANDS | learner.COMMANDS)
    print(line.split()[0], code, file=sys.stderr)
"""


def test_commands_name_the_extra_that_they_lack(spheres_dataset: Path, tmp_path: Path) -> None:
    out = f"--out {tmp_path}"
    reading = (f"verify {spheres_dataset}", f"query {spheres_dataset}", f"mix {spheres_dataset} {out}/m.png")
    works = (
        *reading,
        f"sheet {spheres_dataset} {out}/s.png",
        f"pack {spheres_dataset} {out}/p",
        "config show",
        "train slim --show",
    )
    white = tmp_path / "white.png"
    Image.new("RGB", (32, 32), "white").save(white)
    training = tmp_path / "training.toml"
    training.write_text(f'steps = 1\nout = "o"\n[data]\nvalidation_samples = 0\ntrain = "{spheres_dataset}"\n')
    lacking = {
        f"dataset {out}/d": "render",
        f"scene {out}/d": "render",
        f"import usd {white} {out}/d": "render",
        f"export usd {spheres_dataset} {out}/u": "render",
        f"stats {spheres_dataset}": "render",
        "assets list": "render",
        f"train {training} {out}/t": "train",
        f"evaluate {spheres_dataset} --splits train {out}/e": "train",
        f"ablate head {spheres_dataset} --splits train {out}/a": "train",
        f"harmonize --composite {white} --background {white} --mask {white} {out}/h.png": "train",
        f"insert {spheres_dataset} --asset builtin/die-01 {out}/i": "captures",
        "verify s3://bucket/set": "remote",
    }
    code = WITHOUT_EXTRAS.format(missing=set(" ".join(MODULES.values()).split()))
    words = [sys.executable, "-c", code]
    text = "\n".join((*works, "doctor", *lacking))
    done = subprocess.run(words, input=text, capture_output=True, text=True, check=True, cwd=ROOT)
    codes = [line for line in done.stderr.splitlines() if re.fullmatch(r"\w+ \d", line)]
    assert codes == [f"{line.split()[0]} 0" for line in works] + ["doctor 1"] + [
        f"{line.split()[0]} 1" for line in lacking
    ]
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    for line, (command, extra) in zip(errors, lacking.items(), strict=True):
        assert f"pip install 'multilight[{extra}]'" in line, command
