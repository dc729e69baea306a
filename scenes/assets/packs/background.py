"""A scene file as a pack: every node a model, so that it can stand in a `SceneSpec`; its lights are kept beside.

The file is read once; meshes and lights lie in the cache under the hash of its content.
"""

import re
import shutil
import uuid
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
from pydantic import TypeAdapter

from multilight.scenes.assets.cache import read_kept, sources_key, write_json
from multilight.scenes.assets.formats.cleaning import RawPart, clean_mesh, extent
from multilight.scenes.assets.formats.import_file import SUFFIXES, Intake
from multilight.scenes.assets.formats.imported import FoundLight, Imported, Node, Note
from multilight.scenes.assets.formats.mtl import part_name
from multilight.scenes.assets.info import AssetError, AssetInfo
from multilight.scenes.assets.packs import guesses
from multilight.scenes.assets.packs.folder import own_textures
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.frozen import Frozen, Matrix4, Slug
from multilight.scenes.meshes import Mesh, MeshPart, load_mesh, save_mesh
from multilight.scenes.names import free_name
from multilight.scenes.poses import matrix4, translation
from multilight.scenes.spec import Material

T = TypeVar("T")
SMALLEST, LARGEST = 0.3, 500.0
"""Longest side [m] of what may pass for a scene."""
MOST_NODES = 400
"""Nodes beyond the largest so many become one body."""
PACK = "background"


class Piece(Frozen):
    """One body of the background: its name, which is that of the model, its pose, and its size [m]."""

    name: Slug
    title: str
    world_from_body: Matrix4
    size: tuple[float, float, float]


class _Index(Frozen):
    pieces: tuple[Piece, ...]
    lights: tuple[FoundLight, ...]


class BackgroundPack(Pack):
    """The scene in `file` as the pack `background`; raises `AssetError` where it cannot serve."""

    name = PACK

    def __init__(self, file: Path, cache: Path) -> None:
        if not file.is_file():
            raise AssetError(
                f"background {file} does not exist; name a GLB, glTF, USD, .blend or other file with --background"
            )
        if file.suffix.lower() not in SUFFIXES:
            raise AssetError(f"background {file} is not one of {', '.join(SUFFIXES)}")
        self.path = self._file = file.resolve()
        self._cache, self._intake = cache, Intake(cache)

    @cached_property
    def _folder(self) -> Path:
        """Where the pieces lie: under the hash of what the file holds, and of the code."""
        key = f"{self._intake.key(self._file, self._file.parent)}-{sources_key(__file__)}"
        return self._cache / "backgrounds" / key

    @cached_property
    def _index(self) -> _Index:
        return self._kept("index.json", lambda file: TypeAdapter(_Index).validate_json(file.read_bytes()))

    def _kept(self, name: str, read: Callable[[Path], T]) -> T:
        """Read a file of the pieces; where it is missing or damaged, all are made (again)."""
        path = self._folder / name
        found = read_kept(path, read)
        if found is None:
            self._convert()
            found = read(path)
        return found

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """The bodies of the background, largest first."""
        return self._index.pieces

    @property
    def lights(self) -> tuple[FoundLight, ...]:
        """The lights of the file; an emissive one names a piece and a part of its mesh."""
        return self._index.lights

    def notes(self, name: str) -> tuple[Note, ...]:
        """Return the account of what the file states and is not carried."""
        return self._intake.record(self._file, self._file.parent).notes

    def _convert(self) -> None:
        """Read the file and write the pieces, under a temporary name first."""
        found = self._intake.read(self._file, self._file.parent)
        work = self._folder.with_name(f".{uuid.uuid4().hex}.tmp")
        try:
            work.mkdir(parents=True)
            index = _converted(self._file, found, work)
            write_json(work / "index.json", index.model_dump(mode="json"))
            self._folder.mkdir(exist_ok=True)
            # File by file: others may be reading those that are there; the index says that all are.
            for path in sorted(work.iterdir(), key=lambda path: path.name == "index.json"):
                path.replace(self._folder / path.name)
        except OSError as error:
            raise AssetError(
                f"cannot write {self._folder}: {error}; free some space or set MULTILIGHT_CACHE"
            ) from error
        finally:
            shutil.rmtree(work, ignore_errors=True)

    def infos(self) -> list[AssetInfo]:
        """List the bodies; converts the file on the first call."""
        licence, creator = guesses.credited(self._intake.record(self._file, self._file.parent).credits)
        licence, creator = licence or "unknown", creator or self._file.name
        return [
            AssetInfo(
                id=f"{PACK}/{piece.name}",
                pack=PACK,
                role="surrounding",
                name=piece.title,
                category="background",
                licence=licence,
                creator=creator,
                size=piece.size,
            )
            for piece in self.pieces
        ] + [
            AssetInfo(f"{PACK}/{light.map}", PACK, "environment", light.name, "background", licence, creator)
            for light in self.lights
            if light.map is not None
        ]

    def mesh_key(self, name: str) -> str:
        """Return the hash of the file's content."""
        return self._folder.name

    def mesh(self, name: str) -> Mesh:
        """Load the mesh of a body."""
        if name not in {piece.name for piece in self.pieces}:
            raise AssetError(f"{self._file} has no node {name!r}")
        return self._kept(f"{name}.npz", load_mesh)

    def texture(self, name: str) -> Path:
        """Return the PNG of a texture `texture-<hash>`."""
        path = self._picture(name) if re.fullmatch(r"texture-[0-9a-f]{32}", name) else None
        if path is None:
            raise AssetError(f"no texture '{PACK}/{name}' in {self._file}")
        return path

    def environment(self, name: str) -> Path:
        """Return the environment map that came with the file."""
        path = self._picture(name) if re.fullmatch(r"sky-[0-9a-f]{32}", name) else None
        if path is None:
            raise AssetError(f"no environment map '{PACK}/{name}' in {self._file}")
        return path

    def _picture(self, name: str) -> Path | None:
        return self._intake.picture(name, [(self._file, self._file.parent)])


