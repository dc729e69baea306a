"""Writing to an address: requests tried again with patience, files whole or not there, a scene's record last.

What credentials it takes is between fsspec and the environment or its own files: nothing here knows any.
"""

import contextlib
import json
import random
import shutil
import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from multilight.datagen.errors import RunStoppedError, reason_of
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.index import Row
from multilight.datagen.storage.records import AssetCredit
from multilight.datagen.storage.store import scene_dir, scene_folder
from multilight.datagen.text import plain

ROWS = ".rows"
"""Folder of the rows of scenes that no index has yet, a file each, written before the scene is there."""
FIRST, LONGEST = 0.5, 30.0
"""Seconds to wait after a request failed first, and at most; each wait is twice the one before, give or take half."""
TOTAL = 600.0
"""Seconds after which a request that still fails stops the run."""
AT_ONCE, IN_MEMORY = 8, 500_000_000
"""Files of a scene sent at once, and bytes of them: s3fs has those below 100 MB in memory, of others ten parts."""
_T = TypeVar("_T")


class Remote:
    """A place that is written to; `retried` has a word on each request that was tried again."""

    def __init__(self, address: str) -> None:
        self._address, self._ended = address, ""
        self.place = find_place(address, use_listings_cache=False)
        self.retried: list[str] = []

    def patiently(self, act: Callable[[], _T]) -> _T:
        """Do something until it succeeds; raises `RunStoppedError` where it does not, or is refused.

        `FileNotFoundError` and `FileExistsError` are answers. Refused once, credentials are looked up again.
        """
        begun, refused, wait = time.monotonic(), False, FIRST
        while True:
            try:
                return act()
            except (FileNotFoundError, FileExistsError):
                raise
            except Exception as error:  # each backend has its own errors
                if self._ended:  # what is left to be cleared away is not waited for
                    raise RunStoppedError(self._ended) from None
                said = reason_of(error)
                if isinstance(error, PermissionError) or "Credential" in type(error).__name__:
                    if refused:
                        raise self._stopped(f"access is refused ({said}): renew the credentials and") from None
                    refused = True
                    self.place = find_place(self._address, use_listings_cache=False, skip_instance_cache=True)
                elif (passed := time.monotonic() - begun) > TOTAL:
                    raise self._stopped(f"it still fails after {passed:.0f} s ({said});") from None
                if not self.retried:
                    print(plain(f"{self.place.address}: a request failed ({said}); trying again"), file=sys.stderr)
                self.retried.append(said)
            time.sleep(wait * random.uniform(0.5, 1.5))
            wait = min(2 * wait, LONGEST)

    def _stopped(self, what: str) -> RunStoppedError:
        self._ended = f"{self.place.address}: {what} run the same command again, finished scenes are kept"
        return RunStoppedError(self._ended)

    def create(self, name: str, text: str) -> bool:
        """Write a file unless there is one of that name; of several who try at once, one does."""
        try:
            self.patiently(lambda: self._create(name, text.encode()))
        except FileExistsError:
            return False
        if self.patiently(lambda: self.place.filesystem.info(self._path(name)))["size"] != len(text):  # half of it came
            self.write(name, text.encode())
        return True

    def _create(self, name: str, content: bytes) -> None:
        try:
            self.place.filesystem.pipe_file(self._path(name), content, mode="create")
        except OSError as error:  # s3fs knows S3's own answer only
            response = getattr(error.__cause__, "response", None) or {}
            if response.get("Error", {}).get("Code") in ("PreconditionFailed", "412"):
                raise FileExistsError(name) from None
            raise

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all, in place of what is there."""

        def act() -> None:
            self.place.filesystem.pipe_file(self._path(name), content)
            self._check(name, len(content))

        self.patiently(act)

    def read(self, name: str) -> bytes | None:
        """Read a small file; None where there is none."""
        with contextlib.suppress(FileNotFoundError):
            return bytes(self.patiently(lambda: self.place.filesystem.cat_file(self._path(name))))
        return None

    def tag(self, name: str) -> str | None:
        """Return what changes with a file's content or time; None where there is none."""
        with contextlib.suppress(FileNotFoundError):
            about = self.patiently(lambda: self.place.filesystem.info(self._path(name)))
            return str(about.get("ETag") or about.get("etag") or about.get("mtime") or about.get("created"))
        return None

    def files(self, folder: str) -> dict[str, int | None]:
        """List all files under a folder with their sizes, by name from there."""
        start = self._path(folder).rstrip("/") + "/"
        entries = self.patiently(lambda: self.place.filesystem.find(start, detail=True))
        names = {path.lstrip("/").removeprefix(start.lstrip("/")): about for path, about in entries.items()}
        return {name: about.get("size") for name, about in names.items() if name and about["type"] == "file"}

    def remove(self, names: Iterable[str]) -> None:
        """Remove files, as far as they are there."""
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                self.patiently(lambda name=name: self.place.filesystem.rm_file(self._path(name)))  # type: ignore[misc]

    def send(self, path: Path, name: str) -> None:
        """Send a file, a large one in parts, and see that all of it has come."""

        def act() -> None:
            size = path.stat().st_size
            with contextlib.suppress(FileNotFoundError):  # the answer that its parts are together was lost
                self.place.filesystem.put_file(str(path), self._path(name))
            self._check(name, size)

        self.patiently(act)

    def _check(self, name: str, size: int) -> None:
        """Raise `OSError` where a file is not of that size."""
        found = 0
        with contextlib.suppress(FileNotFoundError):
            found = self.place.filesystem.info(self._path(name))["size"]
        if found != size:
            raise OSError(f"{found} of {size} bytes have come")

    def _path(self, name: str) -> str:
        return f"{self.place.root}/{name}"


def row_file(row: Row) -> str:
    """Return the name of the file that holds a row until an index has it."""
    return f"{ROWS}/{row['index']:06d}-{row['record_sha256'][:16]}.json"


def send_scene(remote: Remote, root: Path, row: Row, credits: Iterable[AssetCredit], *, replace: bool) -> None:
    """Send a finished scene, its row before, its record last: until then it is not there. It goes from here."""
    index = row["index"]
    folder, here = scene_folder(index), scene_dir(root, index)
    names = sorted(path.relative_to(here).as_posix() for path in here.rglob("*") if path.is_file())
    if replace:
        found = remote.files(folder)
        remote.remove(f"{folder}/{name}" for name in sorted(found, key=lambda name: name != "scene.json"))
    told = {"row": row, "credits": [credit.model_dump() for credit in credits]}
    remote.write(row_file(row), json.dumps(told).encode())
    largest = max((here / name).stat().st_size for name in names)
    with ThreadPoolExecutor(max(1, min(AT_ONCE, IN_MEMORY // largest))) as pool:
        list(pool.map(lambda n: remote.send(here / n, f"{folder}/{n}"), (n for n in names if n != "scene.json")))
    remote.send(here / "scene.json", f"{folder}/scene.json")
    shutil.rmtree(here)
