"""The generator's commands; each imports what it needs only when it is called."""

import json
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from datagen.errors import UserError

if TYPE_CHECKING:
    from datagen.stats.collect import Summary

Kind = Literal["tabletop", "room", "outdoor", "studio", "custom", "spheres", "mixed"]
Renderer = Literal["auto", "mitsuba", "cycles", "analytic"]
Preset = Literal["tabletop", "room", "outdoor", "studio", "mixed", "smoke"]


@dataclass(kw_only=True)
class _Options:
    """What `dataset` and `scene` share; what is not given comes from the configuration file, else the default."""

    out: Path
    """Folder of the dataset; made where it is missing, continued where it is there."""
    preset: Preset | None = None
    """Named starting point; `multilight config show PRESET` prints it. What else is given goes over it."""
    config: Path | None = None
    """TOML file with any of the values that `multilight config show` lists."""
    seed: int | None = None
    """Seed of every random stream (default 0)."""
    kind: Kind | None = None
    """Kind of scene (default tabletop; mixed draws one a scene; spheres go with --renderer analytic)."""
    background: Path | None = None
    """With --kind custom: GLB, glTF, USD or .blend file to set the scenes in; scripts in it never run."""
    renderer: Renderer | None = None
    """Renderer (default auto: the fastest that is installed)."""
    width: int | None = None
    """Image width in pixels (default 256)."""
    height: int | None = None
    """Image height in pixels (default 256)."""
    views: int | None = None
    """Views a scene (default 16)."""
    spp: int | None = None
    """Samples a pixel (default 16)."""
    denoise: Literal["auto", "on", "off"] | None = None
    """Denoise each layer (default auto: below 2048 samples a pixel)."""
    keep_raw: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Where layers are denoised, store them as they were rendered too (parts `raw_...`; twice the space)."""
    assets: tuple[Path, ...] = ()
    """Folders of your own GLB, glTF or OBJ models to use besides the installed packs."""

    def values(self) -> dict[str, object]:
        """Return the options that belong into the configuration; None where not given."""
        keys = ("seed", "kind", "background", "renderer", "width", "height", "views", "spp", "denoise")
        return {key: getattr(self, key) for key in keys} | {"keep_raw": self.keep_raw or None}


@dataclass(kw_only=True)
class Dataset(_Options):
    """Make a dataset, or continue one: finished scenes are kept."""

    scenes: int | None = None
    """Number of scenes (default 4)."""
    workers: int | None = None
    """Worker processes (default: one a core)."""

    def run(self) -> int:
        """Make what is missing and return the exit code."""
        from datagen.config import load_config

        config = load_config(self.config, self.values() | {"scenes": self.scenes}, self.preset)
        return _make(self, config, tuple(range(config.scenes)), self.workers)


@dataclass(kw_only=True)
class Scene(_Options):
    """Make one scene, identical to that scene in a dataset of the same seed."""

    index: int = 0
    """Which scene of the dataset."""

    def run(self) -> int:
        """Make the scene and return the exit code."""
        from datagen.config import load_config

        if self.index < 0:
            raise UserError(f"--index {self.index} must be 0 or more")
        config = load_config(self.config, self.values() | {"scenes": self.index + 1}, self.preset)
        return _make(self, config, (self.index,), 1)


@dataclass
class Verify:
    """Check everything that was written: files, values and identities; exit code 1 on any fault."""

    dir: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Verify and return the exit code."""
        from datagen.report import print_verification
        from datagen.verify import verify_dataset

        return print_verification(self.dir, verify_dataset(self.dir), as_json=self.json)


@dataclass
class Mix:
    """Make a picture of a stored view under any lighting."""

    dir: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path = field(kw_only=True)
    """Picture to write: .png (tone-mapped) or .exr (scene-linear float)."""
    scene: int = 0
    """Index of the scene."""
    view: int = 0
    """Number of the view."""
    condition: str = "all"
    """Lighting: a condition's name, a JSON file, or random:SEED."""
    insert_condition: str | None = None
    """Lighting of the inserted object in a composite; as --condition."""
    object: str | None = None
    """Insertable object (default: the first)."""
    what: Literal["target", "background", "composite", "effect"] | None = None
    """What to make (default: composite with --insert-condition, else target)."""

    def run(self) -> int:
        """Write the picture and return the exit code."""
        from datagen.mixing import MixRequest, write_mix

        what = self.what or ("composite" if self.insert_condition else "target")
        insert = self.insert_condition or self.condition
        write_mix(MixRequest(self.dir, self.scene, self.view, what, self.condition, insert, self.object), self.out)
        return 0


@dataclass
class Sheet:
    """Write a contact sheet: scenes x (background, composite, target, depth, effect)."""

    dir: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path = field(kw_only=True)
    """PNG file to write."""
    scenes: int = 24
    """Most scenes to show."""

    def run(self) -> int:
        """Write the sheet and return the exit code."""
        from datagen.sheet import contact_sheet
        from datagen.store import scene_dir, scene_indices

        indices = scene_indices(self.dir)[: self.scenes]
        if not indices:
            raise UserError(f"{self.dir} holds no finished scene; make some with: multilight dataset --out {self.dir}")
        contact_sheet(scene_dir(self.dir, index) for index in indices).save(self.out)
        print(f"contact sheet: {self.out}")
        return 0


