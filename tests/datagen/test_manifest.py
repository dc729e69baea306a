"""Packed copies and exports are checked by their manifest: whatever was changed is found, named, and made anew."""

import json
import os
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from multilight.datagen.cli import main
from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.files.locks import locked
from multilight.datagen.storage.manifest import JOURNAL, MANIFEST, read_manifest, remedy
from multilight.datagen.storage.open_training import open_training
from multilight.datagen.verification.copies import copy_at, verify_copy
from tests.datagen.chain import chain
from tests.datagen.servers import in_memory

EXPORTS: dict[str, list[str]] = {
    "packed": ["pack", "--workers", "1"],
    "dtc-multilight": ["export", "dtc-multilight", "--workers", "1", "--size", "32", "--map-size", "16"]
    + ["--conditions", "1", "--exposures", "1"],
    "webdataset": ["export", "webdataset", "--pairs", "1"],
    "nerfstudio": ["export", "nerfstudio", "--conditions", "1", "--points", "200"],
    "colmap": ["export", "colmap", "--conditions", "1", "--points", "200"],
    "luxremix": ["export", "luxremix"],
    "luxremix tars": ["export", "luxremix", "--tar"],
    "usd": ["export", "usd"],
    "web": ["export", "web"],
}
"""Every way to make something of a dataset."""


def make(kind: str, dataset: Path, out: Path) -> int:
    return main([*EXPORTS[kind], str(dataset), "--out", str(out)])


