"""A full disk, a quota, a limit of size, a folder that cannot be written: one line, and no cut file under its name."""

import contextlib
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import COMMANDS, main
from multilight.datagen.errors import StoreError
from multilight.datagen.storage.manifest import read_manifest
from multilight.model.cli import COMMANDS as MODEL_COMMANDS
from tests.datagen.test_manifest import EXPORTS

FILES = {
    "sheet": ["sheet", "DATA", "--out", "OUT/sheet.png"],
    "mix png": ["mix", "DATA", "--out", "OUT/mix.png"],
    "mix exr": ["mix", "DATA", "--out", "OUT/mix.exr"],
    "harmonize": ["harmonize", "--composite", "PIC", "--background", "PIC", "--mask", "MASK", "--out", "OUT/new.png"],
}
"""Commands that write one file."""
PAGES = {
    "stats": ["stats", "DATA", "--out", "OUT"],
    "evaluate": ["evaluate", "DATA", "--groups", "1", "--size", "32", "--splits", "train", "--out", "OUT"],
}
"""Commands that write pages."""


@contextlib.contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Let no file of this process grow beyond so many bytes, as a full disk would not."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("pictures")
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)
    Image.fromarray(noise).save(folder / "picture.png")
    mask = np.zeros((48, 64), np.uint8)
    mask[10:30, 10:30] = 255
    Image.fromarray(mask).save(folder / "mask.png")
    return {"PIC": folder / "picture.png", "MASK": folder / "mask.png"}


def run(words: list[str], data: Path, out: Path, pictures: dict[str, Path]) -> int:
    places = {"DATA": str(data), **{name: str(path) for name, path in pictures.items()}}
    filled = [places.get(word, word.replace("OUT", str(out))) for word in words]
    return main(filled, COMMANDS | MODEL_COMMANDS)


def told(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the error, which is one line; progress and notes may stand before it."""
    errors = capsys.readouterr().err.splitlines()
    assert [line.startswith("error: ") for line in errors].count(True) == 1
    assert errors[-1].startswith("error: ")
    return errors[-1]


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_written_whole_or_not(
    name: str, spheres_dataset: Path, tmp_path: Path, pictures: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words, out = FILES[name], tmp_path / "new" / "folder"
    with largest_file(300):
        assert run(words, spheres_dataset, out, pictures) == 1
    assert "file too large" in told(capsys).lower()
    assert list(out.iterdir()) == []
    assert run(words, spheres_dataset, out, pictures) == 0
    (path,) = out.iterdir()
    before = path.read_bytes()
    with largest_file(300):
        assert run(words, spheres_dataset, out, pictures) == 1
    assert [p.read_bytes() for p in out.iterdir()] == [before]


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_written_whole_or_not(
    name: str, spheres_dataset: Path, tmp_path: Path, pictures: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    words, out = PAGES[name], tmp_path / "out"
    if name == "evaluate":
        words = [word if word != "train" else json.loads(_record(spheres_dataset))["split"] for word in words]
    with largest_file(3000):
        assert run(words, spheres_dataset, out, pictures) == 1
    assert f"error: {out}: file too large" in told(capsys)
    for path in out.iterdir():
        assert path.stat().st_size < 3000, "a cut file"
        assert path.suffix == ".md" or json.loads(path.read_text())


def _record(dataset: Path) -> str:
    return (dataset / "scenes" / "000000" / "scene.json").read_text()


@pytest.mark.parametrize("limit", [100, 3_000, 20_000])
@pytest.mark.parametrize("name", EXPORTS)
def test_copies_are_not_finished_and_go_on(
    name: str, limit: int, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = [*EXPORTS[name], str(spheres_dataset), "--out", str(out)]
    with largest_file(limit):
        code = main(words)
    if code:
        told(capsys)
        if out.exists():
            with pytest.raises(StoreError, match="not finished"):
                read_manifest(out)
        assert main(words) == 0
    assert main(["verify", str(out)]) == 0


@pytest.mark.parametrize("name", [*FILES, *PAGES])
def test_places_that_cannot_be_written_are_told_before_the_work(
    name: str,
    spheres_dataset: Path,
    tmp_path: Path,
    pictures: dict[str, Path],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "multilight.datagen.tuples.compose.target", None
    )  # whatever makes a picture would end in an error of its own
    monkeypatch.setattr("multilight.model.inference.harmonize.load_network", None)
    monkeypatch.setattr("multilight.datagen.stats.collect.measure_dataset", None)
    words = (FILES | PAGES)[name]
    (tmp_path / "file").write_text("mine")
    assert run(words, spheres_dataset, tmp_path / "file", pictures) == 1
    assert "cannot be written" in told(capsys)
    assert run(words, spheres_dataset, Path("/proc/nowhere"), pictures) == 1
    assert "cannot be written" in told(capsys)
    if name in FILES:
        (tmp_path / "out" / Path(words[-1]).name).mkdir(parents=True)
        assert run(words, spheres_dataset, tmp_path / "out", pictures) == 1
        assert "cannot be written: it is a folder" in told(capsys)
    assert (tmp_path / "file").read_text() == "mine"


def test_devices_are_not_replaced(spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    assert main(["sheet", str(spheres_dataset), "--out", str(tmp_path / "pipe.png")]) == 1
    assert "cannot be written: it is a folder or a device" in told(capsys)


@pytest.mark.parametrize("words", [["query", "DATA", "--json"], ["config", "show"], ["verify", "DATA", "--json"]])
def test_a_full_standard_output_is_told_in_one_line(words: list[str], spheres_dataset: Path) -> None:
    filled = [word.replace("DATA", str(spheres_dataset)) for word in words]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "multilight", *filled], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "No space left on device" in line
