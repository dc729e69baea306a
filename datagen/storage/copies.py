"""Making a packed copy or an export: one run at a time, part by part, each whole or not at all, the manifest last.

    with making(out, "usd", source, {}) as copy:
        for record in source.scenes():
            if not copy.keeps("scene_000000", record.index):
                with copy.filling_part("scene_000000", record.index) as folder:
                    ...

What was stopped goes on where it was: each part is written down as it is done. What is damaged, or made from another
state of its scene, is made anew.
"""

import contextlib
import importlib.metadata
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from multilight.datagen.errors import RunStoppedError, UserError, full_disk_told
from multilight.datagen.files.locks import LOCK, locked
from multilight.datagen.storage.manifest import (
    JOURNAL,
    MANIFEST,
    FileEntry,
    Kind,
    Manifest,
    ScenePart,
    Settings,
    files_under,
    hashed,
    origin_of,
    parse_manifest,
    scene_part,
    size_fault,
    write_manifest,
)
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.store import file_inside, write_text

WORK = "work"
"""Folder in the root where parts are made."""
Files = Mapping[str, FileEntry]
_Job = TypeVar("_Job")
_Made = TypeVar("_Made")
_JOURNALLED: TypeAdapter[tuple[str, ScenePart, dict[str, FileEntry]]] = TypeAdapter(
    tuple[str, ScenePart, dict[str, FileEntry]]
)


@contextlib.contextmanager
def whole_folder(root: Path, name: str) -> Iterator[Path]:
    """Lend an empty folder to be filled, and make it `root/name` at the end, in place of what is there."""
    partial = root / WORK / uuid.uuid4().hex
    partial.mkdir(parents=True)
    try:
        with full_disk_told(root):
            yield partial
            final = file_inside(root, name)  # whatever was put in the way
            final.parent.mkdir(parents=True, exist_ok=True)
            if final.is_dir() and not final.is_symlink():
                shutil.rmtree(final)
            else:
                final.unlink(missing_ok=True)
            partial.replace(final)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def files_of(root: Path, name: str) -> dict[str, FileEntry]:
    """Hash all files of a finished folder; names are from the root."""
    return dict(hashed(root, [f"{name}/{file}" for file in sorted(files_under(root / name))]))


class Copy:
    """A copy in the making. `changed` says whether anything was made in this run."""

    def __init__(self, root: Path, source: DatasetSource, head: Manifest, begun: Manifest) -> None:
        """Take up what is recorded in `begun`, of earlier runs; `head` is the manifest to be, yet without files."""
        self.root, self._source, self._head, self._begun, self.changed = root, source, head, begun, False
        self._states: dict[int, ScenePart] = {}
        self._parts = dict(begun.parts)
        self._files: dict[str, dict[str, FileEntry]] = {name: {} for name in self._parts}
        for name, entry in begun.files.items():
            folders = [str(parent) for parent in Path(name).parents]
            owner = next((folder for folder in folders if folder in self._parts), None)
            if owner is not None:
                self._files[owner][name] = entry

    @property
    def parts(self) -> Mapping[str, ScenePart]:
        """What is recorded already, of earlier runs as well."""
        return self._parts

    def state(self, scene: int) -> ScenePart:
        """Say in which state a scene was when it was asked for first; raises `StoreError` where it is missing."""
        if scene not in self._states:
            self._states[scene] = scene_part(self._source, scene)
        return self._states[scene]

    def keeps(self, name: str, scene: int) -> bool:
        """Say whether a folder is there, made from this very state of its scene, and as it was written, to the byte."""
        files, folder = self._files.get(name, {}), self.root / name
        if self._parts.get(name) != self.state(scene) or not folder.is_dir():
            return False
        found = {f"{name}/{file}": size for file, size in files_under(folder).items()}
        return not any(size_fault(files, found)) and dict(hashed(self.root, files)) == files

    @contextlib.contextmanager
    def filling_part(self, name: str, scene: int) -> Iterator[Path]:
        """Lend an empty folder for what is made of a scene; at the end it gets its name, and is recorded."""
        self.state(scene)
        with whole_folder(self.root, name) as folder:
            yield folder
        self.add(name, scene, files_of(self.root, name))

    def add(self, name: str, scene: int, files: Files) -> None:
        """Record a folder that is made, so that it is kept from now on."""
        if not self.changed:
            self.reopen()
        self._parts[name], self._files[name] = self.state(scene), dict(files)
        self._append(name)

    def holds(self, scenes: Iterable[int]) -> bool:
        """Say whether a finished copy that was made in one piece is that of these scenes, and as it was written.

        Raises `UserError` where it is of others.
        """
        parts = {f"{scene:06d}": self.state(scene) for scene in scenes}
        if not self._begun.parts:
            return False
        if self._parts != parts:
            raise UserError(f"--out {self.root} is of other scenes, or of another state of them; give another folder")
        found = {path.name: path.stat().st_size for path in self.root.iterdir() if path.is_file()}
        wanted = {name: entry for name, entry in self._begun.files.items() if found.get(name) == entry.bytes}
        return dict(hashed(self.root, wanted)) == self._begun.files

    @contextlib.contextmanager
    def filling(self) -> Iterator[tuple[Path, list[int]]]:
        """Lend an empty folder for a copy that is made in one piece, and a list for the scenes that go in.

        At the end its files go to the root, and the copy is finished.
        """
        work = self.root / WORK / "all"
        work.mkdir(parents=True)
        scenes: list[int] = []
        yield work, scenes
        self._parts, self._files = {}, {}
        self.reopen()
        for old in self._begun.files:
            (self.root / old).unlink(missing_ok=True)
        made = [path.replace(self.root / path.name).name for path in sorted(work.iterdir())]
        self._parts = {f"{scene:06d}": self.state(scene) for scene in scenes}
        self.finish(*made)

    def finish(self, *others: str) -> None:
        """Write the manifest, and remove what is left; `others` are files in the root that were written besides."""
        shutil.rmtree(self.root / WORK, ignore_errors=True)
        files = {name: entry for folder in self._files.values() for name, entry in folder.items()}
        files |= dict(hashed(self.root, others))
        whole = self._head.model_copy(update={"parts": dict(sorted(self._parts.items())), "files": files})
        if self.changed or whole.sealed() != self._begun:
            self.changed = True
            write_manifest(self.root, whole)
        (self.root / JOURNAL).unlink(missing_ok=True)

    def reopen(self) -> None:
        """Write down what there is as unfinished."""
        self.changed = True
        write_text(self.root / JOURNAL, self._head.model_dump_json() + "\n")
        for name in self._parts:
            self._append(name)
        (self.root / MANIFEST).unlink(missing_ok=True)

    def _append(self, name: str) -> None:
        with (self.root / JOURNAL).open("ab") as journal:
            journal.write(_JOURNALLED.dump_json((name, self._parts[name], self._files[name])) + b"\n")


