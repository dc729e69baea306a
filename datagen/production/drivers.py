"""Several runs on one folder: which of them live, and which scene is in whose hands.

A run has a file of its own, `.drivers/TOKEN`, which is locked while it lives (the kernel lets go with the process) and
touched every few seconds, for other machines to see; `.drivers/TOKEN.json` says what it does. `.drivers/000123` holds
the token of the run that makes a scene.
A mark, `.drivers/shard-2-8`, says that a part was begun: those who are done with their own help with begun ones only.

Claims save work, nothing hangs on them: a scene is the same whoever makes it, and gets its name whole or not at all. So
a claim that is taken over while its holder still works costs time, and no clock is compared with another's.
"""

import contextlib
import fcntl
import os
import shutil
import threading
import time
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import IO

from multilight.datagen.production.shards import Shard
from multilight.scenes.files.atomic import write_whole

FOLDER = ".drivers"
BEAT = 5.0
"""Seconds from one sign of life to the next."""
LEASE = 60.0
"""Seconds without a sign of life after which a run on another machine counts as dead, by the watcher's own clock."""


class Driver:
    """One run among those that work on a dataset's folder; `token` names it."""

    def __init__(self, root: Path, shard: Shard | None = None) -> None:
        """Join the runs on a folder, and clear away what dead ones left; to be called under the folder's lock."""
        self.token = uuid.uuid4().hex[:12]
        self._root, self._folder = root, root / FOLDER
        self._seen: dict[str, tuple[int, float]] = {}
        self._folder.mkdir(exist_ok=True)
        for path in (*self._folder.glob("?" * len(self.token)), *self._folder.glob(".*.tmp*")):
            if not self.lives(path.name):
                path.unlink(missing_ok=True)
                path.with_suffix(".json").unlink(missing_ok=True)
        if not self.others():
            shutil.rmtree(root / "logs", ignore_errors=True)
        for path in root.glob("work/*"):
            if not self.lives(path.name.rpartition("-")[2]):
                shutil.rmtree(path, ignore_errors=True)
        self._file = self._begun()
        if shard is not None:
            (self._folder / f"shard-{shard.number}-{shard.count}").touch()
        self._over = threading.Event()
        self._state: Callable[[], str] = str
        self._beating = threading.Thread(target=self._beat, daemon=True)
        self._beating.start()

    def tells(self, state: Callable[[], str]) -> None:
        """Have the run's state written with each sign of life, for others to see."""
        self._state = state
        self._tell()

    def claim(self, scene: int) -> bool:
        """Take a scene in hand; not if a run that lives has it."""
        name = f"{scene:06d}"
        if self._create(name) or (holder := self._read(name)) == self.token:
            return True
        if holder is None or self.lives(holder):
            return False
        self._write(name, self.token)  # of two that see so at once, both may make the scene
        return True

    def release(self, scene: int) -> None:
        """Let go of a scene, made or not."""
        self._remove(f"{scene:06d}")

    def begun(self, shard: Shard) -> bool:
        """Whether a run of that part has ever been at work here."""
        return (self._folder / f"shard-{shard.number}-{shard.count}").exists()

    def others(self) -> list[str]:
        """List the other runs that live."""
        found = (path.name for path in self._folder.glob("?" * len(self.token)))
        return [token for token in found if token != self.token and self.lives(token)]

    def leave(self) -> None:
        """Leave; the last one takes with it what only served the work. To be called under the folder's lock."""
        self._over.set()
        self._beating.join()
        (self._folder / self.token).unlink(missing_ok=True)
        (self._folder / f"{self.token}.json").unlink(missing_ok=True)
        self._file.close()
        for path in self._root.glob(f"work/*-{self.token}"):
            shutil.rmtree(path, ignore_errors=True)
        if not self.others():
            shutil.rmtree(self._folder, ignore_errors=True)
            shutil.rmtree(self._root / "work", ignore_errors=True)

    def lives(self, token: str) -> bool:
        """Whether a run lives: it holds its lock, if it is of this machine; else it gave a sign of life lately."""
        path = self._folder / token
        try:
            with path.open("r+") as file:
                if file.read() == _machine():
                    try:
                        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    except BlockingIOError:
                        return True
                    return False
                beat = os.fstat(file.fileno()).st_mtime_ns
        except OSError:
            return token == "" and self._fresh(token, 0)  # a claim that is just being written
        return self._fresh(token, beat)

    def _fresh(self, token: str, beat: int) -> bool:
        now = time.monotonic()
        seen, since = self._seen.get(token, (None, now))
        if seen != beat:
            since = now
        self._seen[token] = beat, since
        return now - since < LEASE

    def _begun(self) -> IO[str]:
        """Make this run's file, locked before it has its name."""
        path = self._folder / f".{self.token}.tmp"
        file = path.open("w")
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(_machine())
        file.flush()
        path.rename(self._folder / self.token)
        return file

    def _beat(self) -> None:
        while not self._over.wait(BEAT):
            with contextlib.suppress(OSError):
                os.utime(self._folder / self.token)
            self._tell()

    def _tell(self) -> None:
        if said := self._state():
            self._write(f"{self.token}.json", said)

    def _create(self, name: str) -> bool:
        """Write the token into a file, unless there is one of that name."""
        with contextlib.suppress(FileExistsError), (self._folder / name).open("x") as file:
            file.write(self.token)
            return True
        return False

    def _read(self, name: str) -> str | None:
        with contextlib.suppress(OSError):
            return (self._folder / name).read_text(encoding="utf-8")
        return None

    def _write(self, name: str, text: str) -> None:
        with contextlib.suppress(OSError), write_whole(self._folder / name) as work:
            work.write_text(text, encoding="utf-8")

    def _remove(self, name: str) -> None:
        (self._folder / name).unlink(missing_ok=True)


def _machine() -> str:
    """Name the machine, as long as it runs."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
