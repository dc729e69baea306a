"""The pictures of a stage: copied beside it once each, named by what they hold."""

import hashlib
import shutil
from pathlib import Path

import numpy as np

from multilight.scenes.assets.formats.ies import ies_text
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.names import slug

FOLDER = "textures"


class Files:
    """Copies a scene's pictures into `folder/textures` and returns the paths that its stage names them by."""

    def __init__(self, library: AssetLibrary, folder: Path) -> None:
        self._library, self._folder = library, folder
        self._made: dict[str, str] = {}

    def texture(self, image: str) -> str:
        """Copy a texture by its asset id; raises `AssetError` where it is not installed."""
        return self._copied(image, self._library.texture_path(image))

    def environment(self, asset: str) -> str:
        """Copy an environment map by its asset id; raises `AssetError` where it is not installed."""
        return self._copied(asset, self._library.environment_path(asset))

    def luminaire(self, profile: tuple[float, ...]) -> str:
        """Write a light's profile as an IES file of relative intensities."""
        text = ies_text(np.linspace(0.0, 180.0, len(profile)), [0.0], [profile])
        name = f"luminaire-{hashlib.sha256(text.encode()).hexdigest()[:8]}.ies"
        (self._folder / FOLDER).mkdir(parents=True, exist_ok=True)
        (self._folder / FOLDER / name).write_text(text, encoding="utf-8")
        return f"./{FOLDER}/{name}"

    def _copied(self, asset: str, source: Path) -> str:
        if asset not in self._made:
            digest = hashlib.sha256(source.read_bytes()).hexdigest()[:8]
            name = f"{slug(asset, '-')[:60]}-{digest}{source.suffix.lower()}"
            target = self._folder / FOLDER / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)
            self._made[asset] = f"./{FOLDER}/{name}"
        return self._made[asset]
