"""The examples and the README's ten lines run, at a small size; each has its picture in the documents."""

import contextlib
import importlib.util
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import multilight
from tests import ROOT

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SPHERES: dict[str, Any] = {
    "renderer": "analytic",
    "kind": "spheres",
    "width": 64,
    "height": 48,
    "views": 2,
    "spp": 4,
    "progress": False,
}
TINY: dict[str, Any] = {
    "width": 48,
    "height": 48,
    "views": 1,
    "spp": 2,
    "conditions": 3,
    "insertable": 2,
    "progress": False,
}
MOST_BYTES = 1_000_000


def example(name: str) -> Callable[..., None]:
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main


def picture(path: Path) -> np.ndarray:
    """Return the picture that an example made, (H, W, 3); it shows something."""
    with Image.open(path) as image:
        pixels = np.asarray(image)
    assert pixels.std() > 5, path
    return pixels


@contextlib.contextmanager
def made_with(**settings: Any) -> Iterator[None]:
    """Let what `multilight.make` and `make_scene` are given be overruled by these settings."""
    with pytest.MonkeyPatch.context() as patched:
        for name in ("make", "make_scene"):
            patched.setattr(multilight, name, partial(_overruled, getattr(multilight, name), settings))
        yield


def _overruled(call: Callable[..., Any], settings: dict[str, Any], out: Path | str, **given: Any) -> Any:
    return call(out, **given | settings)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the first example has made its scene, of spheres."""
    out = tmp_path_factory.mktemp("examples")
    with made_with(**SPHERES):
        example("make_a_scene")(out)
    return out


def test_each_example_is_short_and_has_its_picture() -> None:
    assert len(EXAMPLES) == 7
    shown = (ROOT / "README.md").read_text() + "".join(page.read_text() for page in (ROOT / "docs").glob("*.md"))
    sizes = []
    for path in EXAMPLES:
        assert len(path.read_text().splitlines()) < 40, path
        assert f"examples/{path.name}" in shown
        assert f"examples/{path.stem}.jpg" in shown
        sizes.append((ROOT / "docs" / "examples" / f"{path.stem}.jpg").stat().st_size)
    assert sum(sizes) < MOST_BYTES


def test_make_a_scene(made: Path) -> None:
    assert picture(made / "make_a_scene.jpg").shape == (48, 2 * 64, 3)
    assert multilight.verify(made / "tabletop") == []


def test_relight_it(made: Path) -> None:
    with made_with(**SPHERES):
        example("relight_it")(made)
    assert picture(made / "relight_it.jpg").shape == (2 * 48, 4 * 64, 3)


def test_read_with_openexr_alone(made: Path) -> None:
    text = (ROOT / "examples" / "read_with_openexr_alone.py").read_text()
    assert not re.search(r"^\s*(import|from) multilight", text, re.MULTILINE)
    example("read_with_openexr_alone")(made)
    assert picture(made / "read_with_openexr_alone.jpg").shape == (48, 4 * 64, 3)


def test_train_on_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with made_with(**SPHERES, scenes=1):
        example("train_on_it")(tmp_path, steps=3)
    assert picture(tmp_path / "train_on_it.jpg").shape == (3 * 96, 6 * 96, 3)
    assert "of the composites' squared error" in capsys.readouterr().out


def test_harmonize_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with made_with(**SPHERES, scenes=2):
        example("harmonize_it")(tmp_path)
    assert picture(tmp_path / "harmonize_it.jpg").shape == (2 * 192, 4 * 192, 3)
    assert capsys.readouterr().out.count(" dB\n") == 2


def test_add_a_kind_of_light(made: Path) -> None:
    with made_with(**SPHERES):
        example("add_a_kind_of_light")(made)
    assert picture(made / "add_a_kind_of_light.jpg").shape == (48, 3 * 64, 3)


def test_add_an_asset(tmp_path: Path) -> None:
    pytest.importorskip("pebble")
    with made_with(**TINY, scenes=1):
        example("add_an_asset")(tmp_path)
    assert picture(tmp_path / "add_an_asset.jpg").shape == (48, 48, 3)
    assert len(list((tmp_path / "turned").glob("*.glb"))) == 12


def ten_lines() -> str:
    """Return the README's first block of code."""
    language, code = re.findall(r"```(\w*)\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[0]
    assert language == "python"
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    return str(code)


def run_ten_lines(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    names: dict[str, Any] = {}
    exec(compile(ten_lines(), "README.md", "exec"), names)
    assert names["evening"].shape == names["empty"].shape == names["target"].shape
    assert not np.array_equal(names["composite"], names["target"])
    assert picture(folder / "out" / "demo" / "evening.png").shape == names["evening"].shape


def test_ten_lines_at_a_small_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with made_with(**SPHERES):
        run_ten_lines(tmp_path, monkeypatch)


@pytest.mark.slow
def test_ten_lines_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_ten_lines(tmp_path, monkeypatch)
