"""A user's folder of models, skies and surfaces as a pack, with an optional table `assets.csv`.

Columns of the table: `file` (relative to the folder) and, all optional, `id`, `role` (object, table or surrounding),
`category`, `licence`, `metres_per_unit` (default 1), `up_axis` (Y or Z; default: what the format prescribes). Without
a table all under the folder is used: models, `.exr` and `.hdr` panoramas, and sets of pictures of a surface.
"""

import csv
import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image
from pydantic import TypeAdapter

from multilight.scenes.assets.cache import file_digest, kept, write_json, write_once
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, RawPart, clean_mesh, extent, transformed
from multilight.scenes.assets.formats.import_file import SKIES, SUFFIXES, Intake
from multilight.scenes.assets.formats.imported import Emission, Imported, Note
from multilight.scenes.assets.formats.pictures import as_eight_bit
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.packs import guesses
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.files.confined import OutsideError, held, plain_name
from multilight.scenes.meshes import Mesh
from multilight.scenes.spec import Material, Texture

_SIZE = TypeAdapter(tuple[float, float, float])
COLUMNS = ("file", "id", "role", "category", "licence", "metres_per_unit", "up_axis")
Z_UP = (".ply", ".stl", ".blend", ".usd", ".usda", ".usdc", ".usdz")
"""Formats that are Z-up, or say themselves what is up; the others are Y-up."""
UNITLESS = (".obj", ".ply", ".stl")
_PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".tga")
ROLES = ("object", "table", "surrounding")


@dataclass(frozen=True)
class _Entry:
    """One model or sky of the folder; what is None is guessed."""

    name: str
    file: Path
    home: Path
    role: str | None = None
    category: str | None = None
    licence: str | None = None
    metres_per_unit: float = 1.0
    up_axis: str | None = None


