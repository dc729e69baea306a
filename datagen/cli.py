"""The generator's commands; each imports what it needs only when it is called."""

import json
import os
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from datagen.errors import UserError

Kind = Literal["tabletop", "spheres"]
Renderer = Literal["auto", "cycles", "analytic"]


@dataclass(kw_only=True)
class _Options:
    """What `dataset` and `scene` share; what is not given comes from the configuration file, else the default."""

    out: Path
    """Folder of the dataset; made where it is missing, continued where it is there."""
    config: Path | None = None
    """TOML file with any of the values below."""
    seed: int | None = None
    """Seed of every random stream (default 0)."""
    kind: Kind | None = None
    """Kind of scene (default tabletop; spheres go with --renderer analytic)."""
    renderer: Renderer | None = None
    """Renderer (default auto: the fastest that is installed)."""
    width: int | None = None
    """Image width in pixels (default 256)."""
    height: int | None = None
    """Image height in pixels (default 256)."""
    views: int | None = None
    """Views a scene (default 16)."""
    spp: int | None = None
    """Samples a pixel (default 8)."""
    denoise: bool | None = None
    """Denoise each layer (default: yes)."""
    assets: tuple[Path, ...] = ()
    """Folders of your own GLB, glTF or OBJ models to use besides the installed packs."""

    def values(self) -> dict[str, object]:
        """Return the options that belong into the configuration; None where not given."""
        keys = ("seed", "kind", "renderer", "width", "height", "views", "spp", "denoise")
        return {key: getattr(self, key) for key in keys}


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

        config = load_config(self.config, self.values() | {"scenes": self.scenes})
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
        config = load_config(self.config, self.values() | {"scenes": self.index + 1})
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


Command = (
    Annotated[Dataset, tyro.conf.subcommand("dataset")]
    | Annotated[Scene, tyro.conf.subcommand("scene")]
    | Annotated[Verify, tyro.conf.subcommand("verify")]
    | Annotated[Mix, tyro.conf.subcommand("mix")]
    | Annotated[Sheet, tyro.conf.subcommand("sheet")]
    | Annotated[Assets, tyro.conf.subcommand("assets")]
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
    from datagen.report import progress

    assert isinstance(config, DatasetConfig)
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers} must be 1 or more")
    plan = Plan(options.out, config, indices, workers or default_workers(len(indices)), options.assets)
    with progress("views") as report:
        outcome = make_dataset(plan, report)
    if outcome.broken:
        print(f"passed over {len(outcome.broken)} broken assets:", file=sys.stderr)
    for asset, reason in sorted(outcome.broken.items()):
        print(f"  {asset}: {reason}", file=sys.stderr)
    for index, reason in outcome.failures.items():
        print(f"failed: scene {index}: {reason}", file=sys.stderr)
    if outcome.made or outcome.failures:
        summary = {"made": len(outcome.made), "kept": outcome.kept, "failed": len(outcome.failures)}
        print(f"{options.out}: " + json.dumps(summary).strip("{}").replace('"', ""))
    else:
        print(f"{options.out}: nothing to do, all {outcome.kept} scenes are there")
    return 1 if outcome.failures else 0
