"""The command `assets`: what is installed, fetching packs, naming what is broken."""

import sys
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.table import Table

from multilight.datagen.text import plain, terminal
from multilight.scenes.assets.check import account, check_assets
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
    """Load every asset for real and name the broken ones, with an account of one's own; returns 1 if any is broken."""
    library, pack = _library(which)
    problems = check_assets(library, pack)
    found = [info for role in get_args(AssetRole) for info in library.list(role) if pack in (None, info.pack)]
    lines = 0
    for info in (info for info in found if info.as_made):
        said = account(library, info)
        lines += max(len(said) - 1, 0)
        for number, line in enumerate(said):
            print(plain(line if number else f"{info.id}: {line}"))
    for asset, problem in problems:
        print(plain(f"{asset}: {problem}"))
    print(f"{len(found)} assets, {len(problems)} broken" + (f", {lines} remarks" if lines else ""))
    return 1 if problems or not found else 0


def _library(which: str | None) -> tuple[AssetLibrary, str | None]:
    """Open the library for a pack's name, a folder of models, or everything."""
    if which is None:
        return AssetLibrary(), None
    if Path(which).exists():
        library = AssetLibrary(packs=(), folders=(Path(which),))
        return library, library.packs[0]
    library = AssetLibrary()
    packs = sorted({info.pack for role in ROLES for info in library.list(role)})
    if which not in packs:
        raise AssetError(f"{which!r} is neither a folder nor an installed pack; installed: {', '.join(packs)}")
    return library, which
