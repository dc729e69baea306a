"""Fetches asset packs by package name, through the ordinary clients of Debian, PyPI and npm.

A pack is unpacked into `<cache>/packs/<name>` under a temporary name, then renamed; `pack.json` beside it records
the package, its version, the archive's SHA-256 and the licence. Nothing that a package holds is run.
"""

import contextlib
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import uuid
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from multilight.scenes.assets.cache import default_cache, write_json
from multilight.scenes.assets.environments import PMNDRS_MAPS, clean_copy, decode_pmndrs
from multilight.scenes.assets.info import AssetError
from multilight.scenes.assets.packs.surfaces import convert_texture, surface_textures
from multilight.scenes.files.limits import read_json

FURNITURE = "usr/share/sweethome3d/furniture"
LICENCES = {
    "BlendSwap-CC-0": "CC0-1.0",
    "BlendSwap-CC-BY": "CC-BY-3.0",
    "KatorLegaz": "CC-BY-3.0-US",
    "Scopia": "CC-BY-3.0",
}
"""The furniture's libraries, and the licence of each."""
TIMEOUT = 1800.0


@dataclass(frozen=True)
class Source:
    """What a pack holds and where it comes from; `sha256` is the archive's at the pinned version."""

    holds: Literal["furniture", "maps", "textures"]
    manager: Literal["apt", "pip", "npm"]
    package: str
    version: str
    sha256: str
    licence: str


SOURCES: dict[str, Source] = {
    "sweethome3d": Source(
        "furniture",
        "apt",
        "sweethome3d-furniture",
        "1.8-1",
        "3ccb90c63f9525e887a767b9cd5c8b6933b8b6b2973a615a5359ee68a2118668",
        "CC0-1.0 and CC-BY-3.0, by model",
    ),
    "hdri-pmndrs": Source(
        "maps",
        "npm",
        "@pmndrs/assets",
        "1.7.0",
        "152bd218a3390703f184f0c6ce16e73c8f0a87f32d38530d418a09d33d8208dc",
        "CC0-1.0",
    ),
    "textures-miniworld": Source(
        "textures",
        "pip",
        "miniworld",
        "2.1.0",
        "40d7d241f7e0067d9280af38520269fca119bd65fca7f3fea373f39412b6e98f",
        "Apache-2.0",
    ),
    "textures-metaworld": Source(
        "textures",
        "pip",
        "metaworld",
        "3.1.1",
        "99e25d9baf97f2f1a19ca89c0d2ca9c6a2b396d9a9be81729de64eedc683f0d3",
        "MIT",
    ),
}
DEFAULT_PACKS = tuple(SOURCES)


def pack_folder(name: str, cache: Path) -> Path:
    """Return where a fetched pack lies."""
    return cache / "packs" / name


def is_fetched(name: str, cache: Path) -> bool:
    """Tell whether a pack has been fetched."""
    return (pack_folder(name, cache) / "pack.json").is_file()


def pack_record(name: str, cache: Path) -> dict[str, str]:
    """Read `pack.json` of a fetched pack: package, version, sha256, licence, folder."""
    path = pack_folder(name, cache) / "pack.json"
    try:
        record = read_json(path)
        return {str(key): str(value) for key, value in record.items()}
    except (OSError, ValueError, AttributeError) as error:
        raise AssetError(f"{path} is broken: {error}; run `multilight assets fetch {name}`") from error


def _is_whole(name: str, cache: Path) -> bool:
    """Tell whether a pack has been fetched, and its record can be read."""
    with contextlib.suppress(AssetError):
        pack_record(name, cache)
        return True
    return False


