"""Texture packs: curated surface textures of Python packages, rotated so that wood grain runs along u."""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from multilight.scenes.assets.builtin.textures.surfaces import height_from_albedo, normal_map
from multilight.scenes.assets.cache import write_once
from multilight.scenes.assets.info import AssetError, AssetInfo
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.files.limits import open_picture

TABLE = Path(__file__).with_name("textures.csv")
LARGEST = 1024
RELIEF = {"brick": 6e-4, "concrete": 1e-4, "fabric": 1.5e-4, "metal": 1e-5, "plaster": 1.5e-4, "tiles": 1.5e-4}
"""Deviation [m] of the height guessed from a texture's brightness, by category; elsewhere 3e-5."""


@dataclass(frozen=True)
class SurfaceTexture:
    """One curated texture: its file in the package, metres a repeat, and whether to rotate it a quarter."""

    name: str
    member: str
    category: str
    metres: float
    turn: bool


def surface_textures(pack: str) -> tuple[SurfaceTexture, ...]:
    """List the curated textures of a pack."""
    with TABLE.open(encoding="utf-8", newline="") as table:
        return tuple(
            SurfaceTexture(row["id"], row["member"], row["category"], float(row["metres"]), row["turn"] == "1")
            for row in csv.DictReader(table)
            if row["pack"] == pack
        )


def convert_texture(data: bytes, texture: SurfaceTexture, path: Path) -> None:
    """Write a package's picture as an RGB PNG of at most 1024 pixels; raises `AssetError` where it is broken."""
    try:
        image = open_picture(io.BytesIO(data)).convert("RGB")
    except (OSError, ValueError, SyntaxError) as error:
        raise AssetError(f"{texture.member} is not a readable picture: {error}") from error
    if texture.turn:
        image = image.transpose(Image.Transpose.ROTATE_90)
    if max(image.size) > LARGEST:
        image = image.resize((min(image.width, LARGEST), min(image.height, LARGEST)), Image.Resampling.LANCZOS)
    image.save(path)


class SurfacePack(Pack):
    """A fetched texture pack; `folder` holds one PNG a texture."""

    def __init__(self, name: str, folder: Path, cache: Path, licence: str) -> None:
        self.name, self._folder, self._cache, self._licence = name, folder, cache, licence
        self._textures = {texture.name: texture for texture in surface_textures(name)}

    def infos(self) -> list[AssetInfo]:
        """List the textures that are there."""
        return [
            AssetInfo(
                id=f"{self.name}/{texture.name}",
                pack=self.name,
                role="texture",
                name=texture.name.replace("-", " "),
                category=texture.category,
                licence=self._licence,
                creator=f"{texture.member.partition('/')[0]} authors",
                size=(texture.metres, texture.metres, 0.0),
                normal_map=f"{self.name}/{texture.name}-normal",
            )
            for texture in self._textures.values()
            if (self._folder / f"{texture.name}.png").is_file()
        ]

    def texture(self, name: str) -> Path:
        """Return a texture's PNG, or with `-normal` its normal map's, guessed from brightness on first use."""
        texture = self._textures.get(name.removesuffix("-normal"))
        if texture is None:
            raise AssetError(f"no texture '{self.name}/{name}'; there are {', '.join(sorted(self._textures))}")
        source = self._folder / f"{texture.name}.png"
        if not source.is_file():
            raise AssetError(f"{source} is missing; run `multilight assets fetch {self.name}`")
        if not name.endswith("-normal"):
            return source

        def write(path: Path) -> None:
            with Image.open(source) as image:
                albedo = np.asarray(image.convert("RGB"))
            height = height_from_albedo(albedo, depth=RELIEF.get(texture.category, 3e-5))
            Image.fromarray(normal_map(height, metres=texture.metres)).save(path)

        return write_once(self._cache / "textures" / self.name / f"{name}.png", write)
