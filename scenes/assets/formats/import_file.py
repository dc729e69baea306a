"""The one way in: files of any format, read by a process of its own, kept in the cache by what they hold.

A file's place in the cache is made of its content and of the code that reads it; below it lies one record for each
content of the files that it refers to. So a copy elsewhere, or on another machine, is known.
"""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

from multilight.scenes.assets.cache import file_digest, is_sound, read_kept, sources_key
from multilight.scenes.assets.formats.imported import ARRAYS, RECORD, Imported, Record, load_import
from multilight.scenes.assets.info import AssetError

CONVERTER = "multilight.datagen.backends.blender.convert"
"""The program that reads; a process of its own, so nothing here imports it."""
SUFFIXES = (".glb", ".gltf", ".obj", ".fbx", ".ply", ".stl", ".usd", ".usda", ".usdc", ".usdz", ".blend")
SKIES = (".exr", ".hdr")
PATIENCE = 900
"""Seconds without any file done after which a converter is stopped."""
_PACKAGE = Path(__file__).parents[3]
CROWD = 12
"""Files that are worth another converter beside the first."""


class Intake:
    """Reads files through the cache."""

    def __init__(self, cache: Path) -> None:
        self._records, self._pictures = cache / "imports", cache / "textures" / "imported"
        self._ended: dict[tuple[Path, str | None], Record] = {}

    def read(self, path: Path, folder: Path) -> Imported:
        """Return what a file holds, which may refer to others in `folder`.

        Raises `AssetError` in one line with the file, what is wrong and the remedy.
        """
        place, record = self._record(path, folder)
        if record.error is not None:
            raise AssetError(record.error.replace("{file}", str(path)).replace("{folder}", str(folder)))
        found = read_kept(place / ARRAYS, lambda _: load_import(place, record))
        if found is None:  # thrown away
            self._run([(path, folder)])
            return load_import(*self._record(path, folder))
        return found

    def record(self, path: Path, folder: Path) -> Record:
        """Return the account of a file without its triangles; `error` is set where it cannot be read."""
        return self._record(path, folder)[1]

    def convert(self, models: Iterable[tuple[Path, Path]]) -> None:
        """Convert, a few processes for all, the (file, folder) that are not in the cache."""
        waiting = [model for model in models if model[0].is_file() and self._kept(*model) is None]
        hands = max(1, min(len(waiting) // CROWD + 1, os.cpu_count() or 1))
        with ThreadPoolExecutor(hands) as pool:
            list(pool.map(self._run, (waiting[n::hands] for n in range(hands))))

    def key(self, path: Path, folder: Path) -> str:
        """Return the name that a file has by its content and that of what it refers to."""
        place = self._record(path, folder)[0]
        return "-".join(place.parts[-3:]).replace(".", "-")

    def picture(self, name: str, models: Sequence[tuple[Path, Path]]) -> Path | None:
        """Return a texture or sky of some (file, folder); where it is not in the cache any more, they are read anew."""
        path = self._pictures / f"{name}{'.exr' if name.startswith('sky-') else '.png'}"
        if not is_sound(path):
            for file, _ in models:
                shutil.rmtree(self._place(file), ignore_errors=True)
            self.convert(models)
        return path if path.is_file() else None

    def _place(self, path: Path) -> Path:
        return self._records / (file_digest(path) or "missing")[:16] / f"{_code()}{path.suffix.lower()}"

    def _record(self, path: Path, folder: Path) -> tuple[Path, Record]:
        if not path.is_file():
            raise AssetError(f"{path} is missing")
        found = self._kept(path, folder)
        if found is None:
            self._run([(path, folder)])
            found = self._kept(path, folder)
        if found is None:
            raise AssetError(f"{path} changed while it was read; read it again")
        return found

    def _kept(self, path: Path, folder: Path) -> tuple[Path, Record] | None:
        """Find the record whose files are those that there are now, and its pictures whole."""
        place = self._place(path)
        if (path, file_digest(path)) in self._ended:
            return place, self._ended[path, file_digest(path)]
        for made in sorted(place.glob("[0-9a-f]*")):
            record = read_kept(made / RECORD, lambda file: Record.model_validate_json(file.read_bytes()))
            if record is None or any(file_digest(path.parent / n) != d for n, d in record.files.items()):
                continue
            if record.error is not None or (made / ARRAYS).is_file():
                return made, record
        return None

    def _run(self, models: list[tuple[Path, Path]]) -> None:
        """Convert files one after the other; what ends the process is named, and the rest goes on in another."""
        if not models:
            return
        try:
            self._records.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self._records, prefix=".") as name:
                self._convert_all(models, Path(name))
        except OSError as error:
            raise AssetError(
                f"cannot write {self._records}: {error.strerror or error}; free some space or set MULTILIGHT_CACHE"
            ) from error

    def _convert_all(self, models: list[tuple[Path, Path]], work: Path) -> None:
        (work / "jobs.json").write_text(json.dumps([[str(m.absolute()), str(f.absolute())] for m, f in models]))
        done = 0
        while done < len(models):
            reason = _convert(work)
            begun = sum((work / str(n)).is_dir() for n in range(len(models)))
            if begun == done:
                raise AssetError(f"files cannot be read, as Blender does not start: {_said(work) or reason}")
            for number in range(done, begun):
                self._take(work / str(number), models[number][0], reason)
            done = begun

    def _take(self, made: Path, path: Path, reason: str) -> None:
        """Put what was made of a file into the cache."""
        if not (made / RECORD).is_file():
            self._ended[path, file_digest(path)] = Record(error=f"{{file}} cannot be read: {reason}; export it again")
            return
        record = Record.model_validate_json((made / RECORD).read_bytes())
        self._pictures.mkdir(parents=True, exist_ok=True)
        for picture in (*made.glob("*.png"), *made.glob("*.exr")):
            picture.replace(self._pictures / picture.name)
        files = hashlib.sha256(json.dumps(sorted(record.files.items())).encode()).hexdigest()[:16]
        target = self._place(path) / files
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(target, ignore_errors=True)
        made.replace(target)
        made.mkdir()


def _convert(work: Path) -> str:
    """Run the program on what is left to do in `work`; returns how it ended."""
    root = str(_PACKAGE.parent)
    environment = {
        "PATH": os.environ.get("PATH", ""),
        "PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")])),
        "HOME": str(work), "TMPDIR": str(work), "LANG": "C.UTF-8", "BLENDER_USER_RESOURCES": str(work),
    }  # fmt: skip
    command = [sys.executable, "-P", "-m", CONVERTER, str(work)]
    with (work / "log").open("wb") as log:
        child = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment, cwd=work)
        try:
            while child.poll() is None:
                begun = len(list(work.iterdir()))
                try:
                    child.wait(PATIENCE)
                except subprocess.TimeoutExpired:
                    if begun == len(list(work.iterdir())):
                        return f"it takes more than {PATIENCE} s"
        finally:
            child.kill()
            child.wait()
    if child.returncode == -signal.SIGXCPU:
        return "it takes too long"
    if child.returncode < 0:
        return f"it ends Blender ({signal.Signals(-child.returncode).name})"
    return f"exit code {child.returncode}"


def _said(work: Path) -> str:
    lines = (work / "log").read_text(errors="replace").strip().splitlines()
    return lines[-1].strip()[:300] if lines else ""


@cache
def _code() -> str:
    """Hash the code that reads, so that what old code made is not taken for new."""
    here = [*Path(__file__).parent.rglob("*.py"), _PACKAGE / "scenes" / "assets" / "environments.py"]
    names = ("bake", "convert", "files", "surfaces", "trees", "worlds")
    there = [_PACKAGE / "datagen" / "backends" / "blender" / f"{name}.py" for name in names]
    return sources_key(*map(str, sorted(here)), *map(str, there))