class FolderPack(Pack):
    """The models, skies and surfaces under `folder`, which may be one file; the pack carries its name."""

    def __init__(self, folder: Path, cache: Path) -> None:
        self._only = folder.resolve() if folder.is_file() and folder.suffix.lower() in (*SUFFIXES, *SKIES) else None
        if not folder.is_dir() and self._only is None:
            raise AssetError(f"{folder} is not a folder, nor a file of {', '.join((*SUFFIXES, *SKIES))}")
        self._folder, self._cache = folder.resolve() if self._only is None else self._only.parent, cache
        self.name = self._folder.name if self._only is None else self._only.stem
        self._intake = Intake(cache)

    @cached_property
    def _entries(self) -> dict[str, _Entry]:
        table = self._folder / "assets.csv"
        if self._only is not None:
            return _named([_Entry(guesses.named_id((self._only.stem,)), self._only, self._folder)])
        if table.is_file():
            named: dict[str, _Entry] = {}
            for entry in _read_table(table):
                if entry.name in named:
                    raise AssetError(f"{table}: two models get the id {entry.name!r}; give them others")
                named[entry.name] = entry
            return named
        return _named(_scan(self._folder))

    @cached_property
    def _surfaces(self) -> dict[str, dict[str, Path]]:
        """Sets of pictures by name: what each holds, and its file."""
        if self._only is not None or (self._folder / "assets.csv").is_file():
            return {}
        found: dict[str, dict[str, Path]] = {}
        for path, _ in _files(self._folder):
            kind = guesses.kind_of(path.stem) if path.suffix.lower() in _PICTURES else None
            if kind is not None and not guesses.of_a_model(path, self._folder):
                place = path.parent.relative_to(self._folder).parts
                found.setdefault(guesses.named_id((*place[:-1], kind[0])), {}).setdefault(kind[1], path)
        return {name: pictures for name, pictures in found.items() if "base" in pictures}

    def infos(self) -> list[AssetInfo]:
        """List what there is; models are converted to measure them, later calls read that from the cache.

        Broken models are listed without a size, so that a check can name them.
        """
        self._intake.convert((entry.file, entry.home) for entry in self._entries.values())
        return [self._info(entry) for entry in self._entries.values()] + [
            AssetInfo(
                id=f"{self.name}/{name}",
                pack=self.name,
                role="texture",
                name=name,
                category=guesses.surface_of(pictures["base"].stem),
                licence=guesses.licence_beside(pictures["base"], self._folder) or "unknown",
                creator=self.name,
                size=(1.0, 1.0, 0.0),
                normal_map=f"{self.name}/{name}#bend" if pictures.keys() & {"normal", "normal-dx"} else None,
                roughness_map=f"{self.name}/{name}#rough" if "roughness" in pictures else None,
                metallic_map=f"{self.name}/{name}#metallic" if "metallic" in pictures else None,
                as_made=True,
            )
            for name, pictures in self._surfaces.items()
        ]

    def _info(self, entry: _Entry) -> AssetInfo:
        said = self._intake.record(entry.file, entry.home).credits if entry.file.is_file() else {}
        words = f"{entry.name} {'/'.join(entry.file.relative_to(self._folder).parts[:-1])} {said.get('title', '')}"
        licence, creator = guesses.credited(said)
        category, size, role = entry.category or guesses.category_of(words), None, entry.role
        place = None
        if entry.file.suffix.lower() in SKIES:
            role, (category, place) = "environment", guesses.place_of(entry.file.stem)
            category = entry.category or category
        else:
            try:
                size = self._size(entry)
            except AssetError:
                size = None
            role = role or guesses.role_of(category, size)
        return AssetInfo(
            id=f"{self.name}/{entry.name}",
            pack=self.name,
            role=_role(role),
            name=entry.name,
            category=category or role or "object",
            licence=entry.licence or licence or guesses.licence_beside(entry.file, self._folder) or "unknown",
            creator=creator or self.name,
            size=size,
            place=place,
            as_made=True,
        )

    def _size(self, entry: _Entry) -> tuple[float, float, float]:
        index = self._cache / "index" / f"folder-{self.mesh_key(entry.name)}.json"

        def write(path: Path) -> None:
            low, high = extent(self._parts(entry))
            write_json(path, [round(float(v), 5) for v in high - low])

        return kept(index, lambda path: _SIZE.validate_json(path.read_bytes()), write)

    def content(self) -> str:
        """Hash names and contents of all files."""
        files = [self._only] if self._only is not None else (path for path, _ in _files(self._folder))
        lines = sorted(f"{path.relative_to(self._folder)} {file_digest(path)}" for path in files)
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def mesh_key(self, name: str) -> str:
        """Hash the code, the content of the file and of what it refers to, and how it is to be placed."""
        entry = self._entries[name]
        self._check(entry)
        placing = f"{entry.metres_per_unit:g}{entry.up_axis or ''}".replace(".", "_")
        return f"{self._intake.key(entry.file, entry.home)}-{placing}"

    def notes(self, name: str) -> tuple[Note, ...]:
        """Return the account of what a model's file states and is not carried."""
        entry = self._entries.get(name)
        if entry is None:
            return ()
        record = self._intake.record(entry.file, entry.home)
        if not record.lights or entry.file.suffix.lower() in SKIES:
            return record.notes
        what = f"{len(record.lights)} light(s)"
        instead, remedy = "a model is lit as its scene is", "set scenes in it with --background"
        return (*record.notes, Note(place="file", feature=what, instead=instead, remedy=remedy))

    def warnings(self, info: AssetInfo) -> Iterator[str]:
        """Say where a model is not of its category's usual size."""
        usual, largest = guesses.USUAL.get(info.category), max(info.size or (0.0,))
        suffix = self._entries[info.id.partition("/")[2]].file.suffix.lower()
        if usual is None and largest > guesses.LARGEST_OBJECT and suffix in UNITLESS:
            yield (
                f"is {largest:.4g} m large, where its format knows no unit; if it is in centimetres or "
                "millimetres, set metres_per_unit to 0.01 or 0.001 in assets.csv"
            )
        if usual is not None and info.size is not None and not usual[1] <= max(info.size) <= usual[2]:
            yield (
                f"is {max(info.size):.4g} m large, a {info.category} is usually {usual[1]:g} to {usual[2]:g}; "
                "set metres_per_unit, or another category, in assets.csv"
            )

    def mesh(self, name: str) -> Mesh:
        """Convert a model; raises `AssetError` naming the file and the reason."""
        entry = self._entries[name]
        parts = self._parts(entry)
        low, high = extent(parts)
        largest = float((high - low).max())
        if not 1e-3 < largest < 500:
            raise AssetError(
                f"{entry.file} is {largest:.4g} m large, expected 0.001 to 500; set metres_per_unit in assets.csv"
            )
        try:
            return clean_mesh(parts)
        except ValueError as error:
            raise AssetError(f"{entry.file} {error}; repair the mesh and export it again") from error

    def _check(self, entry: _Entry) -> None:
        try:
            held(entry.home, entry.file)
        except OutsideError as error:
            raise AssetError(f"{error}; put the file there itself") from None
        if entry.file.suffix.lower() not in (*SUFFIXES, *SKIES):
            raise AssetError(f"{entry.file} is not one of {', '.join((*SUFFIXES, *SKIES))}")

    def _imported(self, entry: _Entry) -> Imported:
        self._check(entry)
        return self._intake.read(entry.file, entry.home)

    def _parts(self, entry: _Entry) -> list[RawPart]:
        parts = [
            replace(part, material=self._own(part.material, emission))
            for node in self._imported(entry).nodes
            for part, emission in zip(node.parts, node.emissions, strict=True)
        ]
        if not any(len(part.faces) for part in parts):
            raise AssetError(f"{entry.file} holds no triangles; export it with its mesh")
        native = "Z" if entry.file.suffix.lower() in Z_UP else "Y"
        turn = {"YZ": Z_UP_FROM_Y_UP.T, "ZY": Z_UP_FROM_Y_UP}.get(native + (entry.up_axis or native), np.eye(3))
        return transformed(parts, turn * entry.metres_per_unit)

    def texture(self, name: str) -> Path:
        """Return the PNG of a texture `texture-<hash>` that a model of this pack brought, or of a surface's set."""
        surface, _, kind = name.partition("#")
        if surface in self._surfaces:
            return self._surface(self._surfaces[surface], kind)
        own = [(entry.file, entry.home) for entry in self._entries.values()]
        path = self._intake.picture(name, own) if re.fullmatch(r"texture-[0-9a-f]{32}", name) else None
        if path is None:
            raise AssetError(f"no texture '{self.name}/{name}'; no model of the folder has it")
        return path

    def environment(self, name: str) -> Path:
        """Return the EXR of a sky, checked and cleaned."""
        entry = self._entries[name]
        (sky,) = self._imported(entry).lights
        path = self._intake.picture(str(sky.map), [(entry.file, entry.home)])
        assert path is not None
        return path

    def _own(self, material: Material, emission: Emission | None) -> Material:
        """Name a material's textures as those of this pack, and let it give off what its file says."""
        glow = {} if emission is None else {"emission": emission.amount, "emission_texture": emission.texture}
        return own_textures(material.model_copy(update=glow), self.name)

    def _surface(self, pictures: dict[str, Path], kind: str) -> Path:
        """Return a picture of a surface in 8 bits, normals with +Y up."""
        kind = {"": "base", "bend": "normal", "rough": "roughness"}.get(kind, kind)
        directx = kind == "normal" and "normal" not in pictures
        source = pictures["normal-dx" if directx else kind]

        def write(path: Path) -> None:
            try:
                image = as_eight_bit(source).convert("RGB" if kind in ("base", "normal") else "L")
            except (OSError, ValueError, SyntaxError) as error:
                raise AssetError(f"{source} is not a readable picture ({error}); save it as PNG") from error
            if directx:
                red, green, blue = image.split()
                image = Image.merge("RGB", (red, green.point(lambda v: 255 - v), blue))
            image.save(path)

        return write_once(self._cache / "textures" / "surfaces" / f"{file_digest(source)}-{kind}.png", write)


