"""The one place that finds, loads and lists assets by id (`pack/name`)."""

import contextlib
import copy
import hashlib
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from multilight.scenes.assets import derived_maps
from multilight.scenes.assets.builtin.pack import BuiltinPack
from multilight.scenes.assets.cache import default_cache, read_kept
from multilight.scenes.assets.environments import PmndrsPack
from multilight.scenes.assets.fetch import SOURCES, is_fetched, pack_folder, pack_record
from multilight.scenes.assets.formats.imported import Note
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.mesh_memory import MeshMemory
from multilight.scenes.assets.packs.background import BackgroundPack
from multilight.scenes.assets.packs.folder import FolderPack
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.assets.packs.surfaces import SurfacePack
from multilight.scenes.assets.packs.sweethome3d import SweetHome3dPack
from multilight.scenes.assets.splits import Split, in_split
from multilight.scenes.meshes import Mesh, load_mesh, save_mesh

__all__ = ["AssetError", "AssetInfo", "AssetLibrary", "AssetRole"]


def _open(name: str, cache: Path) -> Pack:
    """Open an installed pack; raises `AssetError` with the command that fetches it."""
    if name == BuiltinPack.name:
        return BuiltinPack(cache)
    if name not in SOURCES:
        raise AssetError(f"no pack {name!r}; there are {', '.join((BuiltinPack.name, *SOURCES))}")
    if not is_fetched(name, cache):
        raise AssetError(f"pack {name!r} is not installed; run `multilight assets fetch {name}`")
    record = pack_record(name, cache)
    folder = pack_folder(name, cache) / record.get("folder", ".")
    match SOURCES[name].holds:
        case "furniture":
            return SweetHome3dPack(folder, cache)
        case "maps":
            return PmndrsPack(name, folder)
        case "textures":
            return SurfacePack(name, folder, cache, SOURCES[name].licence)


