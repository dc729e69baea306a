"""Files and folders that a user names with `--out`: looked at before the work, written whole or not at all."""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from multilight.datagen.errors import UserError, full_disk_told, reason_of
from multilight.scenes.files.atomic import write_whole


def check_folder(path: Path) -> None:
    """Make a folder to write to, and try it; raises `UserError` in one line where that cannot be."""
    with _told(path):
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass


def check_file(path: Path) -> None:
    """See that a file can be written, making its folder; raises `UserError` in one line where that cannot be."""
    check_folder(path.parent)
    if os.path.lexists(path) and not path.is_file() and not path.is_symlink():
        raise UserError(f"{path} cannot be written: it is a folder or a device; name a file")


@contextlib.contextmanager
def written(path: Path) -> Iterator[Path]:
    """Lend a name of the same suffix to write to; the file gets its own when it is whole.

    Raises `UserError` in one line where it cannot be written, or the disk is full.
    """
    with _told(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with full_disk_told(path.parent), write_whole(path) as work:
            yield work


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(f"{path} cannot be written: {reason_of(error)}; choose another place") from None