def own_textures(material: Material, pack: str) -> Material:
    """Put the name of a pack in front of a material's textures."""
    named = {
        name: value.model_copy(update={"image": f"{pack}/{value.image}"})
        for name in type(material).model_fields
        if isinstance(value := getattr(material, name), Texture)
    }
    return material.model_copy(update=named)


def _role(text: str) -> AssetRole:
    return TypeAdapter(AssetRole).validate_python(text)


def _files(folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield all files under a folder, in order, with the folder that each may refer to files in.

    That is the folder itself, or a linked folder that it was found in; what links back is left out.
    """
    waiting, seen = [(folder, folder)], {folder.resolve()}
    while waiting:
        place, home = waiting.pop()
        for child in sorted(place.iterdir()):
            if child.name.startswith("."):
                continue
            if child.is_dir():
                linked = child.resolve()
                if linked not in seen and not folder.is_relative_to(linked):
                    seen.add(linked)
                    waiting.append((child, home if linked.is_relative_to(home.resolve()) else child))
            elif child.is_file():
                yield child, home


def _scan(folder: Path) -> list[_Entry]:
    """Find the models and skies under a folder; pictures of a surface, or of a model, are no skies."""
    found = []
    for path, home in _files(folder):
        suffix = path.suffix.lower()
        picture = guesses.kind_of(path.stem) or path.parent.name.lower() in guesses.PICTURE_FOLDERS
        if suffix in SUFFIXES or (suffix in SKIES and not picture):
            found.append(_Entry(guesses.named_id(path.relative_to(folder).with_suffix("").parts), path, home))
    return sorted(found, key=lambda entry: (entry.name, str(entry.file)))


def _named(entries: list[_Entry]) -> dict[str, _Entry]:
    """Give each its own name: of several files of one name, the later ones have their format, or a number, behind."""
    named: dict[str, _Entry] = {}
    for entry in entries:
        choices = [entry.name, f"{entry.name}-{entry.file.suffix[1:].lower()}"]
        choices += [f"{entry.name}-{number}" for number in range(2, len(entries) + 2)]
        name = next(choice for choice in choices if choice not in named)
        named[name] = replace(entry, name=name)
    return named


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
        given = {key: value.strip() for key, value in row.items() if value and value.strip()}
        result.append(_entry(given, f"{table}, line {number}", table.parent))
    return result


def _entry(row: dict[str, str], where: str, folder: Path) -> _Entry:
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
    if row.get("role", "object") not in ROLES:
        raise AssetError(f"{where}: role {row['role']!r} must be one of {', '.join(ROLES)}")
    return _Entry(
        name=guesses.named_id((row["id"],) if "id" in row else file.with_suffix("").parts),
        file=folder / file,
        home=folder,
        role=row.get("role"),
        category=row.get("category"),
        licence=row.get("licence"),
        metres_per_unit=scale,
        up_axis=row["up_axis"].upper() if "up_axis" in row else None,
    )
