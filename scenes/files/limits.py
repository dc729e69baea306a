"""How much is taken of a file that others made; each limit holds before anything of that size is allocated.

Readers raise `LimitError`, a `ValueError` whose message says what is too much and the remedy, but not the file's name:
that is added by whoever asked for the file, as for a file that is damaged.
"""

import json
import reprlib
import stat
import tomllib
import warnings
import zipfile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from multilight.scenes.errors import MultilightError

MOST_PIXELS = 1 << 26
"""Pixels of a picture, a depth or an environment map: 8192 x 8192, the largest that is rendered; 0.8 GB as floats."""
MOST_TRIANGLES = 3_000_000
"""Triangles of a model or scene, each placing counted: cleaning takes 1.5 kB and 24 µs for each, 4.5 GB in all."""
MOST_NODES = 100_000
"""Placings of nodes in a scene: where branches are used twice they double with every level."""
MOST_LEVELS = 200
"""Levels of a scene's tree of nodes."""
MOST_TEXT = 1 << 24
"""Bytes of a text that people write: configurations, tables, poses; as objects of JSON they take up to 0.4 GB."""
MOST_CONFIG = 1 << 18
"""Bytes of a TOML file, and"""
MOST_LINE = 2000
"""characters of a line in it: Python's reader takes a time that is quadratic in the length of a dotted key."""
MOST_JSON = 1 << 27
"""Bytes of a scene's JSON, which may hold its buffers."""
MOST_FILE = 1 << 30
"""Bytes of a model, a scene, a picture or a point cloud, and of what one of them claims to hold."""
FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "BMP", "TGA", "PPM", "GIF")
"""Formats of pictures that are opened; some of Pillow's others run programs."""

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200

PIXELS_TOLD = f"{MOST_PIXELS / 1e6:.0f} million pixels are read (8192 x 8192); make it smaller"


class LimitError(MultilightError, ValueError):
    """A file holds more than is read of its kind, or is no plain file."""


def shown(value: object) -> str:
    """Return what `repr` says of a value, the inner part of what is long left out."""
    return _SHORT.repr(value)


def check_file(path: Path, most: int = MOST_FILE) -> None:
    """Raise `LimitError` where a file is no plain one or larger than `most` bytes; opening a folder fails by itself."""
    state = path.stat()
    if not (stat.S_ISREG(state.st_mode) or stat.S_ISDIR(state.st_mode)):
        raise LimitError("it is a pipe or a device; copy what it gives into a file")
    check_size(state.st_size, most)


def read_bytes(path: Path, most: int = MOST_FILE) -> bytes:
    """Read a plain file of at most `most` bytes; raises `OSError`, and `LimitError` for pipes and devices as well."""
    check_file(path, most)
    with path.open("rb") as file:
        content = file.read(most + 1)  # what the kernel makes up has no size until it is read
    check_size(len(content), most)
    return content


def read_text(path: Path, most: int = MOST_TEXT) -> str:
    """Read a plain UTF-8 file of at most `most` bytes; raises `OSError` or `ValueError`."""
    return read_bytes(path, most).decode()


def read_json(path: Path) -> Any:
    """Read a JSON file; raises `OSError` or `ValueError`."""
    return parse_json(read_text(path))


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; raises `OSError` or `ValueError`."""
    text = read_text(path, MOST_CONFIG)
    if (longest := max(map(len, text.splitlines()), default=0)) > MOST_LINE:
        raise LimitError(f"it has a line of {longest} characters, at most {MOST_LINE} are read; break it")
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise LimitError("its tables or lists are nested too deeply") from None


def parse_json(text: str | bytes) -> Any:
    """Parse JSON; raises `ValueError`, for what is nested too deeply as well."""
    try:
        return json.loads(text)
    except RecursionError:
        raise LimitError("its lists or objects are nested too deeply") from None


def read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Read a file inside a ZIP; raises `KeyError` where it is missing, `LimitError` where it unpacks to too much."""
    check_size(archive.getinfo(name).file_size)
    return archive.read(name)


def read_npy(path: Path) -> NDArray[Any]:
    """Read an .npy file of at most `MOST_PIXELS` numbers; nothing is unpickled. Raises `OSError` or `ValueError`."""
    check_file(path)
    try:
        mapped = np.lib.format.open_memmap(path, mode="r")  # maps no more than the file has
    except OSError:
        raise
    except Exception as error:  # numpy raises whatever a broken header makes it stumble over
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise ValueError(f"it is no .npy file of numbers ({reason})") from None
    if mapped.dtype.kind not in "fiub":
        raise ValueError(f"it is no .npy file of numbers (but of {mapped.dtype})")
    if mapped.size > MOST_PIXELS:
        raise LimitError(f"it has {mapped.size} numbers, at most {PIXELS_TOLD}")
    return np.array(mapped)


def open_picture(file: Path | BinaryIO) -> Image.Image:
    """Open a picture of at most `MOST_PIXELS` pixels, without decoding it.

    Raises `OSError` (`PIL.UnidentifiedImageError` for other formats) or `ValueError`.
    """
    if isinstance(file, Path):
        check_file(file)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        try:
            image = Image.open(file, formats=FORMATS)
        except (Image.DecompressionBombError, Image.DecompressionBombWarning):
            raise LimitError(f"it has more pixels than are read: at most {PIXELS_TOLD}") from None
        except SyntaxError as error:  # Pillow's word for a broken header
            raise ValueError(str(error)) from None
    try:
        check_pixels(image.width, image.height)
    except LimitError:
        image.close()
        raise
    return image


def check_pixels(width: int, height: int) -> None:
    """Raise `LimitError` where a picture has more than `MOST_PIXELS` pixels."""
    if width * height > MOST_PIXELS:
        raise LimitError(f"it is {width} x {height} pixels, at most {PIXELS_TOLD}")


def check_size(size: int, most: int = MOST_FILE) -> None:
    """Raise `LimitError` where so many bytes are more than are read."""
    if size > most:
        raise LimitError(f"it holds {size} bytes, at most {most} are read")
