"""A user's folder of GLB, glTF or OBJ models as a pack, with an optional table `assets.csv`.

Columns of the table: `file` (relative to the folder) and, all optional, `id`, `role` (object or table),
`category`, `licence`, `metres_per_unit` (default 1), `up_axis` (Y or Z; default Y, as glTF prescribes). Without a
table every model under the folder is used. Base colour, roughness, metallic and normal maps are kept; emission is
ignored, since lights are given by the rig.
"""

import csv
import hashlib
import re
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from pydantic import TypeAdapter

from multilight.scenes.assets.cache import is_sound, kept, sources_key, write_json
from multilight.scenes.assets.formats import beside, claims, cleaning, gltf
from multilight.scenes.assets.formats.beside import load_scene
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, RawPart, clean_mesh, extent, transformed
from multilight.scenes.assets.formats.gltf import raw_part
from multilight.scenes.assets.formats.scene_file import keep_picture
from multilight.scenes.assets.info import AssetError, AssetInfo, unreadable
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.files.inside import OutsideError, held, plain_name
from multilight.scenes.meshes import Mesh
from multilight.scenes.names import slug
from multilight.scenes.spec import Texture

SUFFIXES = (".glb", ".gltf", ".obj")
_SIZE = TypeAdapter(tuple[float, float, float])
COLUMNS = ("file", "id", "role", "category", "licence", "metres_per_unit", "up_axis")


@dataclass(frozen=True)
class _Entry:
    """One model of the folder."""

    name: str
    file: str
    role: str = "object"
    category: str = "object"
    licence: str = "unknown"
    metres_per_unit: float = 1.0
    up_axis: str = "Y"


class FolderPack(Pack):
    """The models under `folder`; the pack carries the folder's name."""

    def __init__(self, folder: Path, cache: Path) -> None:
        if not folder.is_dir():
            raise AssetError(f"{folder} is not a folder")
        self._folder, self._cache = folder.resolve(), cache
        self._pictures = cache / "textures" / "folders"
        self.name = self._folder.name
        self._key = sources_key(__file__, beside.__file__, claims.__file__, gltf.__file__, cleaning.__file__)

    @cached_property
    def _entries(self) -> dict[str, _Entry]:
        table = self._folder / "assets.csv"
        entries = _read_table(table) if table.is_file() else _scan(self._folder)
        named: dict[str, _Entry] = {}
        for entry in entries:
            if entry.name in named:
                raise AssetError(f"{self._folder}: two models get the id {entry.name!r}; give ids in assets.csv")
            named[entry.name] = entry
        return named

    def infos(self) -> list[AssetInfo]:
        """List the models; each is opened once to measure it, later calls read that from the cache.

        Broken models are listed without a size, so that a check can name them.
        """
        return [self._info(entry) for entry in self._entries.values()]

    def _info(self, entry: _Entry) -> AssetInfo:
        index = self._cache / "index" / f"folder-{self.mesh_key(entry.name)}.json"

        def write(path: Path) -> None:
            low, high = self.mesh(entry.name).bounds().astype(float)
            write_json(path, [round(float(v), 5) for v in high - low])

        try:
            size = kept(index, lambda path: _SIZE.validate_json(path.read_bytes()), write)
        except AssetError:
            size = None
        return AssetInfo(
            id=f"{self.name}/{entry.name}",
            pack=self.name,
            role="table" if entry.role == "table" else "object",
            name=entry.name,
            category=entry.category,
            licence=entry.licence,
            creator=self.name,
            size=size,
        )

    def mesh_key(self, name: str) -> str:
        """Hash the code, the entry, and the file's size and time."""
        entry = self._entries[name]
        try:
            state = (self._folder / entry.file).stat()
            seen = f"{state.st_size} {state.st_mtime_ns}"
        except OSError:
            seen = "missing"
        text = f"{self._key} {self._folder} {seen} {sorted(asdict(entry).items())}"
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def mesh(self, name: str) -> Mesh:
        """Convert a model; raises `AssetError` naming the file and the reason."""
        entry = self._entries[name]
        path = self._folder / entry.file
        try:
            held(self._folder, path)
            parts = self._load(path)
            axes = Z_UP_FROM_Y_UP if entry.up_axis == "Y" else np.eye(3)
            parts = transformed(parts, axes * entry.metres_per_unit)
            mesh = clean_mesh(parts)
            low, high = extent(parts)
        except OutsideError as error:
            raise AssetError(f"{error}; put the file there itself") from None
        except AssetError:
            raise
        except Exception as error:  # trimesh raises whatever a broken file makes it stumble over
            raise unreadable(path, error) from error
        largest = float((high - low).max())
        if not 1e-3 < largest < 50:
            raise AssetError(
                f"{path} is {largest:.4g} m large, expected 0.001 to 50; set metres_per_unit in assets.csv"
            )
        return mesh

    def _load(self, path: Path) -> list[RawPart]:
        if not path.is_file():
            raise AssetError(f"{path} is missing")
        if path.suffix.lower() not in SUFFIXES:
            raise AssetError(f"{path} is not one of {', '.join(SUFFIXES)}")
        scene = load_scene(path, self._folder)
        meshes = [geometry for geometry in scene.dump() if isinstance(geometry, trimesh.Trimesh)]
        parts = [raw_part(mesh, self._texture) for mesh in meshes]
        if not parts:
            raise AssetError(f"{path} holds no triangles")
        return parts

    def _texture(self, image: Image.Image) -> Texture:
        """Keep a picture in the cache under the hash of its pixels."""
        return Texture(image=f"{self.name}/texture/{keep_picture(image, self._pictures)}")

    def texture(self, name: str) -> Path:
        """Return the PNG of a texture `texture/<hash>` that a model of this pack brought."""
        match = re.fullmatch(r"texture/([0-9a-f]{32})", name)
        path = self._pictures / f"{match[1]}.png" if match else None
        if path is None or not is_sound(path):
            raise AssetError(f"no texture '{self.name}/{name}'; load the model that uses it first")
        return path


