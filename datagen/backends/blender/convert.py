"""Reads files of unknown origin: `python -m multilight.datagen.backends.blender.convert FOLDER`.

Runs in a process of its own, with limits of memory, time and file size, without network, and writes nowhere but into
`FOLDER`. That holds `jobs.json`, a list of [file, folder that it may refer to files in]; what was read of job 0 goes to
`FOLDER/0`, and so on. No script in a file runs: neither text blocks marked to run at start, nor drivers in Python.
"""

import ctypes
import json
import os
import resource
import struct
import sys
from pathlib import Path

from multilight.scenes.assets.cache import file_digest
from multilight.scenes.assets.environments import keep_map, read_environment, read_hdr
from multilight.scenes.assets.formats.imported import RECORD, FoundLight, Imported, Record, keep_picture, save_import
from multilight.scenes.assets.formats.precheck import check_model
from multilight.scenes.assets.info import AssetError
from multilight.scenes.errors import MultilightError
from multilight.scenes.files.limits import read_bytes

MEMORY, SECONDS, FILE = 16 << 30, 600, 2 << 30
"""Bytes of address space, seconds of computing a file, and bytes of a file written, that a file may take."""
_CREATE_RULESET, _ADD_RULE, _RESTRICT = 444, 445, 446
_WRITES = 0xFFF2
"""Landlock's rights to write, remove, make and link."""


def confine(folder: Path) -> None:
    """Limit this process, as far as the system can: Linux 5.13 and newer confine writes, 6.7 and newer also TCP."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_FSIZE, (FILE, FILE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None, use_errno=True)
    libc.unshare(0x50000000)  # a user and a network of its own, without any device
    version = libc.syscall(_CREATE_RULESET, None, 0, 1)
    if version < 1:
        return
    writes = _WRITES & (0xFFFF if version > 2 else 0x3FFF if version > 1 else 0x1FFF)
    rules = struct.pack("<QQ", writes, 3)[: 16 if version > 3 else 8]
    ruleset = libc.syscall(_CREATE_RULESET, rules, len(rules), 0)
    for place in (folder, Path("/dev/null")):
        descriptor = os.open(place, os.O_PATH)
        rights = writes if place.is_dir() else 2
        libc.syscall(_ADD_RULE, ruleset, 1, struct.pack("<Qi", rights, descriptor), 0)
    libc.prctl(38, 1, 0, 0, 0)
    libc.syscall(_RESTRICT, ruleset, 0)


def convert(path: Path, folder: Path, work: Path) -> None:
    """Write what a file holds into `work`, or why it cannot be read."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    resource.setrlimit(resource.RLIMIT_CPU, (int(used.ru_utime + used.ru_stime) + SECONDS, resource.RLIM_INFINITY))
    try:
        found, files = _read(path, folder, work)
        save_import(found, {os.path.relpath(file, path.parent): file_digest(file) for file in files}, work)
        return
    except MemoryError:
        error = f"{path} needs more than {MEMORY >> 30} GB of memory; simplify it"
    except MultilightError as refused:
        error = str(refused) if str(path) in str(refused) else f"{path}: {refused}"
    except Exception as refused:  # whatever a broken file makes the importers stumble over
        said = (str(refused).strip() or "no reason given").splitlines()[-1].strip()
        error = f"{path} cannot be read ({type(refused).__name__}: {said}); export it again"
    error = error.replace(str(path), "{file}").replace(str(folder), "{folder}")
    (work / RECORD).write_text(Record(error=error).canonical_json(), encoding="utf-8")


def _read(path: Path, folder: Path, work: Path) -> tuple[Imported, list[Path]]:
    suffix = path.suffix.lower()
    if suffix in (".exr", ".hdr"):
        return _sky(path, work), []
    if suffix.startswith(".usd"):
        from multilight.scenes.assets.formats.usd import read_usd

        return read_usd(path, lambda image: keep_picture(image, work), work)
    claims = check_model(path, folder)
    from multilight.datagen.backends.blender.files import read_file

    found, more = read_file(path, folder, lambda image: keep_picture(image, work), work, claims.generator)
    if not found.nodes and suffix in (".glb", ".gltf") and b"KHR_draco_mesh_compression" in path.read_bytes():
        raise AssetError(f"{path}: its Draco compression cannot be decoded; export it without")
    notes = (*claims.notes, *found.notes)
    return Imported(found.nodes, found.lights, notes, claims.credits), sorted({*claims.files, *more})


def _sky(path: Path, work: Path) -> Imported:
    image = read_environment(path) if path.suffix.lower() == ".exr" else read_hdr(read_bytes(path), str(path))
    sky = FoundLight(
        kind="environment", name="sky", amount=(1, 1, 1), unit="W/(m2 sr)", map=keep_map(image, str(path), work)
    )
    return Imported((), (sky,))


if __name__ == "__main__":
    root = Path(sys.argv[1])
    confine(root)
    for number, (file, holder) in enumerate(json.loads((root / "jobs.json").read_text())):
        if not (root / str(number)).exists():  # one that is there ended the process before
            (root / str(number)).mkdir()
            convert(Path(file), Path(holder), root / str(number))
    # Blender's own clean-up at exit now and then waits for ever on its sound thread.
    os._exit(0)
