"""Files that claim too much, or are no plain files: refused in one line before anything is allocated, quickly."""

import json
import os
import resource
import struct
import time
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
import trimesh
from safetensors.numpy import save_file

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.model.captures.assets import load_asset
from multilight.model.cli import COMMANDS as MODEL_COMMANDS
from multilight.model.inference.pictures import read_depth, read_picture
from multilight.model.networks.checkpoint import load_network
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.formats import precheck
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.files.limits import MOST_TRIANGLES, read_bytes, read_json, read_toml

QUICK = 10.0
"""Seconds within which whatever is too much is refused."""
LARGE = 600 << 20
"""Bytes by which the process may grow meanwhile."""


@pytest.fixture(autouse=True)
def frugal() -> Iterator[None]:
    """Fail a test that takes long, or much memory."""
    start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    assert time.monotonic() - start < QUICK
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024 < LARGE


def png(width: int, height: int, *, whole: bool = False) -> bytes:
    """Write a black grey PNG of any size; its rows are there only where it is to be `whole`."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    rows = zlib.compress(bytes((width + 1) * height if whole else 10), 9)
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def glb(header: dict[str, Any], body: bytes = b"") -> bytes:
    text = json.dumps({"asset": {"version": "2.0"}} | header).encode()
    text += b" " * (-len(text) % 4)
    body += bytes(-len(body) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if body:
        chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()


def one_triangle(**changes: Any) -> dict[str, Any]:
    """Return the header of a file of one triangle."""
    return {
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    } | changes


def textured(picture: bytes) -> bytes:
    start = {"buffer": 0, "byteOffset": 36, "byteLength": len(picture)}
    header = one_triangle(
        buffers=[{"byteLength": 36 + len(picture)}],
        bufferViews=[{"buffer": 0, "byteLength": 36}, start],
        images=[{"name": "oak", "bufferView": 1, "mimeType": "image/png"}],
        textures=[{"source": 0}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
    )
    return glb(header, TRIANGLE + picture)


def claiming(**claims: Any) -> bytes:
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"} | claims
    return glb(one_triangle(accessors=[{k: v for k, v in accessor.items() if v is not None}]), TRIANGLE)


def doubling(levels: int) -> bytes:
    nodes: list[dict[str, Any]] = [{"children": [n + 1, n + 1]} for n in range(levels)]
    return glb(one_triangle(nodes=[*nodes, {"mesh": 0}]), TRIANGLE)


def deep(levels: int) -> bytes:
    nodes: list[dict[str, Any]] = [{"children": [n + 1]} for n in range(levels)]
    return glb(one_triangle(nodes=[*nodes, {"mesh": 0}]), TRIANGLE)


def heavy() -> bytes:
    """A mesh of 100,000 triangles, placed a hundred times."""
    count = 100_000
    header = one_triangle(
        buffers=[{"byteLength": 36 + 12 * count}],
        bufferViews=[{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12 * count}],
        nodes=[{"mesh": 0}] * 100,
        scenes=[{"nodes": list(range(100))}],
    )
    header["accessors"].append({"bufferView": 1, "componentType": 5125, "count": 3 * count, "type": "SCALAR"})
    header["meshes"][0]["primitives"][0]["indices"] = 1
    return glb(header, TRIANGLE + np.tile(np.array([0, 1, 2], "<u4"), count).tobytes())


MODELS: dict[str, tuple[Callable[[], bytes], str]] = {
    "doubling nodes": (lambda: doubling(40), "places more than 100000 nodes"),
    "doubling nodes beyond all numbers": (lambda: doubling(199), "places more than 100000 nodes"),
    "a circle": (lambda: glb(one_triangle(nodes=[{"mesh": 0, "children": [0]}]), TRIANGLE), "or in a circle"),
    "deep nodes": (lambda: deep(5000), "levels deep"),
    "claimed vertices": (lambda: claiming(count=400_000_000), "claims 400000000 elements, which are not in the file"),
    "vertices of nothing": (lambda: claiming(count=400_000_000, bufferView=None), "bytes, at most"),
    "negative count": (lambda: claiming(count=-3), "claims -3 elements"),
    "placed too often": (heavy, f"10000000 triangles, at most {MOST_TRIANGLES}"),
    "huge picture": (lambda: textured(png(50_000, 50_000)), "texture 'oak' cannot be read"),
    "large picture": (lambda: textured(png(13_000, 13_000)), "at most 67 million pixels are read"),
    "no picture": (lambda: textured(b"no picture"), "texture 'oak' cannot be read"),
    "nested": (lambda: glb({"extras": 0}).replace(b"0", b"[" * 100_000), "cannot be read"),
    "nested deeply": (lambda: b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}", "nested too deeply"),
}


def test_models_that_claim_too_much_are_refused_by_every_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MULTILIGHT_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "models"
    folder.mkdir()
    for number, (make, _) in enumerate(MODELS.values()):
        (folder / f"bomb{number}.glb").write_bytes(make())
    library = AssetLibrary(packs=(), folders=(folder,))
    assert [info.size for info in library.list("object")] == [None] * len(MODELS)
    for number, (_, said) in enumerate(MODELS.values()):
        path = folder / f"bomb{number}.glb"
        with pytest.raises(AssetError, match=path.name):
            library.mesh(f"models/bomb{number}")
        assert said in library.broken[f"models/bomb{number}"]
        with pytest.raises(UserError, match=path.name) as refused:
            load_asset(str(path))
        assert said in str(refused.value)


def test_sound_models_pass(tmp_path: Path) -> None:
    for name, content in {
        "plain": glb(one_triangle(), TRIANGLE),
        "twice": doubling(4),
        "textured": textured(png(8, 8, whole=True)),
        "zeros": claiming(bufferView=None),
    }.items():
        path = tmp_path / f"{name}.glb"
        path.write_bytes(content)
        precheck.check_model(path, tmp_path)


def test_pictures_of_an_obj_file_are_looked_at(tmp_path: Path) -> None:
    path = tmp_path / "model.obj"
    trimesh.creation.box().export(path)
    path.write_text("mtllib model.mtl\n" + path.read_text())
    (tmp_path / "model.mtl").write_text("newmtl a\nmap_Kd  wood grain.png\n")
    precheck.check_model(path, tmp_path)  # a picture that is missing is looked for near by, or named, where it is used
    (tmp_path / "wood grain.png").write_bytes(png(50_000, 50_000))
    with pytest.raises(AssetError, match=r"model\.obj: its texture 'wood grain\.png' .* 67 million pixels"):
        precheck.check_model(path, tmp_path)
    (tmp_path / "model.mtl").unlink()
    os.mkfifo(tmp_path / "model.mtl")
    with pytest.raises(AssetError, match="is a pipe or a device"):
        precheck.check_model(path, tmp_path)


@pytest.mark.parametrize("side", [9_000, 13_000, 50_000, 2**31 - 1])
def test_huge_pictures_are_refused(side: int, tmp_path: Path) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(png(side, side))
    for read in (read_picture, read_depth):
        with pytest.raises(UserError, match=r"huge\.png cannot be read: it .*at most 67 million pixels"):
            read(path)


def npy(shape: tuple[int, ...], kind: str = "<f4", body: bytes = b"") -> bytes:
    header = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + body


NPY: dict[str, bytes] = {
    "empty": b"",
    "lying": npy((60_000, 60_000)),
    "lying beyond numbers": npy((2**40, 2**40)),
    "negative": npy((-1, 4), body=bytes(16)),
    "objects": npy((2, 2), "|O", b"cos\nsystem\n."),
    "pickle": b"cos\nsystem\n(S'touch trap'\ntR.",
    "zip": b"PK\x03\x04" + bytes(40),
    "text": npy((1, 4), "<U3", bytes(48)),
    "no pixel": npy((0, 0)),
    "header of nothing": b"\x93NUMPY\x01\x00\xff\xff{",
    "nested header": b"\x93NUMPY\x01\x00" + struct.pack("<H", 9000) + b"(" * 9000,
}


@pytest.mark.parametrize("name", NPY)
def test_arrays_that_are_no_depths_are_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    path.write_bytes(NPY[name])
    with pytest.raises(UserError, match=r"depth\.npy") as refused:
        read_depth(path)
    assert "\n" not in str(refused.value)


def test_large_arrays_are_refused_before_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    with path.open("wb") as file:
        file.write(npy((10_000, 10_000), "<f8"))
        file.truncate(file.tell() + 8 * 10**8)  # takes no room on the disk
    with pytest.raises(UserError, match="100000000 numbers"):
        read_depth(path)


@pytest.mark.parametrize("reader", [read_environment, read_depth])
def test_exr_is_measured_before_it_is_decoded(reader: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "sky.exr"
    plane = np.zeros((8000, 10_000), np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"R": plane}).write(str(path))
    with pytest.raises((AssetError, UserError), match=r"sky\.exr .* 10000 x 8000 pixels, at most"):
        reader(path)


@pytest.mark.parametrize("reader", [read_bytes, read_json, read_toml, read_picture, read_depth, read_environment])
def test_pipes_devices_and_folders_are_refused(reader: Callable[[Path], object], tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.npy"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero"), tmp_path):
        with pytest.raises((OSError, ValueError, UserError, AssetError)):
            reader(path)


def test_files_that_the_kernel_makes_up_are_cut_off() -> None:
    with pytest.raises(ValueError, match="at most 1000 are read"):
        read_bytes(Path("/proc/self/smaps"), 1000)


@pytest.mark.parametrize("command", ["dataset", "mix", "train"])
def test_configurations_from_devices_and_pipes(
    command: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for file in (str(pipe), "/dev/zero", str(tmp_path)):
        words = {
            "dataset": ["dataset", "--out", str(tmp_path / "d"), "--config", file],
            "mix": ["mix", str(spheres_dataset), "--out", str(tmp_path / "m.png"), "--condition", file],
            "train": ["train", file],
        }[command]
        commands = {"commands": MODEL_COMMANDS} if command == "train" else {}
        assert main(words, **commands) == 1
        line = capsys.readouterr().err
        assert line.count("\n") == 1
        assert file in line


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 50_000,
        "a = " + "{b=" * 50_000,
        "seed." + "a." * 50_000 + "a = 1",
        "\n".join("a." * 900 + f"a{n} = 1" for n in range(140)),
        "[" + "a." * 20_000 + "a]",
        "seed = 1" + "0" * 100_000,
    ],
    ids=["lists", "tables", "dotted keys", "many dotted keys", "headers", "digits"],
)
def test_endless_configurations(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "c.toml"
    path.write_text(text)
    assert main(["dataset", "--out", str(tmp_path / "d"), "--config", str(path)]) == 1
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "c.toml" in line
    assert len(line) < 2500


def test_weights_that_describe_a_giant_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    header = {"network": '{"width": 1024, "groups": 16, "blocks": 32, "heads": 64}'}
    save_file({"a": np.zeros(3, np.float32)}, path, metadata=header)
    with pytest.raises(UserError, match=r"describes a network of \d+ numbers, the file holds 3"):
        load_network(path)
