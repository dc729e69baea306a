"""The asset cache heals itself: whatever is damaged in it is thrown away, counted, said once, and made anew."""

import pickle
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.scenes.assets import cache
from multilight.scenes.assets.fetch import fetch_pack
from multilight.scenes.assets.library import AssetError, AssetLibrary
from tests.scenes.custom_scenes import room, write_glb


class Trap:
    """What a foreign pickle would do if it were ever loaded."""

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str, str]]:
        return Path.write_text, (Path("trap"), "sprung")  # type: ignore[return-value]


def as_npy(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, np.zeros((3, 3)))


def as_other_arrays(path: Path) -> None:
    with np.load(path) as data:
        arrays = dict(data)
    arrays["f0"] = arrays["f0"] + np.int32(len(arrays["v0"]))
    np.savez(path, **arrays)


def as_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def blank(path: Path) -> None:
    """Let a PNG show other pixels, which Pillow decodes without a word: only a chunk's sum tells."""
    with Image.open(path) as picture:
        Image.eval(picture, lambda value: 255 - value).save(path)
    content = bytearray(path.read_bytes())
    content[-13] ^= 1  # the last sum but that of the empty chunk at the end
    path.write_bytes(content)
    with Image.open(path) as picture:
        picture.load()


DAMAGES: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "empty": lambda path: path.write_bytes(b""),
    "pickle": lambda path: path.write_bytes(pickle.dumps(Trap())),
    "npy": as_npy,
    "text": lambda path: path.write_text("[]"),
    "folder": as_folder,
    "flipped": flipped,
    "blank": blank,
    "unended": lambda path: path.write_bytes(path.read_bytes()[:-12]),
}


WANTED: dict[str, object] = {}
"""What is in the assets of the whole cache."""


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with one file of each kind; tests must not change it."""
    folder = tmp_path_factory.mktemp("cache")
    WANTED.update(use(folder))
    return folder


def use(folder: Path) -> dict[str, object]:
    """Ask for one asset of each kind, as a new process would, and return what is in them."""
    cache._sound.clear()
    library = AssetLibrary(folder, packs=("builtin",))
    return {
        "index": [info.size for info in library.list("object")],
        "mesh": library.mesh("builtin/die-01").sha256(),
        "texture": library.texture_path("builtin/metal-brushed").read_bytes(),
        "gobo": library.texture_path("builtin/gobo-window-2x2").read_bytes(),
        "derived": library.texture_path("builtin/metal-brushed#roughness").read_bytes(),
        "sky": library.environment_path(next(i.id for i in library.list("environment") if "sky" in i.id)).read_bytes(),
    }


CASES = {
    "index/*.json": ("cut", "npy", "folder"),
    "meshes/**/*.npz": ("cut", "empty", "pickle", "npy", "text", "folder", "flipped"),
    "textures/**/metal-brushed.png": ("cut", "pickle", "flipped", "blank", "unended"),
    "environments/**/*.exr": ("cut", "empty"),
}


@pytest.mark.parametrize(("kind", "damage"), [(kind, damage) for kind, damages in CASES.items() for damage in damages])
def test_damaged_files_are_made_anew_and_told(
    filled: Path,
    kind: str,
    damage: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "cache"
    shutil.copytree(filled, folder)
    path = next(folder.glob(kind))
    DAMAGES[damage](path)
    assert use(folder) == WANTED
    cache.tell_thrown_away()
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "a damaged file thrown away" in line
    assert str(path) in line
    assert not (tmp_path / "trap").exists()
    use(folder)
    cache.tell_thrown_away()
    assert capsys.readouterr().err == ""


def test_mesh_of_wrong_arrays_is_made_anew(filled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "cache"
    shutil.copytree(filled, folder)
    as_other_arrays(next(folder.glob("meshes/**/*.npz")))
    assert use(folder) == WANTED
    cache.tell_thrown_away()
    assert "name vertices which are not there" in capsys.readouterr().err


def test_commands_go_on_with_a_damaged_cache(
    filled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "cache"
    shutil.copytree(filled, folder)
    monkeypatch.setenv("MULTILIGHT_CACHE", str(folder))
    for path in folder.glob("index/*.json"):
        path.write_bytes(b"[{")
    assert main(["assets", "list", "builtin"]) == 0
    assert capsys.readouterr().err.count("thrown away") == 1


def test_a_converted_background_is_made_anew(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    glb = write_glb(tmp_path / "room.glb", room())
    folder = tmp_path / "cache"
    library = AssetLibrary(folder, packs=("builtin",), background=glb)
    wanted = {info.id: library.mesh(info.id).sha256() for info in library.list("surrounding") if "bg_" in info.id}
    (converted,) = (folder / "backgrounds").iterdir()
    assert wanted
    pictures = folder / "textures" / "imported"
    for place, kind, damages in (
        (converted, "index.json", ("cut", "text", "folder")),
        (converted, "*.npz", ("empty", "npy")),
        (pictures, "*.png", ("cut",)),
    ):
        for damage in damages:
            path = next(place.glob(kind))
            whole = path.read_bytes()
            DAMAGES[damage](path)
            shutil.rmtree(folder / "meshes")
            cache._sound.clear()
            again = AssetLibrary(folder, packs=("builtin",), background=glb)
            assert {asset: again.mesh(asset).sha256() for asset in wanted} == wanted
            for texture in (f"background/{png.stem}" for png in pictures.glob("*.png")):
                again.texture_path(texture)
            assert path.suffix == ".npz" or path.read_bytes() == whole
            cache.tell_thrown_away()
            assert str(path) in capsys.readouterr().err


def test_a_pack_with_a_damaged_record_names_the_command_and_is_fetched_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = tmp_path / "packs" / "sweethome3d" / "pack.json"
    record.parent.mkdir(parents=True)
    record.write_text("{")
    with pytest.raises(AssetError, match="run `multilight assets fetch sweethome3d`"):
        AssetLibrary(tmp_path)
    monkeypatch.setattr("multilight.scenes.assets.fetch._installed_furniture", lambda: tmp_path)
    fetch_pack("sweethome3d", tmp_path)
    AssetLibrary(tmp_path)


def test_a_file_that_may_not_be_read_is_not_thrown_away(tmp_path: Path) -> None:
    def refused(path: Path) -> None:
        raise PermissionError(13, "Permission denied", str(path))

    def no_memory(path: Path) -> None:
        raise MemoryError

    path = tmp_path / "file"
    path.write_text("good")
    with pytest.raises(AssetError, match="Permission denied"):
        cache.read_kept(path, refused)
    with pytest.raises(MemoryError):
        cache.read_kept(path, no_memory)
    assert path.read_text() == "good"


def test_there_is_one_cache_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MULTILIGHT_CACHE", raising=False)
    monkeypatch.setenv("HOME", "/home/one")
    for key, value, place in (
        ("XDG_CACHE_HOME", "", "/home/one/.cache/multilight"),
        ("XDG_CACHE_HOME", "/var/caches", "/var/caches/multilight"),
        ("MULTILIGHT_CACHE", "~/packs", "/home/one/packs"),
    ):
        monkeypatch.setenv(key, value)
        assert cache.default_cache() == Path(place)
