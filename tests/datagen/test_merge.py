"""Parts of a dataset put together are the dataset that was never split, to the byte."""

import os
import shutil
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.production import merging
from multilight.datagen.storage.store import file_sha256, read_scene
from multilight.datagen.text import ranges

SCENES = 7
SETTINGS = ["--renderer", "analytic", "--kind", "spheres", "--width", "32", "--height", "32"]
SETTINGS += ["--views", "1", "--spp", "1", "--workers", "1", "--scenes", str(SCENES)]
COUNTS = (1, 2, 3)


def contents(root: Path) -> dict[str, str]:
    return {p.relative_to(root).as_posix(): file_sha256(p) for p in root.rglob("*") if p.is_file()}


def make(root: Path, *words: str) -> Path:
    assert main(["dataset", "--out", str(root), *SETTINGS, *words]) == 0
    return root


def merge(out: Path, *parts: Path) -> int:
    return main(["merge", *map(str, parts), "--out", str(out)])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The whole, which is part 0 of 1, and its parts: `part-I-N`."""
    root = tmp_path_factory.mktemp("parts")
    for count in COUNTS:
        for number in range(count):
            make(root / f"part-{number}-{count}", "--shard", f"{number}/{count}")
    return root


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("turned", [False, True])
def test_parts_in_any_order_are_the_whole(folder: Path, tmp_path: Path, count: int, turned: bool) -> None:
    parts = [folder / f"part-{number}-{count}" for number in range(count)]
    before = [contents(part) for part in parts]
    assert merge(tmp_path / "set", *(reversed(parts) if turned else parts)) == 0
    assert contents(tmp_path / "set") == contents(folder / "part-0-1")
    assert [contents(part) for part in parts] == before
    view = "scenes/000000/views/00.exr"
    assert (tmp_path / "set" / view).samefile(folder / f"part-0-{count}" / view)
    assert main(["verify", str(tmp_path / "set")]) == 0


def test_parts_that_overlap_or_lack_scenes(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "set"
    damaged = shutil.copytree(folder / "part-0-3", tmp_path / "damaged")
    os.truncate(damaged / "scenes/000003/views/00.exr", 100)
    assert merge(out, folder / "part-1-2", damaged) == 1
    said = capsys.readouterr()
    assert "5 of 7 scenes" in said.out
    assert "missing: 2, 4; made by" in said.err
    assert f"{damaged}: scene 3 is damaged" in said.err
    assert merge(out, folder / "part-2-3", folder / "part-0-2") == 0
    assert contents(out) == contents(folder / "part-0-1")
    assert merge(out, out, *(folder / f"part-{number}-3" for number in range(3))) == 0
    assert "7 of 7 scenes, 0 of them new" in capsys.readouterr().out


def test_what_is_missing_is_made_in_place(folder: Path, tmp_path: Path) -> None:
    assert merge(tmp_path / "set", folder / "part-0-2") == 1
    make(tmp_path / "set")
    assert contents(tmp_path / "set") == contents(folder / "part-0-1")


def test_on_another_file_system_they_are_copied(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError("Invalid cross-device link")

    monkeypatch.setattr(os, "link", refused)
    assert merge(tmp_path / "set", *(folder / f"part-{number}-2" for number in range(2))) == 0
    assert contents(tmp_path / "set") == contents(folder / "part-0-1")
    assert not (tmp_path / "set/scenes/000000/scene.json").samefile(folder / "part-0-2/scenes/000000/scene.json")


def test_what_was_stopped_goes_on(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts, placed = [folder / f"part-{number}-3" for number in range(3)], []
    whole = merging._place

    def stopped(*about: object) -> None:
        placed.append(about)
        if len(placed) == 4:
            raise KeyboardInterrupt
        whole(*about)  # type: ignore[arg-type]

    monkeypatch.setattr(merging, "_place", stopped)
    assert merge(tmp_path / "set", *parts) == 130
    assert merge(tmp_path / "set", *parts) == 0
    assert len(placed) == 8
    assert contents(tmp_path / "set") == contents(folder / "part-0-1")


def test_parts_of_other_datasets_are_refused(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, other = folder / "part-0-2", make(tmp_path / "other", "--seed", "8", "--shard", "1/2")
    capsys.readouterr()
    assert merge(tmp_path / "set", first, other) == 1
    assert capsys.readouterr().err == (f"error: {first} and {other} are not parts of one dataset: seed = 0, not 8\n")
    assert not (tmp_path / "set").exists()
    files = tmp_path / "files"
    files.mkdir()
    (files / "mine.txt").touch()
    assert merge(files, first) == 1
    assert "holds no dataset" in capsys.readouterr().err
    assert merge(tmp_path / "set", files) == 1
    assert "dataset.json is missing" in capsys.readouterr().err


def test_another_scene_under_the_same_number(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = shutil.copytree(folder / "part-0-2", tmp_path / "other")
    (other / "index.parquet").unlink()  # which would state the record that was
    scene = read_scene(other / "scenes/000004").model_copy(update={"thrown_away": ("noise: too much",)}).sealed()
    (other / "scenes/000004/scene.json").write_text(scene.model_dump_json(indent=1))
    assert merge(tmp_path / "set", folder / "part-0-1", other) == 1
    said = capsys.readouterr().err
    assert f"{folder / 'part-0-1'} and {other} are not parts of one dataset: scene 4 is another in each" in said


@pytest.mark.parametrize(
    ("numbers", "said"),
    [((), ""), ((1, 2, 3, 7), "1-3, 7"), (range(0, 30, 2), "0, 2, 4, 6, 8, 10, 12, 14, 16, 18 and 5 more")],
)
def test_ranges(numbers: tuple[int, ...], said: str) -> None:
    assert ranges(numbers) == said
