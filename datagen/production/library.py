"""A dataset's assets, with the scene file it is set in; `.blend` files are converted by a Blender of their own."""

import contextlib
import hashlib
import os
import subprocess
import sys
from pathlib import Path

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import UserError
from multilight.scenes.assets.cache import default_cache, is_sound, sources_key
from multilight.scenes.assets.formats.claims import check_model
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.assets.packs.background import PACK
from multilight.scenes.files.whole import write_whole
from multilight.scenes.kinds.custom import background_bodies, find_places

SECONDS = 600
"""Longest that the conversion of a .blend file may take."""
_CONVERTER = "multilight.datagen.backends.blender.convert"


def open_library(config: DatasetConfig, folders: tuple[Path, ...] = ()) -> AssetLibrary:
    """Open the assets a dataset draws from; raises `AssetError` where the background cannot be read."""
    background = config.background
    if config.kind == "imported" and background is not None:
        return _stage_library(background, folders)
    if background is not None and background.suffix.lower() == ".blend":
        background = converted_blend(background, default_cache())
    return AssetLibrary(folders=folders, background=background)


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


def converted_blend(file: Path, cache: Path) -> Path:
    """Return a GLB of a .blend file, converted on the first call in a process of its own that runs no script in it.

    Raises `AssetError` where Blender cannot open it.
    """
    if not file.is_file():
        raise AssetError(f"background {file} does not exist; name a GLB, glTF, USD or .blend file")
    # By what it is, not by where it lies: a copy on another machine gives the same scene.
    digest = hashlib.sha256(
        file.read_bytes() + sources_key(str(Path(__file__).parents[1] / "backends" / "blender" / "convert.py")).encode()
    )
    target = cache / "backgrounds" / f"blend-{digest.hexdigest()[:32]}" / f"{file.stem}.glb"
    if is_sound(target, lambda glb: check_model(glb, glb.parent)):
        return target
    target.parent.mkdir(parents=True, exist_ok=True)
    root = str(Path(__file__).parents[3])  # of `multilight`
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
    with write_whole(target) as work:
        command = [sys.executable, "-m", _CONVERTER, str(file.resolve()), str(work)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=SECONDS, env=environment, check=False
            )
        except subprocess.TimeoutExpired:
            raise AssetError(f"{file} took Blender more than {SECONDS} s to convert; export it as GLB") from None
        if not work.is_file():
            said = [line for line in done.stderr.splitlines() if line.strip()] or [f"exit code {done.returncode}"]
            raise AssetError(
                f"{file} cannot be converted ({said[-1].strip()}); open and save it in Blender 4.5 or newer"
            )
    return target