def _name(text: str) -> str:
    return slug(text, "-") or "folder"


def _scan(folder: Path) -> list[_Entry]:
    files = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    relative = [path.relative_to(folder) for path in files]
    return [_Entry(_name(str(path.with_suffix(""))), str(path)) for path in relative]


def _read_table(table: Path) -> list[_Entry]:
    """Read `assets.csv`; raises `AssetError` naming the line and what is wrong with it."""
    try:
        with table.open(encoding="utf-8-sig", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise AssetError(f"{table} cannot be read: {error}") from error
    result = []
    for number, row in enumerate(rows, start=2):
        unknown = [key for key in row if key not in COLUMNS]
        if unknown or not row.get("file"):
            problem = f"has unknown columns {unknown}" if unknown else "names no file"
            raise AssetError(f"{table}, line {number}: {problem}; columns are {', '.join(COLUMNS)}")
        result.append(_entry({key: value.strip() for key, value in row.items() if value}, f"{table}, line {number}"))
    return result


def _entry(row: dict[str, str], where: str) -> _Entry:
    try:
        file = Path(plain_name(str(Path(row["file"]))))
    except OutsideError as error:
        raise AssetError(f"{where}: {error}; it must lie inside the folder") from None
    try:
        scale = float(row.get("metres_per_unit", "1"))
    except ValueError:
        scale = 0.0
    if not 0 < scale < 1e6:
        raise AssetError(f"{where}: metres_per_unit {row['metres_per_unit']!r} must be a number above 0")
    if row.get("up_axis", "Y").upper() not in ("Y", "Z"):
        raise AssetError(f"{where}: up_axis {row['up_axis']!r} must be Y or Z")
    if row.get("role", "object") not in ("object", "table"):
        raise AssetError(f"{where}: role {row['role']!r} must be object or table")
    return _Entry(
        name=_name(row.get("id", str(file.with_suffix("")))),
        file=str(file),
        role=row.get("role", "object"),
        category=row.get("category", "object"),
        licence=row.get("licence", "unknown"),
        metres_per_unit=scale,
        up_axis=row.get("up_axis", "Y").upper(),
    )
