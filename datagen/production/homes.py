"""Where a dataset is made: a folder, which runs share by locks, or an address, of which this machine has a part."""

import contextlib
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from multilight.datagen.errors import UserError
from multilight.datagen.files.locks import locked
from multilight.datagen.production.drivers import Driver
from multilight.datagen.production.finishing import Survey, finish, survey
from multilight.datagen.production.shards import Shard
from multilight.datagen.storage.address import Place, find_place
from multilight.datagen.storage.blocks import read_blocks
from multilight.datagen.storage.store import read_dataset, scene_dir

PATIENCE = 600.0
"""Seconds to wait for another run that writes the index, which takes it a few."""


class Home(Protocol):
    """Where a dataset is made.

    `root` is the folder where scenes are put together, and where `dataset.json` and the index are looked at and written
    while it is `held`; `place` is where the dataset lies. Others' hands are asked about every `pause` seconds.
    """

    @property
    def root(self) -> Path:
        """A folder of this machine."""

    @property
    def place(self) -> Place:
        """Where the dataset lies."""

    @property
    def pause(self) -> float:
        """Seconds."""

    @property
    def retried(self) -> list[str]:
        """A word on each request that was tried again."""

    def held(self) -> AbstractContextManager[None]:
        """Have no other run look at or write index and `dataset.json`; raises `UserError` where one does for long."""

    def join(self, shard: Shard | None) -> Driver:
        """Join the runs at work here; to be called while it is held."""

    def survey(self, *, contents: bool) -> Survey:
        """Look at what is there; to be called while it is held, or before others may be at work."""

    def finish(self, there: Survey) -> None:
        """Bring index and `dataset.json` up to what is there; to be called while it is held."""

    def state(self, index: int) -> object:
        """Return what tells a scene that is there from any other of its number before or after; None where none is."""


class Folder:
    """A folder of this machine, or one that it shares with others."""

    pause = 0.0

    def __init__(self, root: Path) -> None:
        self.root, self.place, self.retried = root, find_place(root), list[str]()

    def held(self) -> AbstractContextManager[None]:
        """Hold the folder's lock."""
        return locked(self.root, PATIENCE)

    def join(self, shard: Shard | None) -> Driver:
        """Join the runs at work in the folder."""
        return Driver(self.root, shard)

    def survey(self, *, contents: bool) -> Survey:
        """Look at what is there."""
        record = read_dataset(self.root)
        return survey(self.root, record, read_blocks(self.place, record), contents=contents)

    def finish(self, there: Survey) -> None:
        """Bring index and `dataset.json` up to what is there."""
        finish(self.root, there)

    def state(self, index: int) -> object:
        """Return the number by which the file system knows a scene's folder."""
        with contextlib.suppress(OSError):
            return scene_dir(self.root, index).stat().st_ino
        return None


def local_folder(out: str | Path) -> Path | None:
    """Return the folder that is meant; None for an address elsewhere. Raises `UserError` where it is not understood."""
    if "://" not in str(out):
        return Path(out)
    place = find_place(out)
    if "memory" in place.filesystem.protocol or "http" in place.filesystem.protocol:
        raise UserError(f"{place.address} cannot be written to by several processes; name a folder or a bucket")
    return Path(place.root) if place.is_local else None


@contextlib.contextmanager
def open_home(root: Path, address: str) -> Iterator[Home]:
    """Lend the place where a dataset is made: at an address, or in a folder where there is none."""
    if not address:
        yield Folder(root)
        return
    from multilight.datagen.production.bucket import Bucket, stage

    with stage() as folder:
        bucket = Bucket(address, folder)
        try:
            yield bucket
        finally:
            bucket.close()
