"""One process at a time in an output folder."""

import contextlib
import fcntl
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from multilight.datagen.errors import StoreError, UserError, reason_of
from multilight.scenes.files.confined import OutsideError, held

LOCK = ".lock"


@contextlib.contextmanager
def locked(root: Path, patience: float = 0.0) -> Iterator[None]:
    """Make an output folder and hold its lock, which the kernel drops when the process ends, however it ends.

    Where another process holds it, waits for so many seconds. A folder that is still empty at the end, and was made
    here, goes again. Raises `UserError` where the folder cannot be written or another process is at work in it,
    `StoreError` where something in it is a link that leads out of it.
    """
    new = not root.exists()
    try:
        root.mkdir(parents=True, exist_ok=True)
        _check_links(root)
        lock = _taken(root / LOCK, time.monotonic() + patience)
    except OSError as error:
        if isinstance(error, BlockingIOError):
            raise UserError(f"{root} is being made by another process; wait for it or stop it first") from None
        raise UserError(f"output folder {root} cannot be written: {reason_of(error)}; choose another --out") from None
    with lock:
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                (root / LOCK).unlink()
                if new:
                    root.rmdir()


def _taken(path: Path, until: float) -> IO[str]:
    """Open and lock a file; again where another process removed it in between, so that both cannot hold it."""
    while True:
        lock = path.open("w")
        try:
            while True:
                try:
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                except BlockingIOError:
                    if time.monotonic() > until:
                        raise
                    time.sleep(0.02)
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(lock.fileno()), path.stat()):
                    return lock
        except BaseException:
            lock.close()
            raise
        lock.close()


def _check_links(root: Path) -> None:
    """Raise `StoreError` where something in a dataset's folder is a link that leads out of it, so writing would too."""
    for folder in (root, root / "scenes"):
        if not folder.is_dir():
            continue
        with os.scandir(folder) as entries:
            links = [Path(entry.path) for entry in entries if entry.is_symlink()]
        for path in links:
            try:
                held(root, path)
            except OutsideError as error:
                raise StoreError(f"{error}; remove the link") from None
