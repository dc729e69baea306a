"""Files that are there whole or not at all."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from errno import EINVAL
from pathlib import Path


@contextlib.contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Lend a name beside `path`, of the same suffix, to be written; then sync it to disk and rename it to `path`.

    On any error nothing stays, and what `path` held before is as it was. Raises `OSError` where the folder is missing
    or cannot be written, or where `path` is a folder, a device or a pipe, which must not be renamed over.
    """
    if path.exists() and not path.is_file():
        raise OSError(EINVAL, "is not a file that could be replaced", str(path))
    temporary = path.with_name(f".{uuid.uuid4().hex}.tmp{path.suffix}")
    try:
        yield temporary
        sync(temporary)
        temporary.replace(path)
        sync(path.parent)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Have the disk hold what was written into a file, or the names in a folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
