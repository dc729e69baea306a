"""What a file of any format comes down to: nodes of triangles, its lights, an account of the rest; metres, Z-up.

Textures are named `texture-<digest>`, maps of skies `sky-<digest>`, by what they hold; a pack puts its name in front.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from PIL import Image
from pydantic import Field

from multilight.scenes.assets.cache import write_once
from multilight.scenes.assets.formats.cleaning import RawPart
from multilight.scenes.frozen import Frozen, Matrix4, Rgb, Slug
from multilight.scenes.spec import Material, Texture

KeepImage = Callable[[Image.Image], Texture]
"""Stores a picture and returns the texture that stands for it."""

EMISSION_NITS = 200.0
"""Luminance [cd/m²] of emission 1 where a file does not say how strong it is: a screen's white."""
Unit = Literal["cd", "lx", "nit", "W/sr", "W/m2", "W/(m2 sr)"]


class FoundLight(Frozen):
    """A light of a scene file, in the file's own unit: `amount` is its colour (linear Rec.709) times its strength.

    `pose` is rigid; lights with a direction shine along its -Z. `kind` says which of the other fields count: point
    (radius, `profile` about its -Z as in `lights.spec`), spot (half_angle [rad], blend, radius), sun (angle [rad], its
    diameter), area (width, height [m], `ellipse`), environment (`map`: an asset id, or uniform; `rotation` as in
    `lights.spec`), emissive (`node` and the number of its `part`; `texture` multiplies).
    """

    kind: Literal["point", "spot", "sun", "area", "environment", "emissive"]
    name: str
    amount: Rgb
    unit: Unit
    pose: Matrix4 = ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    radius: Annotated[float, Field(ge=0)] = 0.0
    profile: tuple[Annotated[float, Field(ge=0, le=1)], ...] | None = Field(default=None, min_length=2)
    half_angle: Annotated[float, Field(gt=0, lt=1.5708)] = 0.7854
    blend: Annotated[float, Field(ge=0, le=1)] = 0.0
    angle: Annotated[float, Field(ge=0)] = 0.0
    width: Annotated[float, Field(ge=0)] = 0.0
    height: Annotated[float, Field(ge=0)] = 0.0
    ellipse: bool = False
    map: str | None = None
    rotation: float = 0.0
    node: Slug | None = None
    part: Annotated[int, Field(ge=0)] = 0
    texture: Texture | None = None


class Emission(Frozen):
    """That a part glows: with the luminance `amount` [cd/m²] by channel, times the texture if any."""

    amount: Rgb
    texture: Texture | None = None


@dataclass(frozen=True)
class Node:
    """A thing of the file: its triangles by material in the file's world, and what of each part glows."""

    name: str
    parts: tuple[RawPart, ...]
    emissions: tuple[Emission | None, ...]


class Note(Frozen):
    """What a file states and is not carried: where, what, what happens instead, and what its maker can do."""

    place: str
    feature: str
    instead: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.place}: {self.feature}; {self.instead}; {self.remedy}"


@dataclass(frozen=True)
class Imported:
    """All that was read of a file; `credits` has author, copyright, license, source and title, where it states them."""

    nodes: tuple[Node, ...]
    lights: tuple[FoundLight, ...] = ()
    notes: tuple[Note, ...] = ()
    credits: dict[str, str] = field(default_factory=dict)


class _Part(Frozen):
    material: Material
    emission: Emission | None


class _Node(Frozen):
    name: str
    parts: tuple[_Part, ...]


class Record(Frozen):
    """The part of `Imported` that is kept as JSON, and what it was made of.

    `files` are those that the file refers to, relative to its folder, with the hash of their content (None: missing);
    `error` is why it could not be read, with `{file}` for its path and `{folder}` for the folder that holds it.
    """

    files: dict[str, str | None] = Field(default_factory=dict)
    error: str | None = None
    nodes: tuple[_Node, ...] = ()
    lights: tuple[FoundLight, ...] = ()
    notes: tuple[Note, ...] = ()
    credits: dict[str, str] = Field(default_factory=dict)


RECORD, ARRAYS = "record.json", "arrays.npz"
_ARRAYS = ("vertices", "faces", "normals", "uv", "colors")


def save_import(found: Imported, files: dict[str, str | None], folder: Path) -> None:
    """Write what was read of a file into a folder."""
    arrays = {}
    for n, node in enumerate(found.nodes):
        for p, part in enumerate(node.parts):
            for name in _ARRAYS:
                if (array := getattr(part, name)) is not None:
                    arrays[f"{n}.{p}.{name}"] = array.astype(np.int32 if name == "faces" else np.float32)
    np.savez(folder / ARRAYS, **arrays)
    nodes = (
        _Node(
            name=node.name,
            parts=tuple(
                _Part(material=part.material, emission=emission)
                for part, emission in zip(node.parts, node.emissions, strict=True)
            ),
        )
        for node in found.nodes
    )
    record = Record(files=files, nodes=tuple(nodes), lights=found.lights, notes=found.notes, credits=found.credits)
    (folder / RECORD).write_text(record.canonical_json(), encoding="utf-8")


def load_import(folder: Path, record: Record) -> Imported:
    """Read what `save_import` wrote."""
    nodes = []
    with (folder / ARRAYS).open("rb") as file:
        data = np.load(file, allow_pickle=False)
        for n, node in enumerate(record.nodes):
            parts = []
            for p, part in enumerate(node.parts):
                found = {name: data[f"{n}.{p}.{name}"] for name in _ARRAYS if f"{n}.{p}.{name}" in data}
                real = {name: array.astype(np.float64) for name, array in found.items() if name != "faces"}
                faces = found["faces"].astype(np.int64)
                parts.append(RawPart(**({"normals": None, "uv": None} | real), material=part.material, faces=faces))
            nodes.append(Node(node.name, tuple(parts), tuple(part.emission for part in node.parts)))
    return Imported(tuple(nodes), record.lights, record.notes, record.credits)


def image_digest(image: Image.Image) -> str:
    """Hash the pixels of a picture (32 hex digits)."""
    return hashlib.sha256(f"{image.mode} {image.size}".encode() + image.tobytes()).hexdigest()[:32]


def keep_picture(image: Image.Image, folder: Path) -> Texture:
    """Write a picture as PNG into `folder`, once; its texture is named by the digest of its pixels."""
    name = f"texture-{image_digest(image)}"
    write_once(folder / f"{name}.png", image.save)
    return Texture(image=name)
