"""The command `assets`: what is installed, fetching packs, naming what is broken."""

import json
import sys
from pathlib import Path
from typing import get_args

from multilight.datagen.commands.output import progress
from multilight.datagen.errors import UserError
from multilight.datagen.tables import print_table
from multilight.datagen.text import did_you_mean, plain
from multilight.scenes.assets.check import account, check_assets
from multilight.scenes.assets.fetch import DEFAULT_PACKS, fetch_pack
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary, AssetRole
from multilight.scenes.files.limits import shown

ROLES: tuple[AssetRole, ...] = ("object", "table", "environment", "texture")


def print_list(which: str | None, *, as_json: bool) -> int:
    """Print every installed asset with its creator and licence; returns the exit code."""
    heads = ("id", "role", "category", "creator", "licence")
    rows = [[str(getattr(info, head)) for head in heads] for info in _infos(*_library(which))]
    if as_json:
        print(json.dumps([dict(zip(heads, row, strict=True)) for row in rows], indent=1))
    else:
        print_table(heads, rows)
        print(f"{len(rows)} assets")
    return 0 if rows else 1


def fetch(which: str | None) -> int:
    """Install one pack, or the default ones; says what cannot be had and returns 1 then."""
    failed = 0
    packs = (which,) if which else DEFAULT_PACKS
    with progress("packs", "fetching") as report:
        for done, pack in enumerate(packs):
            report(done, len(packs), f"fetching {pack}")
            try:
                print(f"assets: {pack}: {fetch_pack(pack)}")
            except AssetError as error:
                failed += 1
                print(plain(f"assets: {pack}: {error}"), file=sys.stderr)
    return 1 if failed else 0


def check(which: str | None, *, as_json: bool) -> int:
    """Load every asset for real and name the broken ones, with an account of one's own; returns 1 if any is broken."""
    library, pack = _library(which)
    with progress("assets", "reading") as report:
        problems = check_assets(library, pack, report)
    found = [info for role in get_args(AssetRole) for info in library.list(role) if pack in (None, info.pack)]
    if not found and not problems:
        raise UserError(f"no model, sky or surface found in {which or 'the installed packs'}")
    accounts = {info.id: account(library, info) for info in found if info.as_made}
    if as_json:
        print(json.dumps({"assets": len(found), "accounts": accounts, "broken": dict(problems)}, indent=1))
        return 1 if problems else 0
    for asset, said in accounts.items():
        for number, line in enumerate(said):
            print(plain(line if number else f"{asset}: {line}"))
    for asset, problem in problems:
        print(plain(f"{asset}: {problem}"))
    remarks = sum(max(len(said) - 1, 0) for said in accounts.values())
    whole = f"{len(found)} assets, {len(problems)} broken" if problems else f"all {len(found)} assets ok"
    print(whole + (f", {remarks} remarks" if remarks else ""))
    return 1 if problems else 0


def _infos(library: AssetLibrary, pack: str | None) -> list[AssetInfo]:
    return [info for role in ROLES for info in library.list(role) if pack in (None, info.pack)]


def _library(which: str | None) -> tuple[AssetLibrary, str | None]:
    """Open the library for a pack's name, a folder of models, or everything."""
    if which is None:
        return AssetLibrary(), None
    if Path(which).exists():
        library = AssetLibrary(packs=(), folders=(Path(which),))
        return library, library.packs[0]
    library = AssetLibrary()
    packs = sorted({info.pack for info in _infos(library, None)})
    if which not in packs:
        near = did_you_mean(which, packs)
        raise AssetError(
            f"{shown(which)} is no file or folder that is there, nor an installed pack; {near}"
            f"installed: {', '.join(packs)}"
        )
    return library, which
