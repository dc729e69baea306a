"""Commands about what is installed and how it is set: `assets`, `config`, `doctor`."""

from dataclasses import dataclass
from typing import Literal

import tyro

from multilight.datagen.config.presets import Preset


@dataclass
class Assets:
    """List, fetch or check assets: what is installed, with licences; broken ones named."""

    action: tyro.conf.Positional[Literal["list", "fetch", "check"]]
    """What to do."""
    which: tyro.conf.Positional[str | None] = None
    """A pack's name or a folder of models (default: all packs; fetch: the default packs)."""
    json: bool = False
    """With list and check: print JSON."""

    def run(self) -> int:
        """Do it and return the exit code."""
        from multilight.datagen.commands import assets

        match self.action:
            case "list":
                return assets.print_list(self.which, as_json=self.json)
            case "fetch":
                return assets.fetch(self.which)
            case "check":
                return assets.check(self.which, as_json=self.json)


@dataclass
class Config:
    """Show the configuration of a preset, or the defaults, as TOML: every key with its meaning, unit and range.

    To save and edit: multilight config show room > mine.toml; multilight dataset --config mine.toml --out DIR
    """

    action: tyro.conf.Positional[Literal["show"]]
    """What to do."""
    preset: tyro.conf.Positional[Preset | None] = None
    """Which preset (default: none)."""
    json: bool = False
    """Print JSON instead."""

    def run(self) -> int:
        """Print and return the exit code."""
        from multilight.datagen.config.table import print_config

        return print_config(self.preset, as_json=self.json)


@dataclass
class Doctor:
    """Show what this machine has, which renderer will be used and why, and what would make it faster.

    Exit code 1 where nothing here can render.
    """

    fetch: bool = False
    """Only this: fetch the LLVM that makes Mitsuba fast into the cache, where it is needed; no root required."""
    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Examine, or fetch, and return the exit code."""
        from multilight.datagen.commands import doctor

        return doctor.fetch() if self.fetch else doctor.report(as_json=self.json)
