"""The pack `sweethome3d`: models of the Sweet Home 3D furniture libraries, a curated part of them.

The libraries are ZIP files (`*.sh3f`) of OBJ models with a table of properties; ids, roles and categories come
from two tables beside this file: `sweethome3d.csv` (tables, and what stands on them) and `furniture.csv` (what
furnishes rooms). Sizes are those of the catalogue, in centimetres there: width along the file's X, height along its
Y, depth along its Z, after `modelRotation`.
"""

import csv
import hashlib
import io
import re
import zipfile
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path, PurePosixPath
from typing import Any, cast

import numpy as np
import trimesh
from PIL import Image, UnidentifiedImageError
from trimesh.exchange.obj import load_obj
from trimesh.geometry import triangulate_quads

from multilight.scenes.assets.cache import sources_key, write_once
from multilight.scenes.assets.fetch import LICENCES
from multilight.scenes.assets.formats import cleaning, mtl
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, RawPart, clean_mesh, extent, transformed
from multilight.scenes.assets.formats.mtl import MtlEntry, material_of, part_name
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.files.limits import read_member
from multilight.scenes.meshes import Mesh

TABLE = Path(__file__).with_name("sweethome3d.csv")
FURNITURE = Path(__file__).with_name("furniture.csv")
IDENTITY = "1 0 0 0 1 0 0 0 1"
TEXTURE_TYPES = (".jpg", ".jpeg", ".png")


@dataclass(frozen=True)
class _Model:
    """One curated model: its row of the table, the library it lies in, and the library's properties."""

    row: dict[str, str]
    archive: str
    properties: dict[str, str]

    def size(self) -> tuple[float, float, float]:
        """Width, depth and height in metres."""
        x, y, z = (float(self.properties[key]) / 100 for key in ("width", "depth", "height"))
        return x, y, z


class _ZipResolver:
    """Hands out the files beside a model inside a ZIP, and remembers the names that are not there."""

    def __init__(self, archive: zipfile.ZipFile, folder: PurePosixPath) -> None:
        self._archive, self._folder = archive, folder
        self._names = {name.lower(): name for name in archive.namelist()}
        self.missing: list[str] = []

    def locate(self, name: str) -> str | None:
        """Return the full path of a file in the ZIP; upper and lower case do not count."""
        return self._names.get(str(self._folder / name.strip().replace("\\", "/")).lower())

    def get(self, name: str) -> bytes:
        """Read a file."""
        path = self.locate(name)
        if path is None:
            self.missing.append(name)
            raise FileNotFoundError(name)
        return read_member(self._archive, path)

    __getitem__ = get


class SweetHome3dPack(Pack):
    """The curated models; `folder` holds the `*.sh3f` files."""

    name = "sweethome3d"

    def __init__(self, folder: Path, cache: Path) -> None:
        self._folder, self._cache = folder, cache
        code = (str(p) for p in (__file__, mtl.__file__, cleaning.__file__, TABLE, FURNITURE))
        self._key = sources_key(*code)

    @cached_property
    def _models(self) -> dict[str, _Model]:
        catalogue = {}
        for archive in sorted(LICENCES):
            for entry in _properties(self._folder / f"{archive}.sh3f"):
                catalogue[entry["id"]] = (archive, entry)
        rows = _rows(TABLE) + [row | {"role": "surrounding"} for row in _rows(FURNITURE)]
        return {row["id"]: _Model(row, *catalogue[row["model"]]) for row in rows if row["model"] in catalogue}

    def infos(self) -> list[AssetInfo]:
        """List the curated models that the installed libraries hold."""
        return [
            AssetInfo(
                id=f"{self.name}/{name}",
                pack=self.name,
                role=cast(AssetRole, model.row["role"]),
                name=model.properties["name"],
                category=model.row["category"],
                licence=LICENCES[model.archive],
                creator=model.properties.get("creator", model.archive),
                size=model.size(),
                emissive_part=model.row["emissive_part"] or None,
            )
            for name, model in self._models.items()
        ]

    def mesh_key(self, name: str) -> str:
        """Hash the code, the model's properties and the library's size."""
        model = self._models[name]
        library = (self._folder / f"{model.archive}.sh3f").stat().st_size
        return hashlib.sha256(f"{self._key} {library} {sorted(model.properties.items())}".encode()).hexdigest()

    def mesh(self, name: str) -> Mesh:
        """Convert a model; raises `AssetError` naming the file inside the library."""
        model = self._models[name]
        file = f"{model.archive}.sh3f:{model.properties['model']}"
        try:
            with zipfile.ZipFile(self._folder / f"{model.archive}.sh3f") as archive:
                parts = _read(archive, model)
            return clean_mesh(_to_size(parts, model))
        except (OSError, zipfile.BadZipFile, KeyError, ValueError, IndexError) as error:
            raise AssetError(f"model {self.name}/{name} is broken: {file}: {error}") from error

    def texture(self, name: str) -> Path:
        """Extract a texture `texture/<library>/<path in it>` into the cache and return its file."""
        match = re.fullmatch(r"texture/([A-Za-z0-9-]+)/(.+)", name)
        if match is None or match[1] not in LICENCES or PurePosixPath(match[2]).suffix.lower() not in TEXTURE_TYPES:
            raise AssetError(f"no texture '{self.name}/{name}'")
        target = self._cache / "textures" / self.name / match[1] / _flat(match[2])

        def write(path: Path) -> None:
            try:
                with zipfile.ZipFile(self._folder / f"{match[1]}.sh3f") as archive:
                    path.write_bytes(read_member(archive, match[2]))
            except (KeyError, ValueError, zipfile.BadZipFile) as error:
                raise AssetError(f"texture '{self.name}/{name}' is not in {match[1]}.sh3f") from error

        return write_once(target, write)


