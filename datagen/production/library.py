"""A dataset's assets, with the scene file it is set in."""

import contextlib
from pathlib import Path

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import UserError
from multilight.datagen.storage.records import DatasetRecord
from multilight.scenes.assets.cache import file_digest
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs.background import PACK
from multilight.scenes.kinds.custom import background_bodies, find_places


def open_library(config: DatasetConfig, folders: tuple[Path, ...] = ()) -> AssetLibrary:
    """Open the assets a dataset draws from; raises `AssetError` where the background cannot be read."""
    if config.kind == "imported" and config.background is not None:
        return _stage_library(config.background, folders)
    return AssetLibrary(folders=folders, background=config.background, only_own=config.only_assets)


def _stage_library(stage: Path, folders: tuple[Path, ...]) -> AssetLibrary:
    """Open the assets of an exported stage: what is installed, and only where that does not do, what the stage has."""
    from multilight.datagen.usd.read import read_stage  # imports pxr, which few need

    installed = AssetLibrary(folders=folders)
    with contextlib.suppress(UserError):
        found = read_stage(stage, installed)
        if not any(f'"{PACK}/' in spec.canonical_json() for spec in (found.scene, found.rig)):
            return installed
    return AssetLibrary(folders=folders, background=stage)


TABLES = ("tabletop", "room")
"""Kinds of scenes that need a table."""


def check_library(config: DatasetConfig, folders: tuple[Path, ...]) -> AssetLibrary | None:
    """Read what is the user's own, and see that the scenes can be made of it, before any worker starts.

    Returns the library; None where nothing is the user's. Raises `AssetError` in one line with the file, or what is
    missing, and the remedy.
    """
    if config.kind == "imported" or (config.background is None and not folders and not config.only_assets):
        return None
    library = open_library(config, folders)
    if config.background is not None:
        find_places(background_bodies(library), library)
    if config.only_assets:
        _check_enough(config, library, folders)
    return library


def _check_enough(config: DatasetConfig, library: AssetLibrary, folders: tuple[Path, ...]) -> None:
    """Raise `AssetError` where the user's own are too few for a kind of scene, or for a split."""
    mixed = [k for k, share in config.kinds.model_dump().items() if share] if config.kind == "mixed" else []
    kinds = {config.kind, *config.ood_kinds, *mixed}
    needs = {"object": config.objects[1], "table": int(bool(kinds & {*TABLES})), "surrounding": int("room" in kinds)}
    where = ", ".join(map(str, folders)) or "any folder"
    for split, share in config.splits.weights().items():
        for role in ("object", "table", "surrounding") if share else ():
            found = sum(info.as_made for info in library.restricted(split).list(role))
            if found < needs[role]:
                raise AssetError(
                    f"scenes of the split {split!r} need {needs[role]} {role}(s) or more, and {where} has {found}; "
                    f"add some, set fewer `objects`, splits.{split} = 0 or the role in assets.csv, or use --assets"
                )


def open_library_again(record: DatasetRecord, root: Path, own: tuple[Path, ...]) -> AssetLibrary:
    """Open the assets of a dataset in `root` that is there, perhaps moved here: `own` may hold its background too."""
    config = located(record.config, root)
    for file in (path for path in own if path.is_file() and same_background(record, path)):
        config, own = config.model_copy(update={"background": file}), tuple(path for path in own if path != file)
    return open_library(config, own)


def same_background(record: DatasetRecord, background: Path | None) -> bool:
    """Tell whether a background is the one that a dataset was made with, wherever it lies."""
    return background is not None and file_digest(background) == record.background_sha256 != ""


def located(config: DatasetConfig, root: Path) -> DatasetConfig:
    """Return a configuration whose background is found beside the dataset where it is not where it was."""
    if config.background is None or config.background.exists():
        return config
    beside = root.resolve().parent
    there = [path for path in (beside / config.background, beside / config.background.name) if path.exists()]
    return config.model_copy(update={"background": there[0]}) if there else config
