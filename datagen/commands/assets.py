"""The command `assets`: what is installed, fetching packs, naming what is broken."""

import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

from multilight.datagen.text import plain, terminal
from multilight.scenes.assets.check import check_assets
from multilight.scenes.assets.fetch import DEFAULT_PACKS, fetch_pack
from multilight.scenes.assets.library import AssetError, AssetLibrary, AssetRole

ROLES: tuple[AssetRole, ...] = ("object", "table", "environment", "texture")


def print_list(which: str | None) -> int:
    """Print every installed asset with its creator and licence; returns the exit code."""
    library, pack = _library(which)
    table = Table()
    for title in ("asset", "role", "category", "creator", "licence"):
        table.add_column(title, overflow="fold")
    count = 0
    for role in ROLES:
        for info in library.list(role):
            if pack is None or info.pack == pack:
                table.add_row(*map(terminal, (info.id, info.role, info.category, info.creator, info.licence)))
                count += 1
    Console().print(table)
    print(f"{count} assets")
    return 0 if count else 1


def fetch(which: str | None) -> int:
    """Install one pack, or the default ones; says what cannot be had and returns 1 then."""
    failed = 0
    for pack in (which,) if which else DEFAULT_PACKS:
        try:
            print(f"assets: {pack}: {fetch_pack(pack)}")
        except AssetError as error:
            failed += 1
            print(plain(f"assets: {pack}: {error}"), file=sys.stderr)
    return 1 if failed else 0


def check(which: str | None) -> int:
    """Load every asset for real and name the broken ones; returns 1 if there are any."""
    library, pack = _library(which)
    problems = check_assets(library, pack)
    for asset, problem in problems:
        print(plain(f"{asset}: {problem}"))
    total = sum(pack in (None, info.pack) for role in ROLES for info in library.list(role))
    print(f"{total} assets, {len(problems)} broken")
    return 1 if problems or not total else 0


def _library(which: str | None) -> tuple[AssetLibrary, str | None]:
    """Open the library for a pack's name, a folder of models, or everything."""
    if which is None:
        return AssetLibrary(), None
    if Path(which).is_dir():
        folder = Path(which).resolve()
        return AssetLibrary(folders=(folder,)), folder.name
    library = AssetLibrary()
    packs = sorted({info.pack for role in ROLES for info in library.list(role)})
    if which not in packs:
        raise AssetError(f"{which!r} is neither a folder nor an installed pack; installed: {', '.join(packs)}")
    return library, which
