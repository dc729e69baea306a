"""The object to insert: a model file of the user's, or one of the asset library, as triangles with their colour."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from multilight.datagen.errors import UserError
from multilight.scenes.arrays import Float32, Float64
from multilight.scenes.assets.formats.beside import load_scene
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, clean_mesh, transformed
from multilight.scenes.assets.formats.gltf import raw_part
from multilight.scenes.assets.info import AssetError, unreadable
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs.folder import SUFFIXES
from multilight.scenes.colour import srgb_decode
from multilight.scenes.files.limits import open_picture
from multilight.scenes.meshes import Mesh
from multilight.scenes.spec import Texture


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
    """Load a GLB, glTF (Y-up) or OBJ (Y-up) file, or an asset of the library by its id `pack/name`.

    Raises `UserError` naming the file and what is wrong with it, `AssetError` for one of the library.
    """
    check_asset(name)
    if Path(name).suffix.lower() in SUFFIXES:
        return _from_file(Path(name))
    library = AssetLibrary()
    mesh = library.mesh(name)
    images = {texture.image for part in mesh.parts if (texture := part.material.base_color_texture) is not None}
    return Asset(mesh, {image: _linear(open_picture(library.texture_path(image))) for image in images})


def _from_file(path: Path) -> Asset:
    textures: dict[str, Float32] = {}

    def keep(image: Image.Image) -> Texture:
        key = f"texture/{len(textures)}"
        textures[key] = _linear(image)
        return Texture(image=key)

    try:
        pieces = load_scene(path, path.parent).dump()
        parts = [raw_part(piece, keep) for piece in pieces if isinstance(piece, trimesh.Trimesh)]
        mesh = clean_mesh(transformed(parts, Z_UP_FROM_Y_UP))
    except AssetError as error:
        raise UserError(f"asset {error}") from None
    except Exception as error:  # trimesh raises whatever a broken file makes it stumble over
        raise UserError(f"asset {unreadable(path, error)}") from None
    return Asset(mesh, textures)


def _linear(image: Image.Image) -> Float32:
    return srgb_decode(np.asarray(image.convert("RGB"), np.float32) / 255.0).astype(np.float32)
