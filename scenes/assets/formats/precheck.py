"""What GLB and glTF files claim to hold, held against what is in them and what is read.

Importers believe a file's counts, follow every placing of a node, and leave out in silence what they do not know.
"""

import base64
import io
import struct
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from multilight.scenes.assets.formats.imported import Note
from multilight.scenes.assets.formats.obj import check_obj, check_picture
from multilight.scenes.assets.info import AssetError, unreadable
from multilight.scenes.files.confined import OutsideError, inside
from multilight.scenes.files.limits import (
    MOST_FILE,
    MOST_JSON,
    MOST_LEVELS,
    MOST_NODES,
    MOST_TRIANGLES,
    LimitError,
    check_size,
    parse_json,
    read_bytes,
)

_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
"""Bytes of glTF's types of numbers."""
_NUMBERS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
"""Numbers in each of glTF's types of elements."""
_STRIP = 5
"""glTF's mode of primitives whose every corner makes a triangle."""

READ = {
    "KHR_draco_mesh_compression", "KHR_lights_punctual", "KHR_materials_clearcoat", "KHR_materials_emissive_strength",
    "KHR_materials_ior", "KHR_materials_pbrSpecularGlossiness", "KHR_materials_specular",
    "KHR_materials_transmission", "KHR_materials_unlit", "KHR_mesh_quantization", "KHR_texture_transform",
    "EXT_mesh_gpu_instancing", "EXT_texture_webp", "KHR_materials_anisotropy", "KHR_materials_sheen",
}  # fmt: skip
"""Extensions of glTF that are read, or named where a material uses them."""
LEFT_OUT = {
    "KHR_animation_pointer": "it stands as at rest", "KHR_materials_variants": "the first variant is shown",
    "KHR_materials_volume": "what it encloses is clear",
}  # fmt: skip
"""Extensions that a file may require, and what happens instead."""
CREDITS = ("author", "copyright", "license", "source", "title")
"""What a file's asset says of itself, or its extras, as Sketchfab writes them."""
Header = dict[str, Any]


@dataclass
class Claims:
    """What a file says: the files that it names, what of it is not read, what wrote it, and whom to credit.

    `generator` is of OBJ its MTL's key words; `credits` has author, copyright, license, source and title, where stated.
    """

    files: set[Path] = field(default_factory=set)
    notes: list[Note] = field(default_factory=list)
    generator: str = ""
    credits: dict[str, str] = field(default_factory=dict)


def check_model(path: Path, folder: Path) -> Claims:
    """Check a GLB, glTF or OBJ file, and what it names inside `folder`, before it is loaded.

    Raises `AssetError` in one line with the file, what is too much in it or wrong, and the remedy.
    """
    claims = Claims()
    try:
        if path.suffix.lower() == ".obj":
            claims.generator = check_obj(path, folder, claims.files, claims.notes)
        elif path.suffix.lower() in (".glb", ".gltf"):
            header, within = read_header(path)
            about = header.get("asset", {})
            claims.generator = str(about.get("generator", ""))
            stated = about | (about["extras"] if isinstance(about.get("extras"), dict) else {})
            claims.credits = {key: str(stated[key])[:200] for key in CREDITS if isinstance(stated.get(key), str)}
            _check_extensions(header, claims.notes)
            _check_counts(header)
            _check_tree(header)
            _check_pictures(path, folder, header, within, claims.files)
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
    return claims


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


def _check_extensions(header: Header, notes: list[Note]) -> None:
    """Refuse extensions that a file cannot be shown without, and name others that are not read."""
    for extension in header.get("extensionsRequired", []):
        if extension not in READ | LEFT_OUT.keys():
            raise LimitError(f"it needs {extension}, which is not read; export it without compression and extensions")
    for extension in header.get("extensionsUsed", []):
        if extension not in READ:
            what = LEFT_OUT.get(extension, "it is left out")
            notes.append(Note(place="file", feature=extension, instead=what, remedy="export it without"))
    if any("occlusionTexture" in material for material in header.get("materials", [])):
        notes.append(Note(place="file", feature="occlusion maps", instead="shadows are computed", remedy="none needed"))
    if header.get("animations"):
        notes.append(Note(place="file", feature="animations", instead="it stands as at rest", remedy="bake a pose"))


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


def _check_pictures(path: Path, folder: Path, header: Header, within: bytes, files: set[Path]) -> None:
    """Refuse buffers that are missing and textures that cannot be opened, by name."""
    images = header.get("images", [])
    for entry in (*images, *header.get("buffers", [])):
        if not str(entry.get("uri", "data:")).startswith("data:"):
            files.add(inside(folder, unquote(entry["uri"]), beside=path.parent))
    content = cache(lambda uri: within if uri is None else _content(path, folder, uri))
    for number, texture in enumerate(header.get("textures", [])):
        other = texture.get("extensions", {}).keys() - READ
        if "source" not in texture and other:
            raise LimitError(
                f"its texture {number} needs {', '.join(sorted(other))}, which is not read; save it as PNG"
            )
    for number in sorted({texture["source"] for texture in header.get("textures", []) if "source" in texture}):
        image = images[number]
        if "uri" in image:
            if (
                not image["uri"].startswith("data:")
                and not inside(folder, unquote(image["uri"]), beside=path.parent).exists()
            ):
                continue  # looked for near by, and else named, where it is used
            data = content(image["uri"])
        else:
            view = header["bufferViews"][image["bufferView"]]
            start = int(view.get("byteOffset", 0))
            data = content(header["buffers"][view["buffer"]].get("uri"))[start : start + int(view["byteLength"])]
        check_picture(path, io.BytesIO(data), image.get("name") or image.get("uri", "")[:80] or f"number {number}")


def _content(path: Path, folder: Path, uri: str) -> bytes:
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    file = inside(folder, unquote(uri), beside=path.parent)
    if not file.exists():
        raise AssetError(f"{path} names {uri!r}, which is missing; put it beside the file, or export as GLB")
    return read_bytes(file)