def _converted(file: Path, found: Imported, work: Path) -> _Index:
    """Clean and write the meshes; raises `AssetError` where there are none or their size makes no sense."""
    nodes = [_joined(node) for node in found.nodes]
    nodes = [node for node in nodes if any(len(part.faces) for part in node.parts)]
    if not nodes:
        raise AssetError(f"{file} holds no triangles; export the scene with its meshes")
    if not all(np.isfinite(part.vertices).all() for node in nodes for part in node.parts):
        raise AssetError(f"{file} has coordinates that are not finite; repair the mesh and export it again")
    low, high = (np.stack(corner) for corner in zip(*(extent(_solid(node)) for node in nodes), strict=True))
    size = float((high.max(axis=0) - low.min(axis=0)).max())
    if not SMALLEST <= size <= LARGEST:
        raise AssetError(
            f"{file} is {size:.4g} m large, expected {SMALLEST:g} to {LARGEST:g}; export it again in metres"
        )
    order = np.argsort(-(high - low).max(axis=1).round(4), kind="stable")  # alike whatever format it came in
    ordered = [nodes[int(i)] for i in order]
    if len(ordered) > MOST_NODES:
        ordered = [*ordered[: MOST_NODES - 1], _merged(ordered[MOST_NODES - 1 :])]
    pieces, lights, taken = [], list(found.lights), set[str]()
    for node in ordered:
        name = free_name(node.name, taken, prefix="bg_", otherwise="node")
        written = _write_piece(node, name, work)
        if written is not None:
            taken.add(name)
            pieces.append(written[0])
            lights += written[1]
    return _Index(pieces=tuple(pieces), lights=tuple(lights))


def _solid(node: Node) -> list[RawPart]:
    return [part for part in node.parts if len(part.faces)]


def _joined(node: Node) -> Node:
    """Leave out parts without faces."""
    pairs = [(p, e) for p, e in zip(node.parts, node.emissions, strict=True) if len(p.faces)]
    return Node(node.name, tuple(p for p, _ in pairs), tuple(e for _, e in pairs))


def _merged(nodes: list[Node]) -> Node:
    """Make one node of many."""
    return Node("rest", sum((n.parts for n in nodes), ()), sum((n.emissions for n in nodes), ()))


def _write_piece(node: Node, name: str, work: Path) -> tuple[Piece, list[FoundLight]] | None:
    """Write a node's mesh; return its place and what of it glows, or None where only degenerate faces were in it."""
    low, high = extent(list(node.parts))
    marked = [
        replace(part, material=part.material.model_copy(update={"name": f"{i}"})) for i, part in enumerate(node.parts)
    ]
    try:
        mesh = clean_mesh(marked, turn_out=False)
    except ValueError:
        return None
    # Cleaning drops degenerate parts; the marks tell which are left.
    kept = [int(part.name) for part in mesh.parts]
    parts = tuple(_named(part, node.parts[i].material) for i, part in zip(kept, mesh.parts, strict=True))
    save_mesh(Mesh(parts), work / f"{name}.npz")
    pose = translation([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    x, y, z = (round(float(v), 5) for v in high - low)
    lights = [
        FoundLight(
            kind="emissive",
            name=name,
            amount=e.amount,
            unit="nit",
            node=name,
            part=number,
            texture=e.texture and e.texture.model_copy(update={"image": f"{PACK}/{e.texture.image}"}),
        )
        for number, e in enumerate(node.emissions[i] for i in kept)
        if e is not None
    ]
    return Piece(name=name, title=node.name[:80], world_from_body=matrix4(pose), size=(x, y, z)), lights


def _named(part: MeshPart, material: Material) -> MeshPart:
    """Give a part its material back, under a name that no rule for materials knows."""
    own = own_textures(material, PACK).model_copy(update={"name": part_name(f"bg-{material.name}")})
    return replace(part, name=own.name, material=own)
