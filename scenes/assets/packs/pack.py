"""What every pack is: a set of assets under one name."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path

from multilight.scenes.assets.formats.imported import Note
from multilight.scenes.assets.info import AssetError, AssetInfo
from multilight.scenes.meshes import Mesh


class Pack(ABC):
    """A set of assets under one name. Names of assets are given without the `pack/` in front.

    A pack says what it holds; of what it does not say it has none, and asking for that raises `AssetError`.
    """

    name: str

    @abstractmethod
    def infos(self) -> Sequence[AssetInfo]:
        """List the pack's assets; quick, opens no model."""

    def content(self) -> str:
        """Hash all that it holds; "" where that is known otherwise (fetched packs, the background)."""
        return ""

    def mesh_key(self, name: str) -> str:
        """Hash what a model's conversion depends on (file and code), quickly."""
        raise AssetError(f"{self.name}/{name} is not a model")

    def mesh(self, name: str) -> Mesh:
        """Convert a model; raises `AssetError` naming the broken file."""
        raise AssetError(f"{self.name}/{name} is not a model")

    def notes(self, name: str) -> Sequence[Note]:
        """Return the account of what a model's file states and is not carried."""
        return ()

    def warnings(self, info: AssetInfo) -> Iterable[str]:
        """Say what is odd about a model, but no fault."""
        return ()

    def texture(self, name: str) -> Path:
        """Return the file of a texture; raises `AssetError` where there is none."""
        raise AssetError(f"{self.name}/{name} is not a texture")

    def environment(self, name: str) -> Path:
        """Return the file of an environment map; raises `AssetError` where there is none."""
        raise AssetError(f"{self.name}/{name} is not an environment map")
