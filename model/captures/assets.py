"""The object to insert: a model file of the user's, or one of the asset library, as triangles with their colour."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.datagen.errors import UserError
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.cache import default_cache
from multilight.scenes.assets.formats.cleaning import clean_mesh
from multilight.scenes.assets.formats.import_file import SUFFIXES, Intake
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.colour import srgb_decode
from multilight.scenes.files.limits import open_picture
from multilight.scenes.meshes import Mesh


@dataclass(frozen=True)
class Asset:
    """A mesh that stands on z = 0, centred in x and y, Z-up, in metres, and its textures (h, w, 3), linear, by id."""

    mesh: Mesh
    textures: dict[str, Float32]

    @property
    def size(self) -> Float64:
        """Return width, depth and height (3,) in metres."""
        low, high = self.mesh.bounds().astype(np.float64)
        return np.asarray(high - low)


def check_asset(name: str) -> None:
    """Raise `UserError` or `AssetError` where there is neither such a file nor such an asset of the library."""
    path = Path(name)
    if path.suffix.lower() in SUFFIXES:
        if not path.is_file():
            raise UserError(f"asset {path} does not exist")
    elif path.exists():
        raise UserError(f"asset {path} is not one of {', '.join(SUFFIXES)}")
    else:
        AssetLibrary().info(name)


def load_asset(name: str) -> Asset:
    """Load a model file of any format that is read, or an asset of the library by its id `pack/name`.

    Raises `UserError` naming the file and what is wrong with it, `AssetError` for one of the library.
    """
    check_asset(name)
    if Path(name).suffix.lower() in SUFFIXES:
        return _from_file(Path(name))
    library = AssetLibrary()
    mesh = library.mesh(name)
    return Asset(mesh, {image: _linear(library.texture_path(image)) for image in _images(mesh)})


def _from_file(path: Path) -> Asset:
    intake = Intake(default_cache())
    try:
        found = intake.read(path, path.parent)
        mesh = clean_mesh([part for node in found.nodes for part in node.parts])
    except (AssetError, ValueError) as error:
        said = str(error) if str(path) in str(error) else f"{path} {error}"
        raise UserError(f"asset {said}") from None
    pictures = {image: intake.picture(image, [(path, path.parent)]) for image in _images(mesh)}
    return Asset(mesh, {image: _linear(picture) for image, picture in pictures.items() if picture is not None})


def _images(mesh: Mesh) -> set[str]:
    return {texture.image for part in mesh.parts if (texture := part.material.base_color_texture) is not None}


def _linear(path: Path) -> Float32:
    with open_picture(path) as image:
        return srgb_decode(np.asarray(image.convert("RGB"), np.float32) / 255.0).astype(np.float32)
