"""The native layout: the only code that knows how a dataset lies on disk.

    dataset.json                      configuration, renderer, versions, licences
    index.parquet                     a row a scene
    scenes/000123/scene.json          SceneRecord
    scenes/000123/preview.png
    scenes/000123/views/03.exr        one multi-part OpenEXR a view

Parts of a view: `all`, `without_<object>`, `foreground_<object>` (layers, channels `<variant>.<light>.R|G|B`),
`combined` (`combined.R|G|B`, the renderer's own all-lights picture, not denoised), and `geometry`. Where a denoised
dataset keeps its raw layers, each variant comes a second time as it was rendered, with `raw_` before the part's and
the channels' names: `raw_all`, `raw_all.<light>.R|G|B`, `raw_without_<object>`, `raw_foreground_<object>`.
"""

import hashlib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from pydantic import ValidationError

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.halves import Halves, Planes, in_planes, planes_of, stored_layers
from multilight.datagen.storage.layers import GeometryBuffers
from multilight.datagen.storage.object_variants import ALL, RAW, variants_of
from multilight.datagen.storage.records import DatasetRecord, SceneRecord
from multilight.scenes.arrays import Float32
from multilight.scenes.files.atomic import write_whole
from multilight.scenes.files.confined import OutsideError, inside

_Record = TypeVar("_Record", SceneRecord, DatasetRecord)
Channels = dict[str, NDArray[np.generic]]
"""Planes (H, W) by the name that each has in a file."""
HEADER = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}  # to be copied: the binding adds to it
GEOMETRY: dict[str, tuple[Sequence[str], type[np.generic], type[np.generic]]] = {
    "z_depth": ("Z", np.float32, np.float32),
    "normal_world": ("XYZ", np.float16, np.float32),
    "albedo": ("RGB", np.float16, np.float32),
    "roughness": ("Y", np.float16, np.float32),
    "metallic": ("Y", np.float16, np.float32),
    "instance_id": (("ID",), np.uint32, np.uint16),
    "environment": ("A", np.float16, np.float32),
}
"""Channels of the geometry buffers, the type in the file, and that in memory."""
ALWAYS = {f"{name}.{c}" for name, (channels, *_) in GEOMETRY.items() for c in channels}
ALWAYS |= {f"combined.{c}" for c in "RGB"}
"""Channels that every view has."""
COPIES = ("visible.parquet", "manifest.json")
"""Files that only packed copies and exports of a dataset have."""
MOST_RECORD = 1 << 25
"""Bytes of a record; that of a scene with a hundred views takes a megabyte or two."""


@dataclass(frozen=True)
class ViewData:
    """All that is stored of one view.

    lights: names, in layer order; variants: `all`, `without_<object>`, `foreground_<object>` →
    (L, H, W, 3) float32 linear radiance; coverage: object → (H, W) float32 in [0, 1]; combined (H, W, 3);
    raw: the variants before denoising under the same names, where they were kept.
    """

    lights: tuple[str, ...]
    variants: Mapping[str, Float32]
    coverage: Mapping[str, Float32]
    geometry: GeometryBuffers
    combined: Float32 = field(repr=False)
    raw: Mapping[str, Float32] = field(default_factory=dict, repr=False)


def scene_dir(root: Path, index: int) -> Path:
    """Return a scene's folder."""
    return root / scene_folder(index)


def file_inside(folder: Path, name: str) -> Path:
    """Return the path of a file that a record names; raises `StoreError` where it would lie outside of the folder."""
    try:
        return inside(folder, name)
    except OutsideError as error:
        raise StoreError(f"{folder}: {error}") from None


def scene_folder(index: int) -> str:
    """Return the name of a scene's folder inside its dataset."""
    return f"scenes/{index:06d}"


def scene_number(name: str) -> int | None:
    """Return the index of the scene whose folder has this name; None where that is no scene's."""
    return int(name) if re.fullmatch("[0-9]{6,9}", name) and f"{int(name):06d}" == name else None


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with write_whole(path) as work:
        work.write_text(text, encoding="utf-8")


