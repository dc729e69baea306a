"""What model files (GLB, glTF, OBJ) claim to hold, held against what is in them and what is read.

trimesh believes a file's counts, follows every placing of a node, and leaves out in silence the pictures that fail.
"""

import base64
import io
import re
import struct
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote

from multilight.scenes.assets.info import AssetError, unreadable
from multilight.scenes.files.inside import OutsideError, inside
from multilight.scenes.files.limits import (
    MOST_FILE,
    MOST_JSON,
    MOST_LEVELS,
    MOST_NODES,
    MOST_TRIANGLES,
    LimitError,
    check_size,
    open_picture,
    parse_json,
    read_bytes,
)

_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
"""Bytes of glTF's types of numbers."""
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Numbers in each of glTF's types of elements."""
_STRIP = 5
"""glTF's mode of primitives whose every corner makes a triangle."""

Header = dict[str, Any]


def check_model(path: Path, folder: Path) -> None:
    """Check a GLB, glTF or OBJ file, and what it names inside `folder`, before it is loaded.

    Raises `AssetError` in one line with the file, what is too much in it or wrong, and the remedy.
    """
    try:
        if path.suffix.lower() == ".obj":
            _check_obj(path, folder)
        else:
            header, within = read_header(path)
            _check_counts(header)
            _check_tree(header)
            _check_pictures(path, folder, header, within)
    except AssetError:
        raise
    except OutsideError as error:
        raise AssetError(f"{path}: {error}; put the file into the folder {folder}") from error
    except OSError as error:
        raise AssetError(f"{path} cannot be read: {error.strerror or error}") from error
    except LimitError as error:
        raise AssetError(f"{path}: {error}") from error
    except Exception as error:  # whatever a broken header makes the above stumble over
        raise unreadable(path, error) from error


def check_placed(scene: Any) -> None:
    """Raise `LimitError` where trimesh's scene has too many triangles, each placing of a mesh counted."""
    placed = (scene.geometry[scene.graph[node][1]] for node in scene.graph.nodes_geometry)
    check_triangles(sum(len(getattr(mesh, "faces", ())) for mesh in placed))


def check_triangles(count: int) -> None:
    """Raise `LimitError` where a model has more than `MOST_TRIANGLES`."""
    if count > MOST_TRIANGLES:
        raise LimitError(f"it has {count} triangles, at most {MOST_TRIANGLES} are read; simplify it")


def read_header(path: Path) -> tuple[Header, bytes]:
    """Return the JSON of a GLB or glTF file, and the buffer inside a GLB; raises `AssetError` naming the file."""
    try:
        data, within = read_bytes(path), b""
        if data[:4] == b"glTF":
            length, kind = struct.unpack("<I4s", data[12:20])
            if kind != b"JSON" or struct.unpack("<I", data[8:12])[0] > len(data):
                raise ValueError("it is cut short")
            data, within = data[20 : 20 + length], data[28 + length :]
        check_size(len(data), MOST_JSON)
        header = parse_json(data)
        if not isinstance(header, dict):
            raise ValueError("its JSON is no object")
    except OSError as error:
        raise AssetError(f"{path} cannot be read: {error.strerror or error}") from error
    except (ValueError, struct.error) as error:
        raise unreadable(path, error) from error
    return header, within


def _check_counts(header: Header) -> None:
    """Refuse arrays that reach beyond their part of the file, and those of nothing that take too much room."""
    views = header.get("bufferViews", [])
    total = sum(int(view["byteLength"]) for view in views)
    for number, accessor in enumerate(header.get("accessors", [])):
        size = int(accessor["count"]) * _BYTES[accessor["componentType"]] * _NUMBERS[accessor["type"]]
        view = accessor.get("bufferView")
        if size < 0 or (view is not None and "byteStride" not in views[view] and size > int(views[view]["byteLength"])):
            raise ValueError(f"its array {number} claims {accessor['count']} elements, which are not in the file")
        total += size
    check_size(total, 2 * MOST_FILE)  # each byte counts in its part of the file and in the array made of it


def _check_tree(header: Header) -> None:
    """Refuse trees that place too many nodes or triangles, are too deep, or lead back to where they came from."""
    nodes, meshes = header.get("nodes", []), [_triangles(header, mesh) for mesh in header.get("meshes", [])]
    if sum(len(mesh["primitives"]) for mesh in header.get("meshes", [])) > MOST_NODES:
        raise LimitError(f"it has more than {MOST_NODES} pieces; join some")
    scenes = header.get("scenes") or [{}]
    level = dict.fromkeys(scenes[header.get("scene", 0)].get("nodes", []), 1)
    placed = shown = 0
    check_triangles(sum(meshes))
    for _ in range(MOST_LEVELS):
        below: dict[int, int] = {}
        for index, times in level.items():
            placed += times
            shown += times * (meshes[nodes[index]["mesh"]] if "mesh" in nodes[index] else 0)
            for child in nodes[index].get("children", []):
                below[child] = below.get(child, 0) + times
        if placed > MOST_NODES:
            raise LimitError(
                f"it places more than {MOST_NODES} nodes; export it with branches of their own, or join some"
            )
        check_triangles(shown)
        if not below:
            return
        level = below
    raise LimitError(f"its nodes lie more than {MOST_LEVELS} levels deep, or in a circle; flatten them")


def _triangles(header: Header, mesh: Header) -> int:
    accessors = header.get("accessors", [])
    total = 0
    for primitive in mesh["primitives"]:
        index = primitive.get("indices", primitive["attributes"].get("POSITION"))
        if index is not None:
            total += int(accessors[index]["count"]) // (1 if primitive.get("mode") == _STRIP else 3)
    return total


def _check_pictures(path: Path, folder: Path, header: Header, within: bytes) -> None:
    """Refuse textures that cannot be opened, by name."""
    content = cache(lambda uri: within if uri is None else _content(path, folder, uri))
    images = header.get("images", [])
    for number in sorted({texture["source"] for texture in header.get("textures", []) if "source" in texture}):
        image = images[number]
        if "uri" in image:
            data = content(image["uri"])
        else:
            view = header["bufferViews"][image["bufferView"]]
            start = int(view.get("byteOffset", 0))
            data = content(header["buffers"][view["buffer"]].get("uri"))[start : start + int(view["byteLength"])]
        _check_picture(path, io.BytesIO(data), image.get("name") or image.get("uri", "")[:80] or f"number {number}")


def _content(path: Path, folder: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return read_bytes(inside(folder, unquote(uri), beside=path.parent))


def _check_picture(path: Path, picture: Path | BinaryIO, name: str) -> None:
    try:
        open_picture(picture).close()
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: its texture {name!r} cannot be read ({error}); save it as PNG") from error


def _check_obj(path: Path, folder: Path) -> None:
    """Refuse pictures of an OBJ file's materials that cannot be opened; those that are missing are left out."""
    for library in _files("mtllib", path, path, folder):
        for picture in _files("map_Kd", library, path, folder):
            _check_picture(path, picture, picture.name)


def _files(key: str, text: Path, path: Path, folder: Path) -> list[Path]:
    """Return the files behind a key word that are there; MTL files of other systems have backslashes."""
    found = re.findall(rf"^[ \t]*{key}[ \t]+(.*\S)".encode(), read_bytes(text, MOST_JSON), re.MULTILINE | re.IGNORECASE)
    names = {name.decode("utf-8", "surrogateescape").replace("\\", "/") for name in found}
    files = [inside(folder, name, beside=path.parent) for name in sorted(names)]
    return [file for file in files if file.exists()]
