"""Fetches a libLLVM through Debian's own client and unpacks it into the cache; needs no root and changes no system.

What LLVM needs and the machine lacks (libz3 and the like) comes along, and is loaded before it.
"""

import os
import platform
import re
import shutil
import tempfile
from pathlib import Path

from multilight.datagen.backends.machine import llvm
from multilight.scenes.assets.fetch import apt_download, run_client, unpack_deb
from multilight.scenes.assets.info import AssetError

PREFERRED = (19, 18, 17, 20)  # most tried first; Debian 12 has 19, Ubuntu 24.04 has 18


def fetch_llvm(cache: Path | None = None) -> llvm.Library:
    """Install a libLLVM that Dr.Jit can use into the cache and return it; takes about 130 MB.

    Raises `AssetError` with the reason: no apt, offline, nothing new enough, a full disk.
    """
    folder = llvm.llvm_folder(cache)
    packages = known_packages()
    if not packages and has_apt() and os.geteuid() == 0:  # a fresh container has no package lists yet
        run_client(["apt-get", "update"], Path("/"), what="updating the package lists")
        packages = known_packages()
    if not packages:
        what = (
            f"apt knows no libllvm{llvm.OLDEST_USABLE} or newer: run `sudo apt-get update`"
            if has_apt()
            else "no apt here"
        )
        raise AssetError(f"{what}; or set {llvm.PATH_VARIABLE} to a libLLVM of version {llvm.OLDEST_USABLE} or newer")
    faults = []
    for package in packages:
        try:
            return _install(package, folder)
        except AssetError as error:
            faults.append(str(error))
        except OSError as error:
            raise AssetError(f"cannot install {package} in {folder}: {error.strerror or error}") from error
    raise AssetError("; ".join(faults))


def has_apt() -> bool:
    """Tell whether Debian's clients are there."""
    return all(shutil.which(program) for program in ("apt-get", "apt-cache", "dpkg-deb"))


def known_packages() -> list[str]:
    """Return the packages of a usable libLLVM that apt offers, best first; empty where there are none, or no apt."""
    if not has_apt():
        return []
    command = ["apt-cache", "search", "--names-only", "^libllvm[0-9]+(t64)?$"]
    try:
        listed = run_client(command, Path("/"), what="asking apt for libllvm")
    except AssetError:
        return []
    versions = {line[1]: int(line[2]) for line in re.finditer(r"^(libllvm(\d+)\S*)", listed, flags=re.MULTILINE)}
    return sorted(
        (name for name in versions if versions[name] in PREFERRED), key=lambda n: PREFERRED.index(versions[n])
    )


def _install(package: str, folder: Path) -> llvm.Library:
    """Download, unpack and try one package with what it needs; it gets its final name only when it works."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as scratch:
        archives, tree = Path(scratch, "archives"), Path(scratch, "tree")
        archives.mkdir()
        apt_download(_with_what_it_needs(package), archives)
        for archive in sorted(archives.glob("*.deb")):
            unpack_deb(archive, tree)
        library = _usable_in(tree)
        if library.fault:
            raise AssetError(f"{package} does not work here: {library.path.name} {library.fault}")
        target = folder / f"{package}-{library.shown_version}-{platform.machine()}"
        if target.exists() and _usable_in(target).fault:
            shutil.rmtree(target)
        try:
            tree.rename(target)
        except OSError:
            if _usable_in(target).fault:  # else another process was quicker
                raise
    return _usable_in(target)


def _with_what_it_needs(package: str) -> list[str]:
    """List a package and what apt would newly install with it."""
    simulated = ["apt-get", "install", "--simulate", "--no-install-recommends", package]
    try:
        listed = run_client(simulated, Path("/"), what=f"asking apt what {package} needs")
    except AssetError:  # a system with unmet dependencies of its own; the library is tried before it is used
        return [package]
    return sorted({package, *re.findall(r"^Inst (\S+) \(", listed, flags=re.MULTILINE)})


def _usable_in(tree: Path) -> llvm.Library:
    """Examine the libLLVM in a folder."""
    paths = sorted(path for path in tree.rglob("libLLVM*.so*") if path.is_file() and not path.is_symlink())
    if not paths:
        return llvm.Library(tree, fault="holds no libLLVM")
    return llvm.examine(paths[0], tree)