def file_sha256(path: Path) -> str:
    """Hash a file's bytes (64 hex digits)."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_view(path: Path, view: ViewData) -> None:
    """Write one view as a multi-part OpenEXR file; radiance as half float, or float where half would overflow."""
    parts = []
    for prefix, variants in (("", view.variants), (RAW, view.raw)):
        for variant in variants:
            layers = zip(view.lights, stored_layers(variants, variant), strict=True)
            named = (_named(f"{prefix}{variant}.{light}", planes) for light, planes in layers)
            parts.append(_part(prefix + variant, named))
    parts.append(_part("combined", [_named("combined", in_planes(view.combined))]))
    buffers = [
        _named(name, planes_of(getattr(view.geometry, name).astype(kind)), channels)
        for name, (channels, kind, _) in GEOMETRY.items()
    ]
    coverage = [_named(f"coverage_{name}", [alpha.astype(np.float16)], "A") for name, alpha in view.coverage.items()]
    parts.append(_part("geometry", buffers + coverage))
    path.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(parts).write(str(path))
    for variants in (view.variants, view.raw):
        if isinstance(variants, Halves):
            variants.rest()


def write_exr(path: Path, channels: Mapping[str, NDArray[np.generic]]) -> None:
    """Write one picture as an OpenEXR file of one part: channels (H, W), or `RGB` (H, W, 3)."""
    planes = {name: np.ascontiguousarray(plane) for name, plane in channels.items()}
    OpenEXR.File(dict(HEADER), planes).write(str(path))


def read_view(path: Path, stated: tuple[SceneRecord, int] | None = None, *, compact: bool = False) -> ViewData:
    """Read one view back; raises `StoreError` naming the file where it is missing, truncated or foreign.

    `stated` are a scene's record and the number of the view, where the file is to be held to them before anything is
    decoded. `compact`: layers stay as they were read until they are asked for.
    """
    if not path.is_file():
        raise StoreError(f"{path} is missing")
    if stated is not None:
        check_header(path, *stated)
    channels = _read_channels(path)
    groups: dict[str, dict[str, None]] = {}
    for name in channels:
        variant, _, rest = name.partition(".")
        if rest.count(".") == 1:
            groups.setdefault(variant, {})[rest.split(".")[0]] = None
    try:
        lights = tuple(sorted(groups[ALL]))
        stored = {part: [[channels[f"{part}.{light}.{c}"] for c in "RGB"] for light in lights] for part in groups}
        variants = Halves({part: layers for part, layers in stored.items() if not part.startswith(RAW)})
        raw = Halves({part.removeprefix(RAW): layers for part, layers in stored.items() if part.startswith(RAW)})
        return ViewData(
            lights=lights,
            variants=variants if compact else dict(variants),
            coverage={
                name.removeprefix("coverage_").removesuffix(".A"): channels[name].astype(np.float32)
                for name in channels
                if name.startswith("coverage_")
            },
            geometry=GeometryBuffers(
                **{name: _joined(channels, name, of, kind) for name, (of, _, kind) in GEOMETRY.items()}
            ),
            combined=_joined(channels, "combined"),
            raw=raw if compact else dict(raw),
        )
    except KeyError as error:
        raise StoreError(f"{path}: channel {error} is missing; damaged, or not a view of this layout") from None


def read_scene(folder: Path) -> SceneRecord:
    """Read `scene.json` of a scene's folder; raises `StoreError` naming the file and the reason."""
    return parse_scene(find_place(folder).read("scene.json", MOST_RECORD), str(folder / "scene.json"))


def read_dataset(root: Path) -> DatasetRecord:
    """Read `dataset.json`; raises `StoreError` naming the file and the reason."""
    return parse_dataset(find_place(root).read("dataset.json", MOST_RECORD), str(root / "dataset.json"))


def parse_scene(content: bytes, name: str) -> SceneRecord:
    """Understand the content of a `scene.json`; raises `StoreError` with `name` and the reason."""
    record = _parse(content, name, SceneRecord)
    if fault := next(record.contradictions(), ""):
        raise StoreError(f"{name} contradicts itself: {fault}")
    return record


