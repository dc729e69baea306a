"""The asset cache: where it lies, writing into it so that several processes may do so at once, and its healing.

All that is in it can be made anew. What turns out damaged is thrown away, counted, and made anew.
"""

import errno
import hashlib
import json
import os
import shutil
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TypeVar

import OpenEXR

from multilight.scenes.assets.info import AssetError
from multilight.scenes.files.atomic import write_whole
from multilight.scenes.files.limits import open_picture

T = TypeVar("T")
_thrown_away: dict[Path, str] = {}
"""What was damaged and has not been told yet, and why."""
_sound: set[Path] = set()
"""Pictures and maps that this process has found to be sound."""


def default_cache() -> Path:
    """Return `$MULTILIGHT_CACHE`, else `multilight` in `$XDG_CACHE_HOME` or `~/.cache`."""
    if chosen := os.environ.get("MULTILIGHT_CACHE"):
        return Path(chosen).expanduser()
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "multilight"


def check_cache() -> None:
    """Raise `AssetError` where the cache cannot be written to."""
    folder = default_cache()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with write_whole(folder / ".written") as work:
            work.write_bytes(b"")
    except OSError as error:
        raise AssetError(f"the cache {folder} cannot be written: {error.strerror}; set MULTILIGHT_CACHE") from error


def write_once(path: Path, write: Callable[[Path], None]) -> Path:
    """Make `path`, whole or not at all; does nothing where it is there already.

    A picture or map that is there, but damaged, is made anew. Raises `AssetError` where the cache cannot be written to.
    """
    try:
        if is_sound(path):
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        with write_whole(path) as work:
            write(work)
    except OSError as error:
        raise AssetError(
            f"cannot write {path}: {error.strerror or error}; free some space or set MULTILIGHT_CACHE"
        ) from error
    return path


def kept(path: Path, read: Callable[[Path], T], write: Callable[[Path], None]) -> T:
    """Read a file of the cache, which is made first where it is missing or damaged."""
    found = read_kept(path, read)
    return read(write_once(path, write)) if found is None else found


def read_kept(path: Path, read: Callable[[Path], T]) -> T | None:
    """Read a file of the cache; None where it is missing, or damaged, and then thrown away."""
    try:
        return read(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except MemoryError:
        raise
    except Exception as error:  # readers raise whatever a damaged file makes them stumble over
        if isinstance(error, OSError) and error.errno not in (None, errno.EISDIR, errno.EIO):
            raise AssetError(f"{path} cannot be read: {error.strerror}") from error
        throw_away(path, error)
        return None


def is_sound(path: Path) -> bool:
    """Tell whether a picture or map of the cache is there and whole; a damaged one is thrown away.

    The sums of a PNG are held to its content, other pictures and EXR maps are decoded, once in each process.
    """
    if not path.exists():
        return False
    if path in _sound:
        return True
    check = {".exr": _check_map}.get(path.suffix, _check_picture)
    if read_kept(path, lambda file: (check(file),)) is None:
        return False
    _sound.add(path)
    return True


def throw_away(path: Path, reason: Exception) -> None:
    """Remove a damaged file or folder of the cache, to be told by `tell_thrown_away`."""
    _thrown_away[path] = str(reason) or type(reason).__name__
    try:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise AssetError(f"{path} is damaged ({reason}) and cannot be removed: {error.strerror}; remove it") from error


def tell_thrown_away() -> None:
    """Say on standard error, in one line, what has been found damaged since the last call."""
    if _thrown_away:
        first, reason = next(iter(_thrown_away.items()))
        count = f"{len(_thrown_away)} damaged files" if len(_thrown_away) > 1 else "a damaged file"
        shown = " ".join(reason.split())[:200]
        print(f"asset cache: {count} thrown away, to be made anew; {first}: {shown}", file=sys.stderr)
        _thrown_away.clear()


def _check_picture(path: Path) -> None:
    """Raise an error where a picture is damaged: a PNG's sums tell, at a tenth of what decoding it takes."""
    with open_picture(path) as picture:
        if picture.format != "PNG":
            picture.load()
        picture.verify()


def _check_map(path: Path) -> None:
    with OpenEXR.File(str(path)) as file:
        if not any(len(channel.pixels) for channel in file.channels().values()):
            raise ValueError("it holds no picture")


def sources_key(*files: str) -> str:
    """Hash source files (12 hex digits), so that what old code converted is not taken for new."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()[:12]


def file_digest(path: Path) -> str | None:
    """Hash a file's content (64 hex digits); None where it is not there. Remembered while size and time stay."""
    try:
        state = path.stat()
        return _digest(str(path), state.st_size, state.st_mtime_ns)
    except OSError:
        return None


@lru_cache(maxsize=1 << 16)
def _digest(path: str, size: int, time: int) -> str:
    with open(path, "rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def write_json(path: Path, value: object) -> None:
    """Write a value as JSON, indented, keys in order."""
    path.write_text(json.dumps(value, indent=1, sort_keys=True) + "\n", encoding="utf-8")