class AssetLibrary:
    """All installed assets, in a fixed order.

    `cache` holds fetched packs and converted meshes (default: see `default_cache`).
    `packs` are the names of the packs to use (default: `builtin` and every fetched one); `folders` are the user's own
    folders (or single models), each a pack under its name; `background` is a scene of any format. `only_own`: of what
    is installed nothing is listed but what this program makes to set scenes in: backdrops, plinths, doors, gobos, skies
    by formula. `broken` fills with what was asked for and could not be read: asset id → reason. Raises `AssetError` for
    a pack or a background that is not there.
    """

    def __init__(
        self,
        cache: Path | None = None,
        packs: tuple[str, ...] | None = None,
        folders: tuple[Path, ...] = (),
        background: Path | None = None,
        only_own: bool = False,
    ) -> None:
        self.cache = default_cache() if cache is None else Path(cache)
        self.broken: dict[str, str] = {}
        self._only_own = only_own
        self.split: Split | None = None
        self._memory = MeshMemory()
        if only_own:
            packs = (BuiltinPack.name,)
        wanted = (BuiltinPack.name, *(n for n in SOURCES if is_fetched(n, self.cache))) if packs is None else packs
        self._packs: dict[str, Pack] = {name: _open(name, self.cache) for name in wanted}
        for folder in folders:
            pack = FolderPack(Path(folder), self.cache)
            if pack.name in self._packs:
                raise AssetError(f"two packs are called {pack.name!r}; rename the folder {folder}")
            self._packs[pack.name] = pack
        self.background = None if background is None else BackgroundPack(Path(background), self.cache)
        if self.background is not None:
            self._packs[self.background.name] = self.background

    @property
    def packs(self) -> tuple[str, ...]:
        """The names of the packs that are used."""
        return tuple(self._packs)

    def contents(self) -> dict[str, str]:
        """Return, for each pack but the background, what is another where it holds something else."""
        found = {name: pack.content() for name, pack in self._packs.items()}
        for name in found.keys() & SOURCES.keys():
            record = pack_record(name, self.cache)
            found[name] = record["sha256"] or record["version"]
        return {name: content for name, content in sorted(found.items()) if content}

    @cached_property
    def _infos(self) -> dict[str, AssetInfo]:
        infos = (info for pack in self._packs.values() for info in pack.infos() if not self._hidden(info))
        return {info.id: info for info in sorted(infos, key=lambda info: info.id)}

    def _hidden(self, info: AssetInfo) -> bool:
        """Tell whether an asset is not listed, where only the user's own are wanted."""
        scenery = info.role == "surrounding" or info.category in ("gobo", "sky")
        own = info.as_made or info.pack == BackgroundPack.name
        return self._only_own and not own and not (info.pack == BuiltinPack.name and scenery)

    def restricted(self, split: Split) -> "AssetLibrary":
        """Return a view that lists, and hands out, only what scenes of a split may show (see `assets.splits`)."""
        view = copy.copy(self)
        view.split = split
        view._infos = {asset: info for asset, info in self._infos.items() if in_split(info, split)}
        return view

    def list(self, role: AssetRole) -> tuple[AssetInfo, ...]:
        """List the installed assets of a role, sorted by id."""
        return tuple(info for info in self._infos.values() if info.role == role)

    def info(self, asset: str) -> AssetInfo:
        """Return what is known of an asset; raises `AssetError` with the command that fetches its pack."""
        if asset not in self._infos:
            self._pack(asset)
            if self.split is not None:
                raise AssetError(f"asset {asset!r} does not belong to the split {self.split!r}")
            raise AssetError(f"no asset {asset!r}; `multilight assets list` shows those there are")
        return self._infos[asset]

    def mesh(self, asset: str) -> Mesh:
        """Load a model (from the converted cache where possible); raises `AssetError` naming the broken file."""
        info = self.info(asset)
        if info.role not in ("object", "table", "surrounding"):
            raise AssetError(f"{asset!r} is a {info.role}, not a model")
        pack, name = self._pack(asset)
        key = hashlib.sha256(f"{name} {pack.mesh_key(name)}".encode()).hexdigest()[:24]
        path = self.cache / "meshes" / info.pack / f"{key}.npz"
        return self._memory.recall(path, lambda: self._loaded(asset, path))

    def _loaded(self, asset: str, path: Path) -> Mesh:
        """Load a model from the file of the cache, which is made first where it is not there."""
        if (stored := read_kept(path, load_mesh)) is not None:
            return stored
        pack, name = self._pack(asset)
        with self._noting(asset):
            mesh = pack.mesh(name)
        try:
            save_mesh(mesh, path)
        except OSError as error:
            raise AssetError(
                f"cannot write {path}: {error.strerror or error}; free some space or set MULTILIGHT_CACHE"
            ) from error
        return mesh

    def notes(self, asset: str) -> tuple[Note, ...]:
        """Return the account of what a model's file states and is not carried; raises `AssetError` where it is none."""
        pack, name = self._pack(asset)
        return tuple(pack.notes(name))

    def warnings(self, asset: str) -> tuple[str, ...]:
        """Say what is odd about a model, but no fault."""
        return tuple(self._pack(asset)[0].warnings(self.info(asset)))

    def texture_path(self, image: str) -> Path:
        """Return the PNG or JPEG file of a texture, made on first use where it is procedural.

        `#normal` or `#roughness` behind an id asks for the map derived from that picture.
        """
        source, _, kind = image.rpartition("#")
        if kind in derived_maps.MAPS and source:
            return derived_maps.derived_map(self.texture_path(source), kind, self.cache)
        pack, name = self._pack(image)
        with self._noting(image):
            return pack.texture(name)

    def environment_path(self, environment: str) -> Path:
        """Return the equirectangular EXR file (float or half, linear Rec.709) of an environment map."""
        self.info(environment)
        pack, name = self._pack(environment)
        with self._noting(environment):
            return pack.environment(name)

    @contextlib.contextmanager
    def _noting(self, asset: str) -> Iterator[None]:
        try:
            yield
        except AssetError as error:
            self.broken[asset] = str(error)
            raise

    def _pack(self, asset: str) -> tuple[Pack, str]:
        pack, _, name = asset.partition("/")
        if pack not in self._packs and pack in SOURCES:
            raise AssetError(
                f"asset {asset!r} needs the pack {pack!r}, which is not installed; run `multilight assets fetch {pack}`"
            )
        if pack not in self._packs:
            raise AssetError(
                f"no asset {asset!r}: there is no pack {pack!r}; `multilight assets list` shows all, as PACK/NAME, and "
                "--assets DIR adds a folder of models"
            )
        return self._packs[pack], name
