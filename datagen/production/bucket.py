"""A dataset that is made at an address: scenes go there when they are whole, and leave this machine.

While the place is held, by an object `.drivers/lock`, `dataset.json` and the index are copied to a folder here, where
they are worked on as in any other folder; what has changed goes back. Claims and lock are objects that are written on
the condition that there is none; a run's state, `.drivers/TOKEN.json`, written every few seconds, is its sign of life.
"""

import contextlib
import json
import os
import shutil
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.files.locks import locked
from multilight.datagen.production.aside import FOLDER as ASIDE
from multilight.datagen.production.drivers import BEAT, FOLDER, Driver
from multilight.datagen.production.finishing import Survey, finish, look
from multilight.datagen.production.homes import PATIENCE
from multilight.datagen.production.remote import ROWS, Remote, row_file
from multilight.datagen.production.shards import Shard
from multilight.datagen.storage.address import Place, find_place
from multilight.datagen.storage.blocks import block_file, read_blocks, stated_blocks
from multilight.datagen.storage.index import Row
from multilight.datagen.storage.records import AssetCredit, view_file
from multilight.datagen.storage.store import file_sha256, parse_dataset, read_dataset, scene_folder, scene_number
from multilight.datagen.verification.dataset import PREVIEW


class BucketDriver(Driver):
    """One run among those that work on a dataset at an address."""

    def __init__(self, remote: Remote) -> None:
        """Join the runs there."""
        self.token, self._remote = uuid.uuid4().hex[:12], remote
        self._seen = {}
        self._state: Callable[[], str] = str
        self._over = threading.Event()
        self._tell()
        if self._create(f"{self.token}.json"):
            print(
                f"{remote.place.address} writes over files that it should not: no more than one run at a time, please",
                file=sys.stderr,
            )
        self._beating = threading.Thread(target=self._beat, daemon=True)
        self._beating.start()

    def leave(self) -> None:
        """Leave, once; the last one takes with it what only served the work."""
        if self._over.is_set():
            return
        self._over.set()
        self._beating.join()
        alone = not self.others()
        names = [*self._remote.files(FOLDER)] if alone else []
        self._remote.remove(f"{FOLDER}/{name}" for name in names if name != "lock")
        self._remove(f"{self.token}.json")

    def lives(self, token: str) -> bool:
        """Whether a run has given a sign of life lately."""
        said = self._read(f"{token}.json")
        return said is not None and self._fresh(token, hash(said))

    def begin(self, shard: Shard) -> None:
        """Say that a part is begun."""
        self._create(f"shard-{shard.number}-{shard.count}")

    def begun(self, shard: Shard) -> bool:
        """Whether a run of that part has ever been at work here."""
        return self._read(f"shard-{shard.number}-{shard.count}") is not None

    def others(self) -> list[str]:
        """List the other runs that live."""
        tokens = {name.removesuffix(".json") for name in self._remote.files(FOLDER) if name.endswith(".json")}
        return [token for token in tokens - {self.token} if self.lives(token)]

    @contextlib.contextmanager
    def holding(self) -> Iterator[None]:
        """Be the one run that holds the place; the lock of a dead one is broken, by one of those who see it."""
        until = time.monotonic() + PATIENCE
        while not self._create("lock"):
            holder = self._read("lock")
            if holder == self.token:  # the answer to an earlier try was lost
                break
            if holder and not self.lives(holder):
                breaker = f"lock-of-{holder}"
                if self._create(breaker):
                    self._remove("lock")
                elif (by := self._read(breaker)) and not self.lives(by):
                    self._remove(breaker)
            elif time.monotonic() > until:
                raise UserError(f"{self._remote.place.address} is being finished by another run; try again later")
            time.sleep(0.2)
        try:
            yield
        finally:
            if self._read("lock") == self.token:
                self._remove("lock")

    def _beat(self) -> None:
        while not self._over.wait(BEAT):
            with contextlib.suppress(UserError, OSError):  # told where work needs the place
                self._tell()

    def _tell(self) -> None:
        self._write(f"{self.token}.json", self._state() or str(time.monotonic()))

    def _create(self, name: str) -> bool:
        return self._remote.create(f"{FOLDER}/{name}", self.token)

    def _read(self, name: str) -> str | None:
        content = self._remote.read(f"{FOLDER}/{name}")
        return None if content is None else content.decode(errors="replace")

    def _write(self, name: str, text: str) -> None:
        self._remote.write(f"{FOLDER}/{name}", text.encode())

    def _remove(self, name: str) -> None:
        self._remote.remove([f"{FOLDER}/{name}"])


