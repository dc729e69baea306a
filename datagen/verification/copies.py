"""Check packed copies and exports by their manifest: the command `verify` on what is made from a dataset."""

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.files.locks import LOCK
from multilight.datagen.storage.manifest import (
    JOURNAL,
    MANIFEST,
    CopyFault,
    Manifest,
    files_under,
    hashed,
    origin_of,
    read_manifest,
    remedy,
    scene_part,
    size_fault,
)
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.open_training import VISIBLE
from multilight.datagen.storage.packed import read_packed
from multilight.datagen.storage.store import scene_folder
from multilight.datagen.text import plain


def copy_at(address: str) -> Path | None:
    """Return the folder where a packed copy or an export lies, finished or not; None where there is none.

    Raises `UserError` where it is a packed copy at another address than a folder's.
    """
    root = Path(address)
    if root.is_dir():
        return root if any((root / name).exists() for name in (MANIFEST, JOURNAL, VISIBLE)) else None
    source = open_dataset(address)
    if source.place.exists(VISIBLE):
        raise UserError(f"{address} is a packed copy; it is verified where it lies as a folder")
    return None


def print_copy_verification(root: Path, *, quick: bool, source: str | None, as_json: bool) -> int:
    """Check a copy, print what is wrong and return the exit code: 1 on any fault."""
    manifest = read_manifest(root)
    dataset = None if source is None else open_dataset(source)
    faults = list(verify_copy(root, quick=quick, source=dataset))
    if as_json:
        found = [asdict(fault) for fault in faults]
        about = {"kind": manifest.kind, "source": manifest.source.address, "quick": quick}
        print(json.dumps(about | {"files": len(manifest.files), "faults": found}, indent=1))
        return 1 if faults else 0
    for fault in faults:
        print(plain(f"{root}/{fault.file}: {fault.check}: {fault.message}"))
    how = "names and sizes" if quick else "names, sizes and contents"
    counts = ", ".join(f"{count} {check}" for check, count in Counter(fault.check for fault in faults).items())
    verdict = f"{counts}; {remedy(manifest, str(root))}" if faults else "all as they were made"
    print(plain(f"{root}: {manifest.kind}, {how} of {len(manifest.files)} files: {verdict}"))
    return 1 if faults else 0


def verify_copy(root: Path, *, quick: bool, source: DatasetSource | None = None) -> Iterator[CopyFault]:
    """Check a packed copy or an export by its manifest, and, where `source` is given, that it is that dataset's still.

    Everything that is changed, missing, too much or swapped is named; `quick` looks at names and sizes only. Packed
    views must hold finite values as well, and tables of tiles that are there. Raises `StoreError` where there is no
    sound manifest.
    """
    manifest = read_manifest(root)
    found = {name: size for name, size in files_under(root).items() if name not in (MANIFEST, LOCK)}
    wrong = set()
    for fault in size_fault(manifest.files, found):
        wrong.add(fault.file)
        yield fault
    if not quick:
        yield from _contents(root, manifest, [name for name in sorted(manifest.files) if name not in wrong])
    if source is not None:
        yield from _stale(manifest, source)


def _contents(root: Path, manifest: Manifest, names: Iterable[str]) -> Iterator[CopyFault]:
    owners = {entry.sha256: name for name, entry in manifest.files.items()}
    for name, entry in hashed(root, names):
        if entry != manifest.files[name]:
            other = owners.get(entry.sha256)
            yield CopyFault(name, "content", "is changed" if other is None else f"holds what belongs in {other}")
        elif name.endswith(".safetensors"):
            try:
                read_packed(root / name)
            except StoreError as error:
                yield CopyFault(name, "values", str(error))


def _stale(manifest: Manifest, source: DatasetSource) -> Iterator[CopyFault]:
    """Compare what went in with a dataset as it is now."""
    if origin_of(source).configuration_sha256 != manifest.source.configuration_sha256:
        yield CopyFault("", "stale", f"is of another dataset than {source.address}: of {manifest.source.address}")
        return
    there = {part.scene for part in manifest.parts.values()}
    for index in sorted(set(source.indices) - there) if manifest.kind == "packed" else ():
        yield CopyFault(scene_folder(index), "stale", f"is not packed yet, {source.address} has it")
    for name, part in sorted(manifest.parts.items()):
        if part.scene not in source.indices:
            yield CopyFault(name, "stale", f"is of scene {part.scene}, which {source.address} has no longer")
        elif part != scene_part(source, part.scene):
            yield CopyFault(name, "stale", f"is of another state of scene {part.scene} than {source.address} has now")
