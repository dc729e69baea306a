"""The one place that finds, loads and lists assets by id (`pack/name`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scenes.meshes import Mesh

AssetRole = Literal["object", "table", "environment", "texture"]


class AssetError(RuntimeError):
    """An asset is missing or broken: names the asset, the file and the remedy."""


@dataclass(frozen=True)
class AssetInfo:
    """What is known of an asset without opening it.

    `category` is a word such as `mug`, `wood` or `indoor`; `size` (x, y, z) is in metres, for models;
    `place` names the real place of an environment map (splits go by place).
    """

    id: str
    pack: str
    role: AssetRole
    name: str
    category: str
    licence: str
    creator: str
    size: tuple[float, float, float] | None = None
    place: str | None = None


class AssetLibrary:
    """All installed assets, in a fixed order.

    `cache` holds fetched packs and converted meshes (default: `$MULTILIGHT_CACHE`, else `~/.cache/multilight`).
    """

    def __init__(self, cache: Path | None = None, packs: tuple[str, ...] | None = None) -> None:
        raise NotImplementedError

    def list(self, role: AssetRole) -> tuple[AssetInfo, ...]:
        """List the installed assets of a role, sorted by id."""
        raise NotImplementedError

    def info(self, asset: str) -> AssetInfo:
        """Return what is known of an asset; raises `AssetError` with the command that fetches its pack."""
        raise NotImplementedError

    def mesh(self, asset: str) -> Mesh:
        """Load a model (from the converted cache where possible); raises `AssetError` naming the broken file."""
        raise NotImplementedError

    def texture_path(self, image: str) -> Path:
        """Return the PNG or JPEG file of a texture, made on first use where it is procedural."""
        raise NotImplementedError

    def environment_path(self, environment: str) -> Path:
        """Return the equirectangular EXR file (float or half, linear Rec.709) of an environment map."""
        raise NotImplementedError
