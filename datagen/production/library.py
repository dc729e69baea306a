"""A dataset's assets, with the scene file it is set in."""

import contextlib
from pathlib import Path

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import UserError
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.packs.background import PACK
from multilight.scenes.kinds.custom import background_bodies, find_places


def open_library(config: DatasetConfig, folders: tuple[Path, ...] = ()) -> AssetLibrary:
    """Open the assets a dataset draws from; raises `AssetError` where the background cannot be read."""
    if config.kind == "imported" and config.background is not None:
        return _stage_library(config.background, folders)
    return AssetLibrary(folders=folders, background=config.background)


def _stage_library(stage: Path, folders: tuple[Path, ...]) -> AssetLibrary:
    """Open the assets of an exported stage: what is installed, and only where that does not do, what the stage has."""
    from multilight.datagen.usd.read import read_stage  # imports pxr, which few need

    installed = AssetLibrary(folders=folders)
    with contextlib.suppress(UserError):
        found = read_stage(stage, installed)
        if not any(f'"{PACK}/' in spec.canonical_json() for spec in (found.scene, found.rig)):
            return installed
    return AssetLibrary(folders=folders, background=stage)


def check_background(config: DatasetConfig) -> None:
    """Convert the background, and see that it has surfaces, before any worker starts.

    Raises `AssetError` in one line with the file, what is wrong and the remedy.
    """
    if config.background is not None and config.kind != "imported":
        library = open_library(config)
        find_places(background_bodies(library), library)