def parse_dataset(content: bytes, name: str) -> DatasetRecord:
    """Understand the content of a `dataset.json`; raises `StoreError` with `name` and the reason."""
    return _parse(content, name, DatasetRecord)


def scene_indices(root: Path) -> list[int]:
    """List the finished scenes of a dataset in order."""
    folder = root / "scenes"
    if not folder.is_dir():
        return []
    found = ((scene_number(p.name), p) for p in folder.iterdir() if not p.is_symlink())
    return sorted(number for number, p in found if number is not None and (p / "scene.json").is_file())


def _parse(content: bytes, name: str, kind: type[_Record]) -> _Record:
    try:
        return kind.from_json(content.decode())
    except UnicodeDecodeError as error:
        raise StoreError(f"{name} cannot be read: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        told = first["msg"].removeprefix("Value error, ")
        raise StoreError(f"{name} is damaged or of another version: {key or 'content'}: {told}") from None


def _named(prefix: str, planes: Planes, channels: Sequence[str] = "RGB") -> Channels:
    return {f"{prefix}.{c}": plane for c, plane in zip(channels, planes, strict=True)}


def _part(name: str, groups: Iterable[Channels]) -> OpenEXR.Part:
    return OpenEXR.Part(dict(HEADER), {name: plane for group in groups for name, plane in group.items()}, name)


def check_header(path: Path, record: SceneRecord, number: int) -> None:
    """Hold a view's file to its scene's record before any pixel is decoded: size, parts and channels.

    Raises `StoreError` naming what differs.
    """
    view, header = record.views[number], _header(path)
    names = record.scene.insertable
    layers = {f"{variant}.{light}.{c}" for variant in variants_of(names) for light in record.rig.names for c in "RGB"}
    wanted = layers | {f"coverage_{name}.A" for name in names} | ALWAYS
    found = set(header)
    if any(RAW + name in found for name in layers):
        wanted |= {RAW + name for name in layers}
    if found != wanted:
        lacks = sorted(wanted - found)
        told = f"lacks the channel {lacks[0]!r}" if lacks else f"has a channel {min(found - wanted)!r} of nothing there"
        raise StoreError(f"{path} {told}; damaged, or not the view that scene.json states")
    if sizes := sorted({size for size in header.values() if size != (view.width, view.height)}):
        raise StoreError(
            f"{path} is {sizes[0][0]} x {sizes[0][1]} pixels, scene.json states {view.width} x {view.height}"
        )


def _header(path: Path) -> dict[str, tuple[int, int]]:
    """Return the width and height of each channel as a file's headers state them."""
    found: dict[str, tuple[int, int]] = {}
    try:
        for part in OpenEXR.File(str(path), header_only=True).parts:
            low, high = part.header["dataWindow"]
            width, height = (int(side) for side in np.subtract(high, low, dtype=np.int64) + 1)
            for channel in part.header["channels"]:
                found[channel.name] = width // channel.xSampling, height // channel.ySampling
    except Exception as error:  # the binding raises bare RuntimeError and others for damaged files
        raise StoreError(f"{path} cannot be decoded (truncated or damaged): {error}") from None
    return found


def _read_channels(path: Path) -> Channels:
    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        pixels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    except Exception as error:  # the binding raises bare RuntimeError and others for damaged files
        raise StoreError(f"{path} cannot be decoded (truncated or damaged): {error}") from None
    # Of parts that it cannot decode the binding only prints a warning, and leaves them out.
    if [part.part_index for part in parts] != list(range(len(parts))):
        raise StoreError(f"{path} cannot be decoded (truncated or damaged): parts of it are lost")
    return pixels


def _joined(found: Channels, prefix: str, channels: Sequence[str] = "RGB", kind: Any = np.float32) -> NDArray[Any]:
    planes = [found[f"{prefix}.{c}"] for c in channels]
    return (planes[0] if len(planes) == 1 else np.stack(planes, axis=-1)).astype(kind)
