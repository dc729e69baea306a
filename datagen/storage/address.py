"""Where a dataset lies, a folder or any address that fsspec opens, and reading from there; nothing is written."""

import contextlib
import re
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import fsspec
from fsspec import AbstractFileSystem

from multilight.datagen.errors import StoreError, UserError, reason_of
from multilight.datagen.text import did_you_mean
from multilight.scenes.files.confined import OutsideError, held, inside, plain_name


@dataclass(frozen=True)
class Place:
    """A folder or address; every name asked for stays inside. `address` is what users gave, without password."""

    address: str
    filesystem: AbstractFileSystem = field(repr=False)
    root: str = field(repr=False)

    @property
    def is_local(self) -> bool:
        """Whether it is a folder of this machine."""
        protocol = self.filesystem.protocol
        return "file" in ((protocol,) if isinstance(protocol, str) else protocol)

    def _meant(self) -> str:
        """Name a dataset beside where no folder is, for a slip of the pen."""
        root = Path(self.root)
        if not self.is_local or root.exists() or not root.parent.is_dir():
            return ""
        return did_you_mean(root.name, [file.parent.name for file in root.parent.glob("*/dataset.json")])

    def read(self, name: str, most: int | None = None) -> bytes:
        """Read a file of at most `most` bytes; raises `StoreError` naming it and the reason."""
        shown = f"{self.address}/{name}"
        with outside_told(self.address):
            plain_name(name)
            if self.is_local:
                held(Path(self.root), Path(self.root, name))
        try:
            if most is not None and (size := self.size(name) or 0) > most:
                raise StoreError(f"{shown} holds {size} bytes, at most {most} are read")
            return bytes(self._alive().cat_file(f"{self.root}/{name}"))
        except FileNotFoundError:
            raise StoreError(f"{shown} is missing: {self._meant()}not a dataset, or not finished") from None
        except StoreError:
            raise
        except Exception as error:  # each backend has its own errors for a lost connection or a refused key
            raise StoreError(f"{shown} cannot be read: {reason_of(error)}") from None

    @contextlib.contextmanager
    def local(self, name: str) -> Iterator[Path]:
        """Lend a file as a local one: of a remote place a copy, gone afterwards."""
        if self.is_local:
            with outside_told(self.address):
                path = inside(Path(self.root), name)
            yield path
            return
        content = self.read(name)
        with tempfile.TemporaryDirectory(prefix="multilight-") as folder:
            path = Path(folder) / Path(name).name
            path.write_bytes(content)
            yield path

    def files(self, folder: str) -> dict[str, int | None] | None:
        """List all under a folder by name from there, with sizes where known; None where the place cannot list.

        Folders, links and what else is no plain file have the size -1.
        """
        start = f"{self.root}/{folder}/".lstrip("/")
        found: dict[str, int | None] = {}
        try:
            entries = self.filesystem.find(f"{self.root}/{folder}/", withdirs=True, detail=True)
        except Exception:  # backends that cannot list raise errors of many kinds
            return None
        for path, about in entries.items():
            plain = about["type"] == "file" and not about.get("islink")
            name = f"{path}/".lstrip("/").removeprefix(start).rstrip("/")
            found[name] = about.get("size") if plain else -1
        found.pop("", None)
        return found or None

    def exists(self, name: str) -> bool:
        """Whether there is a file of that name."""
        return bool(self.filesystem.exists(f"{self.root}/{name}"))

    def size(self, name: str) -> int | None:
        """Return a file's size where the place says it."""
        with contextlib.suppress(Exception):  # each backend has its own errors
            size = self._alive().info(f"{self.root}/{name}").get("size")
            return None if size is None else int(size)
        return None

    def _alive(self) -> AbstractFileSystem:
        """Return the file system with a new connection in a forked process; in the same one it is the same object."""
        return type(self.filesystem)(*self.filesystem.storage_args, **self.filesystem.storage_options)

    def names(self, folder: str) -> list[str] | None:
        """List what lies directly in a folder, files and folders; None where the place cannot list."""
        try:
            found = self.filesystem.ls(f"{self.root}/{folder}", detail=False)
        except Exception:  # backends that cannot list raise errors of many kinds
            return None
        names = {str(name).rstrip("/").rpartition("/")[2] for name in found} - {folder, ""}
        return sorted(names) or None


@contextlib.contextmanager
def outside_told(address: str) -> Iterator[None]:
    """Raise `StoreError` for a name that leads out of a dataset."""
    try:
        yield
    except OutsideError as error:
        raise StoreError(f"{address}: {error}; it is not read") from None


def without_password(address: str | Path) -> str:
    """Return an address as it may be shown and written down."""
    return re.sub("(?<=://)[^/@]*@", "", str(address))


def find_place(address: str | Path, **options: bool) -> Place:
    """Find what an address means, with options of fsspec; raises `UserError` where that cannot be understood."""
    text = str(address).rstrip("/") or str(address)
    shown = without_password(text)
    try:
        filesystem, root = fsspec.core.url_to_fs(text, **options)
    except (ValueError, ImportError) as error:
        raise UserError(
            f"{shown} cannot be opened: {error} (S3 and HTTP need: pip install 'multilight[remote]')"
        ) from None
    return Place(shown, filesystem, root)