@contextlib.contextmanager
def making(root: Path, kind: Kind, source: DatasetSource, settings: Settings) -> Iterator[Copy]:
    """Begin a copy or go on with it, alone in its folder.

    Raises `UserError` where there is no scene, and where the folder cannot be written, is being made, is full, or holds
    something else: other files, a copy of another dataset, of scenes that this one has not, or one made with other
    settings, `where` among them.
    """
    if not source.indices:
        chosen = f" for which {source.where}" if source.where else "; make some with: multilight dataset"
        raise UserError(f"{source.address} holds no finished scene{chosen}")
    settings = settings if source.where is None else settings | {"where": source.where}
    origin = origin_of(source)
    head = Manifest(kind=kind, version=importlib.metadata.version("multilight"), source=origin, settings=settings)
    with locked(root), full_disk_told(root):
        begun = _begun(root)
        if begun is None:
            if any(path.name != LOCK for path in root.iterdir()):
                raise UserError(
                    f"--out {root} is not empty, and neither a packed copy nor an export with a {MANIFEST}; "
                    "give another folder"
                )
        else:
            _check_same(root, begun, head, source.indices)
            shutil.rmtree(root / WORK, ignore_errors=True)
        copy = Copy(root, source, head, begun or head)
        if begun is None:
            copy.reopen()
        try:
            yield copy
        except BaseException:
            shutil.rmtree(root / WORK, ignore_errors=True)
            if not copy.parts:  # nothing to go on with
                (root / JOURNAL).unlink(missing_ok=True)
            raise


def in_processes(
    call: Callable[[_Job], _Made], jobs: Sequence[_Job], workers: int
) -> Iterator[tuple[_Job, Callable[[], _Made]]]:
    """Yield each job as it ends, with what returns or raises as its call did; of one worker each job runs in here.

    Raises `RunStoppedError` where a worker process was killed.
    """
    if workers == 1:
        yield from ((job, partial(call, job)) for job in jobs)
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {pool.submit(call, job): job for job in jobs}
        try:
            for future in as_completed(running):
                if isinstance(future.exception(), BrokenProcessPool):
                    raise RunStoppedError(
                        "a worker process was killed, probably for want of memory; finished scenes are kept: "
                        "run the same command again with a smaller --workers"
                    )
                yield running[future], future.result
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _begun(root: Path) -> Manifest | None:
    """Read what an earlier run has left: a journal, up to where it was cut, or a manifest."""
    journal, path = root / JOURNAL, root / MANIFEST
    if not journal.exists():
        return parse_manifest(path.read_bytes(), str(path)) if path.exists() else None
    lines = journal.read_bytes().splitlines()
    try:
        head = Manifest.from_json(lines[0].decode())
    except (IndexError, UnicodeDecodeError, ValidationError):
        raise UserError(f"{journal} is damaged; remove {root} and make it anew") from None
    made: dict[str, tuple[ScenePart, dict[str, FileEntry]]] = {}
    for line in lines[1:]:
        with contextlib.suppress(ValidationError):  # what is cut was not finished, and is made anew
            name, part, entries = _JOURNALLED.validate_json(line)
            made[name] = part, entries
    files = {file: entry for _, entries in made.values() for file, entry in entries.items()}
    return head.model_copy(update={"parts": {name: part for name, (part, _) in made.items()}, "files": files})


def _check_same(root: Path, begun: Manifest, wanted: Manifest, scenes: Sequence[int]) -> None:
    if begun.kind != wanted.kind:
        raise UserError(f"--out {root} holds {_named(begun)}, not {_named(wanted)}; give another folder")
    if begun.source.configuration_sha256 != wanted.source.configuration_sha256:
        raise UserError(
            f"--out {root} holds another dataset: {_named(begun)}, not {_named(wanted)}; give another folder"
        )
    for key in wanted.settings | begun.settings:
        if (before := begun.settings.get(key)) != (value := wanted.settings.get(key)):
            raise UserError(f"--out {root} was made with {key} = {before}, not {value}; give another folder")
    if gone := sorted({part.scene for part in begun.parts.values()} - set(scenes)):
        raise UserError(
            f"--out {root} holds scene {gone[0]}, which {wanted.source.address} has not; give another folder"
        )


def _named(manifest: Manifest) -> str:
    made = "packed copy" if manifest.kind == "packed" else f"export ({manifest.kind})"
    return f"the {made} of {manifest.source.address}"