def fetch_pack(name: str, cache: Path | None = None) -> Path:
    """Install a pack into the cache and return its folder; does nothing where it is there already.

    Raises `AssetError` with the reason (no such pack, no client, offline, full disk, a changed archive).
    """
    if name not in SOURCES:
        raise AssetError(f"no pack {name!r}; there are {', '.join(SOURCES)}")
    source, cache = SOURCES[name], default_cache() if cache is None else cache
    target = pack_folder(name, cache)
    if _is_whole(name, cache):
        return target
    staging = target.with_name(f".{name}-{uuid.uuid4().hex}.tmp")
    try:
        staging.mkdir(parents=True)
        installed = _installed_furniture() if source.manager == "apt" else None
        if installed is not None:
            _write_record(staging, source, version="installed", sha256="", files=installed)
        else:
            _download_and_unpack(name, source, staging)
        if target.exists() and not _is_whole(name, cache):
            shutil.rmtree(target)
        staging.rename(target)
    except OSError as error:
        if not is_fetched(name, cache):
            raise AssetError(f"cannot install pack {name!r} in {target}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(staging, ignore_errors=True)
    return target


def _installed_furniture() -> Path | None:
    """Return the folder of the Debian package where it is installed for the whole system."""
    folder = Path("/") / FURNITURE
    return folder if all((folder / f"{library}.sh3f").is_file() for library in LICENCES) else None


def _write_record(folder: Path, source: Source, *, version: str, sha256: str, files: Path) -> None:
    about = {"package": source.package, "version": version, "sha256": sha256, "licence": source.licence}
    write_json(folder / "pack.json", about | {"folder": str(files)})


def _download_and_unpack(name: str, source: Source, staging: Path) -> None:
    download: dict[str, Callable[[Source, Path], None]] = {"apt": _apt, "pip": _pip, "npm": _npm}
    unpack: dict[str, Callable[[str, Path, Path], None]] = {
        "furniture": _unpack_furniture,
        "maps": _unpack_maps,
        "textures": _unpack_textures,
    }
    with tempfile.TemporaryDirectory(dir=staging.parent, prefix=f".{name}-") as folder:
        scratch = Path(folder)
        download[source.manager](source, scratch)
        archive = next((p for p in scratch.iterdir() if p.suffix in (".deb", ".whl", ".tgz")), None)
        if archive is None:
            raise AssetError(f"{source.manager} downloaded nothing for {source.package} {source.version}")
        digest = hashlib.sha256(archive.read_bytes()).hexdigest()
        version = archive.name.split("_")[1] if source.manager == "apt" else source.version
        if version == source.version and digest != source.sha256:
            raise AssetError(f"{archive.name} has SHA-256 {digest}, expected {source.sha256}; not unpacked")
        try:
            unpack[source.holds](name, archive, staging)
        except (zipfile.BadZipFile, tarfile.TarError, KeyError, UnicodeDecodeError) as error:
            raise AssetError(f"{archive.name} cannot be unpacked: {error}") from error
    _write_record(staging, source, version=version, sha256=digest, files=Path("."))


def run_client(command: list[str], folder: Path, *, what: str) -> str:
    """Run a package manager's client and return what it prints; raises `AssetError` with the last line that it says."""
    try:
        result = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT, stdin=subprocess.DEVNULL, check=False
        )
    except FileNotFoundError as error:
        raise AssetError(f"{what} needs the program {command[0]!r}, which is not installed") from error
    except subprocess.TimeoutExpired as error:
        raise AssetError(f"{what} took longer than {TIMEOUT / 60:.0f} minutes") from error
    if result.returncode:
        lines = (result.stderr.strip() or result.stdout.strip() or "no message").splitlines()
        told = [line for line in lines if "error" in line.lower() or line.startswith("E:")] or lines
        raise AssetError(f"{what} failed: {told[-1].strip()[:300]}")
    return result.stdout


def apt_download(packages: Sequence[str], folder: Path) -> None:
    """Download Debian packages into a folder; needs no root, but as root fetches missing package lists."""
    what = f"downloading the Debian package{'s' if len(packages) > 1 else ''} {', '.join(packages)}"
    try:
        run_client(["apt-get", "download", *packages], folder, what=what)
    except AssetError:
        if os.geteuid() != 0 or shutil.which("apt-get") is None:
            raise
        # A fresh container has no package lists yet.
        run_client(["apt-get", "update"], folder, what="updating the package lists")
        run_client(["apt-get", "download", *packages], folder, what=what)


def unpack_deb(archive: Path, folder: Path) -> None:
    """Unpack a Debian package's files into a folder; runs none of its scripts."""
    run_client(["dpkg-deb", "-x", str(archive), str(folder)], archive.parent, what=f"unpacking {archive.name}")


def _apt(source: Source, scratch: Path) -> None:
    apt_download([source.package], scratch)


def _pip(source: Source, scratch: Path) -> None:
    wanted = f"{source.package}=={source.version}"
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--quiet"]
    run_client([*command, "--disable-pip-version-check", "--dest", ".", wanted], scratch, what=f"downloading {wanted}")


def _npm(source: Source, scratch: Path) -> None:
    wanted = f"{source.package}@{source.version}"
    command = ["npm", "pack", "--ignore-scripts", "--silent", wanted]
    run_client(command, scratch, what=f"downloading the npm package {wanted}")


def _unpack_furniture(name: str, archive: Path, staging: Path) -> None:
    inside = archive.parent / "inside"
    unpack_deb(archive, inside)
    for library in LICENCES:
        shutil.move(inside / FURNITURE / f"{library}.sh3f", staging / f"{library}.sh3f")


def _unpack_textures(name: str, archive: Path, staging: Path) -> None:
    with zipfile.ZipFile(archive) as wheel:
        for texture in surface_textures(name):
            convert_texture(wheel.read(texture.member), texture, staging / f"{texture.name}.png")


def _unpack_maps(name: str, archive: Path, staging: Path) -> None:
    with tarfile.open(archive, "r:gz") as package:
        for place in PMNDRS_MAPS:
            member = package.extractfile(f"package/hdri/{place}.exr.js")
            if member is None:
                raise AssetError(f"{archive.name} holds no map {place!r}")
            raw = archive.parent / f"{place}.exr"
            raw.write_bytes(decode_pmndrs(member.read().decode("ascii")))
            clean_copy(raw, staging / f"{place}.exr")
