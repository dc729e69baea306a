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
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from pydantic import ValidationError

from datagen.errors import StoreError
from datagen.layers import Float32, GeometryBuffers
from datagen.records import DatasetRecord, SceneRecord
from scenes.inside import OutsideError, held, inside
from scenes.whole import write_whole

_Record = TypeVar("_Record", SceneRecord, DatasetRecord)
COMPRESSION = OpenEXR.ZIP_COMPRESSION
HALF_MAX = 65504.0
RAW = "raw_"


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
    return root / "scenes" / f"{index:06d}"


def view_file(view: int) -> str:
    """Return a view's file name inside its scene's folder."""
    return f"views/{view:02d}.exr"


def file_inside(folder: Path, name: str) -> Path:
    """Return the path of a file that a record names; raises `StoreError` where it would lie outside of the folder."""
    try:
        return inside(folder, name)
    except OutsideError as error:
        raise StoreError(f"{folder}: {error}") from None


def check_links(root: Path) -> None:
    """Raise `StoreError` where something in a dataset's folder is a link that leads out of it, so writing would too."""
    for path in (*root.iterdir(), *root.glob("scenes/*")):
        try:
            held(root, path)
        except OutsideError as error:
            raise StoreError(f"{error}; remove the link") from None


def write_text(path: Path, text: str) -> None:
    """Write a text file, whole or not at all."""
    with write_whole(path) as work:
        work.write_text(text)


def file_sha256(path: Path) -> str:
    """Hash a file's bytes (64 hex digits)."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_view(path: Path, view: ViewData) -> None:
    """Write one view as a multi-part OpenEXR file; radiance as half float, or float where half would overflow."""
    stored = dict(view.variants) | {RAW + variant: layers for variant, layers in view.raw.items()}
    parts = [_layers_part(part, view.lights, layers) for part, layers in stored.items()]
    parts.append(_part("combined", _color_channels("combined", _radiance(view.combined))))
    parts.append(_part("geometry", _geometry_channels(view.geometry, view.coverage)))
    path.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(parts).write(str(path))


def read_view(path: Path) -> ViewData:
    """Read one view back; raises `StoreError` naming the file where it is missing, truncated or foreign."""
    channels = _read_channels(path)
    groups: dict[str, dict[str, None]] = {}
    for name in channels:
        variant, _, rest = name.partition(".")
        if rest.count(".") == 1:
            groups.setdefault(variant, {})[rest.split(".")[0]] = None
    try:
        lights = tuple(sorted(groups["all"]))
        stored = {part: np.stack([_color(channels, f"{part}.{light}") for light in lights]) for part in groups}
        return ViewData(
            lights=lights,
            variants={part: layers for part, layers in stored.items() if not part.startswith(RAW)},
            coverage={
                name[len("coverage_") : -2]: channels[name].astype(np.float32)
                for name in channels
                if name.startswith("coverage_")
            },
            geometry=_geometry(channels),
            combined=_color(channels, "combined"),
            raw={part[len(RAW) :]: layers for part, layers in stored.items() if part.startswith(RAW)},
        )
    except KeyError as error:
        raise StoreError(f"{path}: channel {error} is missing; damaged, or not a view of this layout") from None


def read_scene(folder: Path) -> SceneRecord:
    """Read `scene.json` of a scene's folder; raises `StoreError` naming the file and the reason."""
    return parse_scene(_read_bytes(file_inside(folder, "scene.json")), str(folder / "scene.json"))


def read_dataset(root: Path) -> DatasetRecord:
    """Read `dataset.json`; raises `StoreError` naming the file and the reason."""
    return parse_dataset(_read_bytes(file_inside(root, "dataset.json")), str(root / "dataset.json"))


def parse_scene(content: bytes, name: str) -> SceneRecord:
    """Understand the content of a `scene.json`; raises `StoreError` with `name` and the reason."""
    return _parse(content, name, SceneRecord)


def parse_dataset(content: bytes, name: str) -> DatasetRecord:
    """Understand the content of a `dataset.json`; raises `StoreError` with `name` and the reason."""
    return _parse(content, name, DatasetRecord)


