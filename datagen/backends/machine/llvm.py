"""Finds libLLVM and tells its version without loading it into this process.

Dr.Jit, under Mitsuba's LLVM variants, would take the first libLLVM that it finds. It refuses those before 15; with 15
and 16 the process aborts on processors with AVX-512 ("Cannot select: fminimum"). So versions are looked up before.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from multilight.datagen.backends.machine import probe
from multilight.scenes.assets.cache import default_cache

PATH_VARIABLE = "DRJIT_LIBLLVM_PATH"
NOWHERE = os.devnull  # as the variable's value: Dr.Jit shall load no LLVM at all
OLDEST_USABLE = 17
NEWEST_TRIED = 22  # newer ones are taken only where there is nothing else
TIMEOUT = 60.0
MISSING_LIBRARY = "cannot open shared object file"  # the dynamic loader's words
SYSTEM_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib/llvm-*/lib",
    "/usr/lib64",
    "/usr/lib64/llvm*/lib*",
    "/usr/local/lib",
)


@dataclass(frozen=True)
class Library:
    """A libLLVM: `fault` is empty where Dr.Jit can use it; `needs` are libraries to load before it."""

    path: Path
    version: tuple[int, int, int] | None = None
    fault: str = ""
    needs: tuple[Path, ...] = ()

    @property
    def shown_version(self) -> str:
        """The version as text, `?` where it is not known."""
        return ".".join(map(str, self.version)) if self.version else "?"


def llvm_folder(cache: Path | None = None) -> Path:
    """Return the folder of the cache into which LLVM is unpacked."""
    return (default_cache() if cache is None else cache) / "llvm"


def find_libraries(cache: Path | None = None) -> tuple[Library, ...]:
    """Examine every libLLVM of this machine, each once; first the one that `$DRJIT_LIBLLVM_PATH` names."""
    seen: dict[Path, Library] = {}
    for path, tree in _candidates(cache):
        real = Path(os.path.realpath(path))  # unlike `resolve`, lets a circle of links be
        if real not in seen:
            seen[real] = examine(real, tree)
    return tuple(seen.values())


def best(libraries: tuple[Library, ...]) -> Library | None:
    """Return the library to use: the one that `$DRJIT_LIBLLVM_PATH` names, if usable, else the newest tried version."""
    usable = [library for library in libraries if not library.fault]
    named = [library for library in usable if library.path == named_library()]
    return max(named or usable, key=_rank, default=None)


def named_library() -> Path:
    """Return the file that `$DRJIT_LIBLLVM_PATH` names, links followed; `NOWHERE` where it is not set."""
    return Path(os.path.realpath(os.environ.get(PATH_VARIABLE) or NOWHERE))


def examine(path: Path, tree: Path | None = None) -> Library:
    """Tell one library's version and whether it can be used.

    `tree` is the folder into which it was unpacked together with libraries that the system may lack.
    """
    stated = re.search(r"libLLVM(?:-|\.so\.)(\d+)", path.name)
    if stated and int(stated[1]) < OLDEST_USABLE:
        return Library(path, fault=_too_old(f"LLVM {stated[1]}, by its name"))
    if not os.path.isfile(path):
        return Library(path, fault="is not a file that can be read")
    needs = _libraries_in(tree) if tree else ()
    answer = ask("llvm", str(path), *map(str, needs))
    if "version" not in answer:
        return Library(path, fault=str(answer["fault"]))
    major, minor, patch = answer["version"]
    fault = _too_old(f"LLVM {major}") if major < OLDEST_USABLE else ""
    return Library(path, (major, minor, patch), fault, needs)


def ask(*words: str, environment: dict[str, str] | None = None) -> dict[str, Any]:
    """Run `probe.py` and return what it says; a crash or silence becomes the answer's `fault`."""
    isolated = ["-I"] if words[0] == "render" else ["-I", "-S"]
    command = [sys.executable, *isolated, probe.__file__, *words]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=TIMEOUT, env=environment, check=False
        )
    except subprocess.TimeoutExpired:
        return {"fault": f"gave no answer within {TIMEOUT:.0f} s"}
    if done.returncode < 0:
        return {"fault": f"crashes the process that uses it ({signal.Signals(-done.returncode).name})"}
    try:
        answer = json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        return {"fault": last_words(done.stderr)}
    return dict(answer)


def last_words(stderr: str) -> str:
    """Return the line that says why a program failed: the one about a missing library, else the last."""
    lines = stderr.strip().splitlines() or ["no message"]
    return next((line for line in lines if MISSING_LIBRARY in line), lines[-1]).strip()[:300]


def unpacked_system_libraries() -> tuple[Path, ...]:
    """List the shared libraries that `make system-libraries` unpacked where there was no root to install them."""
    return _libraries_in(Path(sys.prefix) / "system")


def _candidates(cache: Path | None) -> Iterator[tuple[Path, Path | None]]:
    """Yield paths of libLLVM, with the folder that it was unpacked into, if any."""
    named = named_library()
    unpacked = [*sorted(llvm_folder(cache).glob("[!.]*")), Path(sys.prefix) / "system"]
    if named != Path(NOWHERE):
        yield named, next((tree for tree in unpacked if named.is_relative_to(os.path.realpath(tree))), None)
    for tree in unpacked:
        for path in sorted(tree.rglob("libLLVM*.so*")):
            yield path, tree
    for pattern in (f"{sys.prefix}/lib", *SYSTEM_FOLDERS):
        for folder in sorted(Path("/").glob(pattern.lstrip("/"))):
            yield from ((path, None) for path in sorted(folder.glob("libLLVM*.so*")))
    yield from ((path, None) for path in _known_to_the_loader())


def _known_to_the_loader() -> list[Path]:
    program = shutil.which("ldconfig", path=f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin")
    if program is None:
        return []
    listed = subprocess.run([program, "-p"], capture_output=True, text=True, errors="replace", check=False).stdout
    return [Path(path) for path in re.findall(r"libLLVM\S*\.so\S* .*=> (\S+)", listed)]


def _libraries_in(tree: Path) -> tuple[Path, ...]:
    found = (path for path in sorted(tree.rglob("lib*.so*")) if path.is_file() and not path.is_symlink())
    return tuple(path for path in found if not path.name.startswith("libLLVM"))


def _rank(library: Library) -> tuple[bool, tuple[int, int, int]]:
    assert library.version is not None
    return library.version[0] <= NEWEST_TRIED, library.version


def _too_old(what: str) -> str:
    return f"is {what}; {OLDEST_USABLE} or newer is needed"