def _flat(path: str) -> str:
    """Name a file of the cache after a path inside a ZIP, without folders."""
    return f"{hashlib.sha256(path.encode()).hexdigest()[:8]}-{PurePosixPath(path).name.replace(' ', '_')}"


def _rows(table: Path) -> list[dict[str, str]]:
    """Read one of the curated tables."""
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@cache
def _properties(path: Path) -> tuple[dict[str, str], ...]:
    """Read a library's table of models; none where the file is not there."""
    if not path.is_file():
        return ()
    try:
        with zipfile.ZipFile(path) as archive:
            text = read_member(archive, "PluginFurnitureCatalog.properties").decode("latin-1")
    except (OSError, zipfile.BadZipFile, KeyError, ValueError) as error:
        raise AssetError(f"{path} is broken: {error}; run `multilight assets fetch sweethome3d`") from error
    entries: dict[str, dict[str, str]] = {}
    for key, number, value in re.findall(r"^(\w+)#(\d+)\s*=[ \t]*(.*?)\s*$", text, re.MULTILINE):
        entries.setdefault(number, {})[key] = re.sub(r"\\u([0-9a-fA-F]{4})", lambda code: chr(int(code[1], 16)), value)
    return tuple(entry for entry in entries.values() if {"id", "model", "width", "depth", "height"} <= set(entry))


def _read(archive: zipfile.ZipFile, model: _Model) -> list[RawPart]:
    """Load a model's triangles and materials, one part a material."""
    path = PurePosixPath(model.properties["model"].lstrip("/"))
    resolver = _ZipResolver(archive, path.parent)
    loaded = load_obj(io.BytesIO(read_member(archive, str(path))), resolver=resolver, group_material=True)
    if resolver.missing:
        raise ValueError(f"missing file {resolver.missing[0]}")
    return [_raw_part(geometry, resolver, model) for geometry in loaded["geometry"].values()]


def _raw_part(geometry: dict[str, Any], resolver: _ZipResolver, model: _Model) -> RawPart:
    visual = geometry.get("visual")
    uv = getattr(visual, "uv", None)
    material = getattr(visual, "material", None)
    values = {} if material is None else cast(dict[str, Any], material.kwargs)
    image = None if material is None else material.image
    texture, alpha = None, False
    if image is not None and uv is not None and "file_path" in image.info:
        located = resolver.locate(image.info["file_path"])
        texture, alpha = f"{SweetHome3dPack.name}/texture/{model.archive}/{located}", _has_alpha(image)
    entry = MtlEntry(
        name=part_name(str(getattr(material, "name", None) or "material")),
        diffuse=_colour(getattr(material, "diffuse", None)),
        shininess=_number(values.get("ns", getattr(material, "glossiness", None))),
        opacity=_number(values.get("d")) if _number(values.get("d")) is not None else 1.0,  # type: ignore[arg-type]
        texture=texture,
        texture_has_alpha=alpha,
    )
    faces = triangulate_quads(geometry["faces"])
    solid = trimesh.Trimesh(geometry["vertices"], faces, process=False)
    solid.merge_vertices(merge_tex=True, merge_norm=True)
    return RawPart(
        material_of(entry, category=model.row["category"], closed=bool(solid.is_watertight)),
        np.asarray(geometry["vertices"], np.float64),
        faces,
        geometry.get("vertex_normals"),
        None if uv is None else np.asarray(uv, np.float64),
    )


def _has_alpha(image: Image.Image) -> bool:
    """Tell whether a picture has see-through pixels."""
    try:
        if image.mode not in ("RGBA", "LA", "PA") and "transparency" not in image.info:
            return False
        low, _ = cast(tuple[int, int], image.convert("RGBA").getchannel("A").getextrema())
    except (OSError, UnidentifiedImageError) as error:
        raise ValueError(f"broken texture: {error}") from error
    return low < 250


def _colour(value: Any) -> tuple[float, float, float]:
    """Read a colour that trimesh holds as 0 to 255."""
    r, g, b = (float(v) / 255 for v in (value if value is not None else (200, 200, 200, 255))[:3])
    return r, g, b


def _number(value: Any) -> float | None:
    """Read a number that may stand alone or in a list of words."""
    try:
        return float(value[0] if isinstance(value, list | tuple) else value)
    except (TypeError, ValueError, IndexError):
        return None


def _to_size(parts: list[RawPart], model: _Model) -> list[RawPart]:
    """Rotate a model as the catalogue says, make it Z-up, and scale it to the catalogue's size."""
    rotation = np.array([float(v) for v in model.properties.get("modelRotation", IDENTITY).split()]).reshape(3, 3)
    parts = transformed(parts, Z_UP_FROM_Y_UP @ rotation)
    low, high = extent(parts)
    span = np.where(high - low > 1e-9, high - low, 1.0)
    return transformed(parts, np.diag(np.array(model.size()) / span))