class Bucket:
    """A dataset at an address; `root` is a folder here that nothing else uses."""

    pause = 5.0

    def __init__(self, address: str, root: Path) -> None:
        """Join the runs at work there; raises `UserError` where it cannot be written."""
        self.root, self._remote, self._aside = root, Remote(address), dict[str, str]()
        try:
            self._driver = BucketDriver(self._remote)
        except FileNotFoundError:
            raise UserError(f"{self.place.address} cannot be written: there is no such bucket; make it first") from None

    @property
    def place(self) -> Place:
        """Where the dataset lies."""
        return self._remote.place

    def close(self) -> None:
        """Leave, if that is not done."""
        with contextlib.suppress(UserError):
            self._driver.leave()

    @property
    def retried(self) -> list[str]:
        """A word on each request that was tried again."""
        return self._remote.retried

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Be the one run that looks at index and `dataset.json`, here, and send what has changed of them."""
        with self._driver.holding():
            before = self._fetch()
            yield
            self._send(before)

    def join(self, shard: Shard | None) -> Driver:
        """Join the runs at work there."""
        if shard is not None:
            self._driver.begin(shard)
        return self._driver

    def survey(self, *, contents: bool) -> Survey:
        """Look at what is there: one listing, and the rows that no index has yet."""
        dataset = read_dataset(self.root)
        index = read_blocks(find_place(self.root), dataset)
        scenes: dict[int, dict[str, int | None]] = {}
        for name, size in self._remote.files("scenes").items():
            number = scene_number(name.partition("/")[0])
            if number is not None and number < dataset.config.scenes:
                scenes.setdefault(number, {})[name.partition("/")[2]] = size
        there = sorted(number for number, files in scenes.items() if "scene.json" in files)
        stated = {row["index"]: row for table in index.sound().values() for row in table.iter_rows(named=True)}
        waiting = self._waiting(stated)
        fresh = [n for n in there if n in waiting and not contents and _whole(scenes[n], waiting[n][0])]
        found = look(
            self.place, sorted({*there} - {*fresh}), dataset, index,
            lambda number, *_: _whole(scenes[number], stated[number]), contents=contents,
        )  # fmt: skip
        for number in fresh:
            found.damaged.pop(number, None)
            found.add(*waiting[number])
        return found

    def finish(self, there: Survey) -> None:
        """Bring index and `dataset.json`, here, up to what is there."""
        if read_blocks(find_place(self.root), read_dataset(self.root)).faults.keys() - there.unread:
            again = self.survey(contents=False)
            there.rows.update(again.rows | there.rows)
            there.credits.update(again.credits)
            there.unread.update(again.unread)
        finish(self.root, there, self.place)

    def state(self, index: int) -> object:
        """Return the tag of a scene's record."""
        return self._remote.tag(f"{scene_folder(index)}/scene.json")

    def _waiting(self, stated: dict[int, Row]) -> dict[int, tuple[Row, list[AssetCredit]]]:
        """Read the rows of scenes that the index lacks."""
        known = {row_file(row) for row in stated.values()}
        found = {}
        for name in self._remote.files(ROWS):
            if f"{ROWS}/{name}" not in known and (content := self._remote.read(f"{ROWS}/{name}")):
                with contextlib.suppress(ValueError, KeyError):  # what is damaged is read from the record
                    told = json.loads(content)
                    credits = [AssetCredit.model_validate(credit) for credit in told["credits"]]
                    found[told["row"]["index"]] = told["row"], credits
        return found

    def _fetch(self) -> dict[str, str]:
        """Have `dataset.json`, the index and what is set aside here; return the hashes of their files."""
        content = self._remote.read("dataset.json")
        if content is None:
            if any(not name.startswith(".") for name in self._remote.files("")):
                raise UserError(f"{self.place.address} holds other files and no dataset.json; choose an empty --out")
            return {}
        (self.root / "dataset.json").write_bytes(content)
        names = ["dataset.json"]
        with contextlib.suppress(StoreError):  # told where it is opened
            names += map(block_file, stated := stated_blocks(parse_dataset(content, "")))
            for number, digest in stated.items():
                path = self.root / block_file(number)
                if path.is_file() and file_sha256(path) == digest:
                    continue
                path.parent.mkdir(exist_ok=True)
                path.unlink(missing_ok=True)
                if (block := self._remote.read(block_file(number))) is not None:
                    path.write_bytes(block)
        for name in (f"{ASIDE}/{file}" for file in self._remote.files(ASIDE)):
            path = self.root / name
            if name not in self._aside and not path.exists() and (said := self._remote.read(name)) is not None:
                path.parent.mkdir(exist_ok=True)
                path.write_bytes(said)
                self._aside[name] = file_sha256(path)
        return self._aside | {name: file_sha256(self.root / name) for name in names if (self.root / name).is_file()}

    def _send(self, before: dict[str, str]) -> None:
        """Send what has changed, `dataset.json` last, and remove rows that the index has now."""
        dataset = read_dataset(self.root)
        aside = [f"{ASIDE}/{path.name}" for path in self.root.glob(f"{ASIDE}/*")]
        names = [*aside, *map(block_file, stated_blocks(dataset)), "dataset.json"]
        now = {name: file_sha256(self.root / name) for name in names if (self.root / name).is_file()}
        changed = [name for name, digest in now.items() if before.get(name) != digest]
        for name in changed:
            self._remote.write(name, (self.root / name).read_bytes())
        self._remote.remove(before.keys() - now.keys())
        self._aside = {name: now[name] for name in aside}
        if changed:
            tables = read_blocks(find_place(self.root), dataset).sound().values()
            known = {row_file(row) for table in tables for row in table.iter_rows(named=True)}
            self._remote.remove(known & {f"{ROWS}/{name}" for name in self._remote.files(ROWS)})


def _whole(files: dict[str, int | None], row: Row) -> bool:
    """Whether all files of a scene are there, their views of that size in all."""
    views = [files.get(view_file(view)) for view in range(row["views"])]
    return PREVIEW in files and None not in views and sum(size or 0 for size in views) == row["bytes"]


@contextlib.contextmanager
def stage() -> Iterator[Path]:
    """Lend a folder for what is in work, gone afterwards; those of runs that were killed go as well."""
    base = Path(tempfile.gettempdir(), f"multilight-{os.getuid()}")
    base.mkdir(mode=0o700, exist_ok=True)
    if base.is_symlink() or base.stat().st_uid != os.getuid():
        raise UserError(f"{base} is not this user's; set TMPDIR to another folder")
    own = base / uuid.uuid4().hex[:12]
    with contextlib.ExitStack() as stack:
        with locked(base, PATIENCE):
            for old in base.iterdir():
                with contextlib.suppress(UserError):  # its run lives
                    if old.is_dir():
                        with locked(old):
                            shutil.rmtree(old, ignore_errors=True)
            stack.enter_context(locked(own))
        try:
            yield own
        finally:
            shutil.rmtree(own, ignore_errors=True)
