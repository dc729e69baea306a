"""Reading a model with the files that it names, none of them outside of the folder that a user named."""

import logging
from pathlib import Path
from typing import Any

import trimesh
from trimesh.resolvers import FilePathResolver

from multilight.scenes.assets.formats.claims import check_model, check_placed
from multilight.scenes.assets.info import AssetError
from multilight.scenes.files.inside import OutsideError, inside


class _Beside(FilePathResolver):
    """Hands out the files that a model names, relative to it and inside `folder`; remembers what it refused."""

    def __init__(self, path: Path, folder: Path) -> None:
        super().__init__(str(path))
        self._folder = folder
        self.refused: OutsideError | None = None

    def get(self, name: str) -> bytes:
        """Read a file; MTL files of other systems have backslashes."""
        try:
            return inside(self._folder, name.strip().replace("\\", "/"), beside=Path(self.parent)).read_bytes()
        except OutsideError as error:
            self.refused = error
            raise


def load_scene(path: Path, folder: Path) -> Any:
    """Load a GLB, glTF or OBJ file as trimesh's scene.

    Raises `AssetError` where it claims too much or names a file outside of `folder`, and whatever a broken file makes
    trimesh stumble over.
    """
    check_model(path, folder)
    logger = logging.getLogger("trimesh")
    level, logger.level = logger.level, logging.CRITICAL
    resolver = _Beside(path, folder)
    try:
        scene = trimesh.load_scene(path, process=False, resolver=resolver)
        check_placed(scene)
        return scene
    finally:
        logger.level = level
        if resolver.refused is not None:  # of some files trimesh only logs that they could not be read
            raise AssetError(f"{path}: {resolver.refused}; put the file into the folder {folder}")
