"""The asset cache: where it lies, and writing into it so that several processes may do so at once."""

import hashlib
import json
import os
from collections.abc import Callable
from pathlib import Path

from scenes.assets.info import AssetError
from scenes.whole import write_whole


def default_cache() -> Path:
    """Return `$MULTILIGHT_CACHE`, else `~/.cache/multilight`."""
    chosen = os.environ.get("MULTILIGHT_CACHE")
    return Path(chosen).expanduser() if chosen else Path.home() / ".cache" / "multilight"


def write_once(path: Path, write: Callable[[Path], None]) -> Path:
    """Make `path`, whole or not at all; does nothing where it is there already.

    Raises `AssetError` where the cache cannot be written to.
    """
    try:
        if path.exists():
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_whole(path) as work:
            write(work)
    except OSError as error:
        raise AssetError(
            f"cannot write {path}: {error.strerror or error}; free some space or set MULTILIGHT_CACHE"
        ) from error
    return path


def sources_key(*files: str) -> str:
    """Hash source files (12 hex digits), so that what old code converted is not taken for new."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()[:12]


def write_json(path: Path, value: object) -> None:
    """Write a value as JSON, indented, keys in order."""
    path.write_text(json.dumps(value, indent=1, sort_keys=True) + "\n", encoding="utf-8")