def scene_indices(root: Path) -> list[int]:
    """List the finished scenes of a dataset in order."""
    folder = root / "scenes"
    if not folder.is_dir():
        return []
    return sorted(
        int(p.name)
        for p in folder.iterdir()
        if re.fullmatch("[0-9]{6,}", p.name) and not p.is_symlink() and (p / "scene.json").is_file()
    )


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise StoreError(f"{path} is missing: not a dataset, or not finished") from None
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error}") from None


def _parse(content: bytes, name: str, kind: type[_Record]) -> _Record:
    try:
        return kind.from_json(content.decode())
    except UnicodeDecodeError as error:
        raise StoreError(f"{name} cannot be read: {error}") from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise StoreError(f"{name} is damaged or of another version: {key or 'content'}: {first['msg']}") from None


def as_stored(layers: Float32) -> Float32:
    """Return (L, H, W, 3) radiance as it reads back: each layer in half precision, or as it is where that overflows."""
    return np.stack([_radiance(layer).astype(np.float32) for layer in layers])


def _radiance(values: Float32) -> NDArray[np.floating]:
    return values.astype(np.float16) if float(values.max(initial=0.0)) <= HALF_MAX else values


def _color_channels(prefix: str, image: NDArray[np.floating]) -> dict[str, NDArray[np.generic]]:
    return {f"{prefix}.{c}": np.ascontiguousarray(image[..., i]) for i, c in enumerate("RGB")}


def _part(name: str, channels: Mapping[str, NDArray[np.generic]]) -> OpenEXR.Part:
    header = {"compression": COMPRESSION, "type": OpenEXR.scanlineimage}
    return OpenEXR.Part(header, dict(channels), name)


def _layers_part(variant: str, lights: tuple[str, ...], layers: Float32) -> OpenEXR.Part:
    channels: dict[str, NDArray[np.generic]] = {}
    for light, layer in zip(lights, layers, strict=True):
        channels |= _color_channels(f"{variant}.{light}", _radiance(layer))
    return _part(variant, channels)


def _geometry_channels(geometry: GeometryBuffers, coverage: Mapping[str, Float32]) -> dict[str, NDArray[np.generic]]:
    half = np.float16
    return {
        "z_depth.Z": geometry.z_depth.astype(np.float32),
        **{
            f"normal_world.{c}": np.ascontiguousarray(geometry.normal_world[..., i], dtype=half)
            for i, c in enumerate("XYZ")
        },
        **_color_channels("albedo", geometry.albedo.astype(half)),
        "roughness.Y": geometry.roughness.astype(half),
        "metallic.Y": geometry.metallic.astype(half),
        "instance_id.ID": geometry.instance_id.astype(np.uint32),
        "environment.A": geometry.environment.astype(half),
        **{f"coverage_{name}.A": alpha.astype(half) for name, alpha in coverage.items()},
    }


def _read_channels(path: Path) -> dict[str, NDArray[np.generic]]:
    if not path.is_file():
        raise StoreError(f"{path} is missing")
    try:
        parts = OpenEXR.File(str(path), separate_channels=True).parts
        pixels = {name: channel.pixels for part in parts for name, channel in part.channels.items()}
    except Exception as error:  # the binding raises bare RuntimeError and others for damaged files
        raise StoreError(f"{path} cannot be decoded (truncated or damaged): {error}") from None
    # Of parts that it cannot decode the binding only prints a warning, and leaves them out.
    if [part.part_index for part in parts] != list(range(len(parts))):
        raise StoreError(f"{path} cannot be decoded (truncated or damaged): parts of it are lost")
    return pixels


def _color(channels: Mapping[str, NDArray[np.generic]], prefix: str) -> Float32:
    return np.stack([channels[f"{prefix}.{c}"] for c in "RGB"], axis=-1).astype(np.float32)


def _geometry(channels: Mapping[str, NDArray[np.generic]]) -> GeometryBuffers:
    return GeometryBuffers(
        z_depth=channels["z_depth.Z"].astype(np.float32),
        normal_world=np.stack([channels[f"normal_world.{c}"] for c in "XYZ"], axis=-1).astype(np.float32),
        albedo=_color(channels, "albedo"),
        roughness=channels["roughness.Y"].astype(np.float32),
        metallic=channels["metallic.Y"].astype(np.float32),
        instance_id=channels["instance_id.ID"].astype(np.uint16),
        environment=channels["environment.A"].astype(np.float32),
    )
