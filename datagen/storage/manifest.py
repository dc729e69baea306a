"""The manifest of a packed copy or an export: `manifest.json`, every file with its size and hash.

It is written last, so a folder without it is not finished. `datagen.storage.copies` makes it,
`datagen.verification.copies` checks by it.
"""

import hashlib
import json
import os
import shlex
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.store import file_sha256, scene_folder, write_text
from multilight.scenes.frozen import Frozen

MANIFEST = "manifest.json"
JOURNAL = ".manifest.jsonl"
"""The manifest of what is being made: a line for what is alike everywhere, then one for each part."""
Kind = Literal["packed", "dtc-multilight", "webdataset", "nerfstudio", "colmap", "luxremix", "usd", "web"]
Settings = dict[str, str | int | float | bool | None]


@dataclass(frozen=True)
class FileEntry:
    """A file's size and hash."""

    bytes: int
    sha256: str


class Origin(Frozen):
    """The dataset that something was made from.

    `record_sha256` is its record's, which changes with every scene; `configuration_sha256` stays when it grows.
    """

    address: str
    record_sha256: str
    configuration_sha256: str


class ScenePart(Frozen):
    """The scene that a part was made from: index, and hash of its `scene.json`."""

    scene: int
    record_sha256: str


class Manifest(Frozen):
    """What a packed copy or an export holds.

    `parts` are the folders made of one scene each (in tars: the first six digits of the names of what is made of it);
    `files` go by their path from the root, with slashes; `manifest_sha256` is the hash of all else in here.
    """

    format: Literal["multilight manifest 1"] = "multilight manifest 1"
    kind: Kind
    version: str
    source: Origin
    settings: Settings
    parts: dict[str, ScenePart] = Field(default_factory=dict)
    files: dict[str, FileEntry] = Field(default_factory=dict)
    manifest_sha256: str = ""

    def sealed(self) -> "Manifest":
        """Return the manifest with its own hash."""
        return self.model_copy(update={"manifest_sha256": self.model_copy(update={"manifest_sha256": ""}).sha256()})


@dataclass(frozen=True)
class CopyFault:
    """One thing that is wrong with a file of a copy, in the words a user needs."""

    file: str
    check: str
    message: str


def write_manifest(root: Path, manifest: Manifest) -> None:
    """Write `manifest.json`, a line a file."""
    head = json.dumps(manifest.sealed().model_dump(exclude={"files"}), indent=1, sort_keys=True).removesuffix("\n}")
    lines = [f"  {json.dumps(name)}: {json.dumps(asdict(entry))}" for name, entry in sorted(manifest.files.items())]
    write_text(root / MANIFEST, f'{head},\n "files": {{\n' + ",\n".join(lines) + "\n }\n}\n")


def read_manifest(root: Path) -> Manifest:
    """Read `manifest.json`; raises `StoreError` where there is none, or it is damaged, and where work goes on."""
    path = root / MANIFEST
    if (root / JOURNAL).exists():
        raise StoreError(f"{root} is not finished; run the command that makes it again, it goes on where it was")
    try:
        return parse_manifest(path.read_bytes(), str(path))
    except FileNotFoundError:
        raise StoreError(
            f"{path} is missing: {root} is not finished, or made by an older version; remove it and make it anew"
        ) from None
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror}") from None


def parse_manifest(content: bytes, name: str) -> Manifest:
    """Understand the content of a `manifest.json`; raises `StoreError` with `name` and the reason."""
    try:
        manifest = Manifest.from_json(content.decode())
    except (ValidationError, UnicodeDecodeError):
        raise StoreError(
            f"{name} is damaged or of another version; remove it and its folder and make them anew"
        ) from None
    if manifest.sealed() != manifest:
        raise StoreError(f"{name} is damaged: it is not what its own hash says; make it and its folder anew")
    return manifest


def remedy(manifest: Manifest, root: str) -> str:
    """Say the command that makes what is damaged or missing anew."""
    words = ["pack"] if manifest.kind == "packed" else ["export", manifest.kind]
    for key, value in manifest.settings.items():
        option = f"--{key.replace('_', '-')}"
        words += [option] if value is True else [] if value in (None, False) else [option, str(value)]
    return f"made anew by: multilight {shlex.join([*words, manifest.source.address, '--out', root])}"


def files_under(folder: Path) -> dict[str, int | None]:
    """List everything under a folder by its path from there: sizes of files; None for links, devices, empty folders."""
    found: dict[str, int | None] = {}
    waiting = [(folder, "")]
    while waiting:
        place, prefix = waiting.pop()
        with os.scandir(place) as entries:
            inside = list(entries)
        if not inside and prefix:
            found[prefix] = None
        for entry in inside:
            if entry.is_dir(follow_symlinks=False):
                waiting.append((Path(entry.path), f"{prefix}{entry.name}/"))
            else:
                plain = entry.is_file(follow_symlinks=False)
                found[prefix + entry.name] = entry.stat(follow_symlinks=False).st_size if plain else None
    return found


def hashed(root: Path, names: Iterable[str]) -> Iterator[tuple[str, FileEntry]]:
    """Hash files, as many at a time as there are cores; hard links of one file are read once."""
    groups: dict[tuple[int, int], list[str]] = defaultdict(list)
    for name in names:
        about = (root / name).stat(follow_symlinks=False)
        groups[about.st_dev, about.st_ino].append(name)

    def entry(group: list[str]) -> FileEntry:
        path = root / group[0]
        return FileEntry(bytes=path.stat().st_size, sha256=file_sha256(path))

    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        for group, found in zip(groups.values(), pool.map(entry, groups.values()), strict=True):
            for name in group:
                yield name, found


def size_fault(files: Mapping[str, FileEntry], found: Mapping[str, int | None]) -> Iterator[CopyFault]:
    """Compare names and sizes: what is missing, too much, no file, or of another size."""
    emptied = {f"{parent}/" for name in files.keys() - found.keys() for parent in Path(name).parents}
    for name in sorted((files.keys() | found.keys()) - emptied):
        if name not in found:
            yield CopyFault(name, "missing", "is missing")
        elif name not in files:
            yield CopyFault(name, "extra", f"is not in {MANIFEST}")
        elif found[name] is None:
            yield CopyFault(name, "size", "is not a plain file")
        elif found[name] != files[name].bytes:
            yield CopyFault(name, "size", f"has {found[name]} bytes, {MANIFEST} states {files[name].bytes}")


def origin_of(source: DatasetSource) -> Origin:
    """Say which dataset this is."""
    record = source.record
    same = {"renderer": record.renderer, "config": record.config.model_dump(mode="json", exclude={"scenes"})}
    text = json.dumps(same, sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()
    return Origin(address=source.address, record_sha256=record.record_sha256, configuration_sha256=digest)


def scene_part(source: DatasetSource, index: int) -> ScenePart:
    """Say which scene of a dataset, in which state, something is made from; raises `StoreError` where it is missing."""
    name = f"{scene_folder(index)}/scene.json"
    with source.local(name) as path:
        try:
            return ScenePart(scene=index, record_sha256=file_sha256(path))
        except OSError as error:
            raise StoreError(f"{source.address}/{name}: {error.strerror}") from None
