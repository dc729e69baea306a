"""A wheel, installed beside a project that has a model.py, a scenes.py and a lights/ of its own."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

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
    data = ("*.py", "*.csv", "*.toml", "*.safetensors")
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
        "from multilight.datagen.storage.source import open_dataset\n"
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