@dataclass
class Assets:
    """List, fetch or check assets: what is installed, with licences; broken ones named."""

    action: tyro.conf.Positional[Literal["list", "fetch", "check"]]
    """What to do."""
    which: tyro.conf.Positional[str | None] = None
    """A pack's name or a folder of models (default: all packs; fetch: the default packs)."""

    def run(self) -> int:
        """Do it and return the exit code."""
        from datagen import assets

        match self.action:
            case "list":
                return assets.print_list(self.which)
            case "fetch":
                return assets.fetch(self.which)
            case "check":
                return assets.check(self.which)


@dataclass
class Stats:
    """Measure how varied a dataset is: histograms, coverage, leaks between splits, near-duplicate scenes."""

    dir: tyro.conf.Positional[Path | None] = None
    """Folder of the dataset."""
    sample: int | None = None
    """Instead: sample this many scenes without rendering, and measure those."""
    out: Path | None = None
    """Folder for index.html and stats.json (default: stats in the dataset's folder; with --sample: none)."""
    preset: Preset | None = None
    """With --sample: named starting point of the configuration."""
    config: Path | None = None
    """With --sample: TOML file of the configuration."""
    assets: tuple[Path, ...] = ()
    """Folders of your own models that the scenes use."""

    def run(self) -> int:
        """Measure, print a table, write the page and return the exit code: 1 where something leaks."""
        from datagen.stats.page import print_summary, write_page

        summary, out = self._measure()
        print_summary(summary)
        if out is not None:
            write_page(summary, out)
            print(f"statistics: {out / 'index.html'}")
        return 1 if summary.leaks else 0

    def _measure(self) -> "tuple[Summary, Path | None]":
        from datagen.config import load_config
        from datagen.report import progress
        from datagen.stats.collect import measure_dataset, measure_samples
        from scenes.assets.library import AssetLibrary

        if (self.dir is None) == (self.sample is None):
            raise UserError("say either which dataset to measure (multilight stats DIR) or --sample N")
        with progress("scenes") as report:
            if self.dir is not None:
                library = AssetLibrary(folders=self.assets)
                return measure_dataset(self.dir, library, report), self.out or self.dir / "stats"
            assert self.sample is not None
            if self.sample < 1:
                raise UserError(f"--sample {self.sample} must be 1 or more")
            config = load_config(self.config, {}, self.preset)
            return measure_samples(config, self.sample, AssetLibrary(folders=self.assets), report), self.out


@dataclass
class Config:
    """Show the configuration of a preset, or the defaults: every key with value, unit, range and meaning."""

    action: tyro.conf.Positional[Literal["show"]]
    """What to do."""
    preset: tyro.conf.Positional[Preset | None] = None
    """Which preset (default: none)."""
    json: bool = False
    """Print JSON instead of a table."""

    def run(self) -> int:
        """Print and return the exit code."""
        from datagen.config_table import print_config

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
        from datagen import doctor

        return doctor.fetch() if self.fetch else doctor.report(as_json=self.json)


Command = (
    Annotated[Dataset, tyro.conf.subcommand("dataset")]
    | Annotated[Scene, tyro.conf.subcommand("scene")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
    | Annotated[Mix, tyro.conf.subcommand("mix")]
    | Annotated[Sheet, tyro.conf.subcommand("sheet")]
    | Annotated[Assets, tyro.conf.subcommand("assets")]
    | Annotated[Stats, tyro.conf.subcommand("stats")]
    | Annotated[Config, tyro.conf.subcommand("config")]
    | Annotated[Doctor, tyro.conf.subcommand("doctor")]
)


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return the exit code: 0 only on success; errors take one line on standard error.

    `--traceback` anywhere shows where an error came from.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    traceback = "--traceback" in words
    words = [word for word in words if word != "--traceback"]
    command = tyro.cli(
        Command,
        args=words,
        prog="multilight",
        description="Synthetic multi-light data for object compositing, relighting and shadow generation.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    try:
        return int(command.run())
    except KeyboardInterrupt:
        print("stopped; the same command goes on where it was", file=sys.stderr)
        return 130
    except RuntimeError as error:
        if traceback or not _is_for_users(error):
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _is_for_users(error: RuntimeError) -> bool:
    from datagen.backends import BackendError
    from scenes.assets.library import AssetError

    return isinstance(error, (UserError, BackendError, AssetError))


def _make(options: _Options, config: object, indices: tuple[int, ...], workers: int | None) -> int:
    from datagen.config import DatasetConfig
    from datagen.dataset import Plan, default_workers, make_dataset
    from datagen.doctor import slow_note
    from datagen.report import progress

    assert isinstance(config, DatasetConfig)
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers} must be 1 or more")
    if note := slow_note(config.renderer):
        print(note, file=sys.stderr)
    plan = Plan(options.out, config, indices, workers or default_workers(len(indices)), options.assets)
    with progress("views") as report:
        outcome = make_dataset(plan, report)
    if outcome.broken:
        print(f"passed over {len(outcome.broken)} broken assets:", file=sys.stderr)
    for asset, reason in sorted(outcome.broken.items()):
        print(f"  {asset}: {reason}", file=sys.stderr)
    for index, reason in outcome.failures.items():
        print(f"failed: scene {index}: {reason}", file=sys.stderr)
    if spent := sum(outcome.seconds.values()):
        print(", ".join(f"{stage} {share / spent:.0%}" for stage, share in outcome.seconds.items()) + " of the time")
    if outcome.made or outcome.failures:
        summary = {"made": len(outcome.made), "kept": outcome.kept, "failed": len(outcome.failures)}
        print(f"{options.out}: " + json.dumps(summary).strip("{}").replace('"', ""))
    else:
        print(f"{options.out}: nothing to do, all {outcome.kept} scenes are there")
    return 1 if outcome.failures else 0
