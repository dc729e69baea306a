"""Folders that appear whole or not at all, and stay as they are when an export is run again."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from datagen.errors import full_disk_told


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Lend an empty folder beside `path` to be filled, and give it that name at the end; nothing stays on an error."""
    partial = path.with_name(path.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        with full_disk_told(partial):
            yield partial
        partial.replace(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
