"""What a scene file of any format comes down to: nodes of triangles, and its lights; metres, Z-up."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from PIL import Image
from pydantic import Field

from multilight.scenes.assets.cache import write_once
from multilight.scenes.assets.formats.cleaning import RawPart
from multilight.scenes.frozen import Frozen, Matrix4, Rgb, Slug
from multilight.scenes.spec import Texture

KeepImage = Callable[[Image.Image], Texture]
"""Stores a picture and returns the texture that stands for it."""

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


@dataclass(frozen=True)
class Emission:
    """That a part glows: with the colour times strength `amount` in `unit`, times the texture if any."""

    amount: Rgb
    unit: Unit
    texture: Texture | None = None


@dataclass(frozen=True)
class Node:
    """A thing of the file: its triangles by material in the file's world, and what of each part glows."""

    name: str
    parts: tuple[RawPart, ...]
    emissions: tuple[Emission | None, ...]


@dataclass(frozen=True)
class Imported:
    """All that was read of a scene file."""

    nodes: tuple[Node, ...]
    lights: tuple[FoundLight, ...]


def image_digest(image: Image.Image) -> str:
    """Hash the pixels of a picture (32 hex digits)."""
    return hashlib.sha256(f"{image.mode} {image.size}".encode() + image.tobytes()).hexdigest()[:32]


def keep_picture(image: Image.Image, folder: Path) -> str:
    """Write a picture as PNG into `folder` under the digest of its pixels, which is returned; once."""
    known = image.mode in ("L", "RGB", "RGBA")
    picture = image if known else image.convert("RGBA" if "A" in image.mode else "RGB")
    digest = image_digest(picture)
    write_once(folder / f"{digest}.png", picture.save)
    return digest
