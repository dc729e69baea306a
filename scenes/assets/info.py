"""What is known of an asset, and the one error that asset code raises."""

from dataclasses import dataclass
from json import JSONDecodeError
from pathlib import Path
from typing import Literal

from multilight.scenes.errors import MultilightError

AssetRole = Literal["object", "table", "surrounding", "environment", "texture"]


class AssetError(MultilightError):
    """An asset is missing or broken: names the asset, the file and the remedy."""


def unreadable(path: Path, error: Exception) -> AssetError:
    """Say of a file that a library stumbled over what is wrong, where the library's words are for people."""
    said = (str(error).strip().splitlines() or [""])[-1].strip()
    if isinstance(error, OSError) and error.filename:
        said = f"{error.filename}: {error.strerror}"
    elif isinstance(error, UnicodeDecodeError | JSONDecodeError) or not isinstance(error, ValueError) or not said:
        said = "it is damaged, or not what its name says"
    return AssetError(f"{path} cannot be read: {said}; export it again")


@dataclass(frozen=True)
class AssetInfo:
    """What is known of an asset without opening it.

    `category` is a word such as `mug`, `wood` or `indoor`. `size` (x, y, z) is in metres: a model's extent, or
    the stretch (x, y, 0) that one repeat of a texture covers. `place` names the real place of an environment
    map (splits go by place). `emissive_part` names the mesh part that may glow. `normal_map` is the id of the
    tangent-space normal map that goes with a texture (resolved by `AssetLibrary.texture_path`, +Y up), and
    `roughness_map` that of its roughness map, whose mean is `scenes.assets.derived_maps.MEAN_ROUGHNESS`. What is
    `as_made`, by a user, is not varied by scenes; its roughness and metallic maps hold the values themselves.
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
    emissive_part: str | None = None
    normal_map: str | None = None
    roughness_map: str | None = None
    metallic_map: str | None = None
    as_made: bool = False