@pytest.fixture(scope="module", params=list(EXPORTS))
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def made(kind: str, spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("made") / "copy"
    assert make(kind, spheres_dataset, out) == 0
    return out


@pytest.fixture
def copy(made: Path, tmp_path: Path) -> Path:
    """One to damage; made by links, so replace files, do not write into them."""
    return Path(shutil.copytree(made, tmp_path / "copy", copy_function=os.link))


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another dataset."""
    root = tmp_path_factory.mktemp("other") / "dataset"
    words = ["--renderer", "analytic", "--kind", "spheres", "--width", "32", "--height", "32", "--views", "1"]
    assert main(["dataset", "--out", str(root), "--scenes", "1", "--seed", "9", *words]) == 0
    return root


def content(root: Path) -> dict[str, bytes]:
    """Read all files; in those of DTC-MultiLight that name their own place, and in the manifest, it is left out."""
    files = {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}
    if b"DTC-MultiLight" in files.get("README.md", b""):
        files |= dict.fromkeys(files.keys() & {"train.json", "test.json", MANIFEST}, b"")
    return files


def rewrite(path: Path, content: bytes) -> None:
    path.unlink()
    path.write_bytes(content)


def flip(path: Path) -> None:
    changed = bytearray(path.read_bytes())
    changed[len(changed) // 2] ^= 1
    rewrite(path, bytes(changed))


def two_alike(root: Path) -> tuple[Path, Path]:
    """Find two files of the same name, size and suffix but different content."""
    seen: dict[tuple[str, int], Path] = {}
    for path in sorted(p for p in root.rglob("*/*") if p.is_file()):
        other = seen.setdefault((path.suffix, path.stat().st_size), path)
        if other.read_bytes() != path.read_bytes():
            return other, path
    one, other = sorted(p for p in root.rglob("*") if p.is_file())[:2]  # a single tar: with the manifest itself
    return one, other


def swap(root: Path) -> None:
    one, other = two_alike(root)
    first, second = one.read_bytes(), other.read_bytes()
    rewrite(one, second)
    rewrite(other, first)


def largest(root: Path) -> Path:
    return max((p for p in root.rglob("*") if p.is_file() and p.name != MANIFEST), key=lambda p: (p.stat().st_size, p))


def link_instead(root: Path) -> None:
    path = largest(root)
    path.unlink()
    path.symlink_to("/dev/null")


DAMAGES: dict[str, tuple[Callable[[Path], object], str, bool]] = {
    "missing": (lambda root: largest(root).unlink(), "missing", True),
    "longer": (lambda root: rewrite(p := largest(root), p.read_bytes() + b"\0"), "size", True),
    "cut": (lambda root: rewrite(p := largest(root), p.read_bytes()[:-1]), "size", True),
    "empty": (lambda root: rewrite(largest(root), b""), "size", True),
    "flipped": (lambda root: flip(largest(root)), "content", False),
    "extra": (lambda root: (root / "notes.txt").write_text("mine"), "extra", True),
    "extra folder": (lambda root: (root / "more").mkdir(), "extra", True),
    "link": (link_instead, "size", True),
}
"""What is done, the check that finds it, and whether names and sizes tell."""


def test_what_is_made_is_sound(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    manifest = read_manifest(made)
    assert set(manifest.files) == set(content(made)) - {MANIFEST}
    assert main(["verify", str(made)]) == 0
    assert "all as they were made" in capsys.readouterr().out
    assert main(["verify", str(made), "--quick", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["faults"], found["files"], found["quick"]) == ([], len(manifest.files), True)


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_named(copy: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    damage, check, quickly = DAMAGES[name]
    damage(copy)
    assert [fault.check for fault in verify_copy(copy, quick=False)] == [check]
    assert [fault.check for fault in verify_copy(copy, quick=True)] == ([check] if quickly else [])
    assert main(["verify", str(copy), "--json"]) == 1
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert fault["check"] == check
    assert main(["verify", str(copy)]) == 1
    shown = capsys.readouterr().out
    assert f"{copy}/{fault['file']}: {check}" in shown
    words = shlex.split(shown.strip().rpartition("made anew by: multilight ")[2])
    if name not in ("extra", "extra folder", "link"):  # a link out of the folder is to be removed by hand
        assert main(words) == 0
        assert main(["verify", str(copy), "--quick"]) == 0


def test_swapped_files_are_named(copy: Path) -> None:
    one, other = (str(path.relative_to(copy)) for path in two_alike(copy))
    swap(copy)
    if MANIFEST in (one, other):
        with pytest.raises(StoreError, match="damaged"):
            read_manifest(copy)
        return
    found = {fault.file: fault for fault in verify_copy(copy, quick=False)}
    assert set(found) == {one, other}
    if found[one].check == "content":
        assert other in found[one].message


def test_a_changed_manifest_is_named(copy: Path) -> None:
    path = copy / MANIFEST
    text = path.read_text()
    stated = json.loads(text)
    name = sorted(stated["files"])[0]
    changed = [
        text.replace('"bytes": ', '"bytes": 1', 1),
        text.replace(f'"{name}"', '"../../etc/passwd"'),
        json.dumps(stated | {"settings": {"size": 3}}),
        text[:-10],
        "",
        "[" * 100_000,
        json.dumps(stated | {"format": "multilight manifest 9"}),
    ]
    for written in changed:
        rewrite(path, written.encode())
        with pytest.raises(StoreError, match=rf"{MANIFEST} is damaged"):
            list(verify_copy(copy, quick=True))
    path.unlink()
    with pytest.raises(StoreError, match=f"{MANIFEST} is missing"):
        list(verify_copy(copy, quick=True))


@pytest.mark.parametrize("name", ["missing", "flipped", "longer"])
def test_made_again_the_damage_is_gone(kind: str, copy: Path, spheres_dataset: Path, name: str) -> None:
    before = content(copy)
    DAMAGES[name][0](copy)
    assert make(kind, spheres_dataset, copy) == 0
    assert content(copy) == before


def test_made_again_nothing_is_done(
    kind: str, copy: Path, spheres_dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps = {path: path.stat().st_mtime_ns for path in copy.glob("*/**/*") if path.is_file()}
    before = content(copy)
    assert make(kind, spheres_dataset, copy) == 0
    assert content(copy) == before
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps


def test_another_datasets_is_refused(kind: str, copy: Path, other: Path, capsys: pytest.CaptureFixture[str]) -> None:
    manifest, before = read_manifest(copy), content(copy)
    assert make(kind, other, copy) == 1
    told = capsys.readouterr().err
    assert "holds another dataset" in told
    assert str(other) in told
    assert manifest.source.address in told
    assert content(copy) == before
    assert {fault.check for fault in verify_copy(copy, quick=True)} == set()
    assert main(["verify", str(copy), "--quick", "--source", str(other)]) == 1
    assert "another dataset" in capsys.readouterr().out


OTHERS = {
    "dtc-multilight": ["--conditions", "2"],
    "webdataset": ["--pairs", "2"],
    "nerfstudio": ["--conditions", "2"],
    "colmap": ["--conditions", "2"],
    "luxremix": ["--tar"],
}


def test_other_options_are_refused(
    kind: str, copy: Path, spheres_dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What a run would leave out of what is there, or leave as it is, is not kept in silence."""
    before = content(copy)
    for words in ([] if kind == "packed" else ["--where", "index = 0"], OTHERS.get(kind, [])):
        if words:
            assert main([*EXPORTS[kind], str(spheres_dataset), "--out", str(copy), *words]) == 1
            assert f"was made with {words[0].strip('-')} = " in capsys.readouterr().err
    assert content(copy) == before


def test_scenes_that_are_gone_are_refused(
    kind: str, copy: Path, spheres_copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(spheres_copy / "scenes" / "000001")
    chain(spheres_copy)
    assert make(kind, spheres_copy, copy) == 1
    assert "holds scene 1, which" in capsys.readouterr().err


def test_no_scene_is_an_error(
    kind: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if kind == "packed":
        pytest.skip("it takes no --where")
    words = ["--out", str(tmp_path / "out"), "--where", "kind = 'moon'"]
    assert main([*EXPORTS[kind], str(spheres_dataset), *words]) == 1
    assert capsys.readouterr().err.endswith("holds no finished scene for which kind = 'moon'\n")
    assert not (tmp_path / "out").exists()


def test_where_is_part_of_the_remedy(spheres_dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main([*EXPORTS["nerfstudio"], str(spheres_dataset), "--out", str(out), "--where", "index = 0"]) == 0
    assert "--conditions 1 --points 200 --where 'index = 0'" in remedy(read_manifest(out), str(out))


def test_two_at_once(kind: str, copy: Path, spheres_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with locked(copy):
        assert make(kind, spheres_dataset, copy) == 1
        assert "being made by another process" in capsys.readouterr().err
        assert main(["verify", str(copy)]) == 0
    assert not (copy / ".lock").exists()


def test_a_file_in_the_way_or_other_files_are_refused(
    kind: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "notes.txt").write_text("mine")
    for out, words in (("file", "cannot be written"), ("file/below", "cannot be written"), ("folder", "is not empty")):
        assert make(kind, spheres_dataset, tmp_path / out) == 1
        told = capsys.readouterr().err
        assert words in told
        assert len(told.splitlines()) == 1
    assert content(tmp_path) == {"file": b"mine", "folder/notes.txt": b"mine"}


def test_what_was_stopped_goes_on(spheres_dataset: Path, tmp_path: Path) -> None:
    """A journal cut anywhere, with half-made folders beside it, is gone on with, to the same bytes."""
    whole, out = tmp_path / "whole", tmp_path / "out"
    assert make("packed", spheres_dataset, whole) == 0
    shutil.copytree(whole, out)
    stated = json.loads((out / MANIFEST).read_text())
    head = {key: stated[key] for key in ("format", "kind", "version", "source", "settings")}
    lines = [json.dumps(head)]
    for name, part in stated["parts"].items():
        lines.append(json.dumps([name, part, {f: e for f, e in stated["files"].items() if f.startswith(name)}]))
    (out / MANIFEST).unlink()
    (out / JOURNAL).write_text("\n".join(lines)[:-20])
    (out / "work" / "half").mkdir(parents=True)
    with pytest.raises(StoreError, match="not finished"):
        list(verify_copy(out, quick=True))
    with pytest.raises(StoreError, match="not finished"):
        open_training(out)
    kept = out / "scenes" / "000000" / "views" / "00.safetensors"
    stamp = kept.stat().st_mtime_ns
    assert make("packed", spheres_dataset, out) == 0
    assert kept.stat().st_mtime_ns == stamp
    assert content(out) == content(whole)


def test_links_that_lead_out_are_not_followed(
    kind: str, copy: Path, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever of a copy became a link: nothing outside is written, and the copy is mended or refused."""
    outside = tmp_path / "outside"
    outside.mkdir()
    path = copy / min(read_manifest(copy).parts)
    if path.is_dir():
        shutil.rmtree(path)
    else:  # of tars
        path = largest(copy)
        path.unlink()
    path.symlink_to(outside)
    assert [fault.check for fault in verify_copy(copy, quick=True)]
    code = make(kind, spheres_dataset, copy)
    assert list(outside.iterdir()) == []
    assert code == 0 or "leads out of the folder" in capsys.readouterr().err


def test_a_repaired_scene_is_packed_anew(spheres_copy: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert make("packed", spheres_copy, out) == 0
    record = spheres_copy / "scenes" / "000001" / "scene.json"
    record.write_text(record.read_text() + "\n")
    assert main(["verify", str(out), "--quick", "--source", str(spheres_copy)]) == 1
    assert make("packed", spheres_copy, out) == 0
    assert main(["verify", str(out), "--source", str(spheres_copy)]) == 0
    assert (out / "scenes" / "000001" / "scene.json").read_text().endswith("\n")


def test_packed_copies_at_an_address_are_checked_as_they_are_read(spheres_dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert make("packed", spheres_dataset, out) == 0
    with in_memory(out) as address:
        open_training(address).view(1, 0)
        with pytest.raises(UserError, match="where it lies as a folder"):
            copy_at(address)
    rewrite(path := out / "scenes/000001/views/00.safetensors", path.read_bytes()[:-1])
    with in_memory(out) as address, pytest.raises(StoreError, match=r"truncated or damaged.*made anew by"):
        open_training(address).view(1, 0)
