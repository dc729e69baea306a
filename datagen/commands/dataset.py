"""Commands that make scenes: `dataset`, `scene`."""

import math
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from multilight.datagen.commands.arguments import hint
from multilight.datagen.config.dataset import DatasetConfig, Denoise, Kind, Renderer, load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.errors import UserError
from multilight.datagen.production.shards import Shard, parse_shard
from multilight.datagen.storage.address import without_password
from multilight.datagen.text import duration, plain, size

if TYPE_CHECKING:
    from multilight.datagen.production.crew import Limits
    from multilight.datagen.production.dataset import Outcome
    from multilight.datagen.production.running import Plan


def config_key(key: str) -> Any:
    """Describe an option that sets a key of the configuration, in the key's own words."""
    field = DatasetConfig.model_fields[key]
    words = " ".join((field.description or "").split())
    return tyro.conf.arg(help=words, help_behavior_hint=hint(str(field.default)))


@dataclass(kw_only=True)
class Settings:
    """What `dataset`, `scene` and `plan` share; what is not given is the configuration file's, else the default."""

    preset: Preset | None = None
    """Named starting point; `multilight config show PRESET` prints it. What else is given goes over it."""
    config: Path | None = None
    """TOML file with any of the values that `multilight config show` lists."""
    seed: Annotated[int | None, config_key("seed")] = None
    kind: Annotated[Kind | Literal["mixed"] | None, config_key("kind")] = None
    background: Annotated[Path | None, config_key("background")] = None
    renderer: Annotated[Renderer | None, config_key("renderer")] = None
    width: Annotated[int | None, config_key("width")] = None
    height: Annotated[int | None, config_key("height")] = None
    views: Annotated[int | None, config_key("views")] = None
    spp: Annotated[int | None, config_key("spp")] = None
    denoise: Annotated[Denoise | None, config_key("denoise")] = None
    keep_raw: Annotated[bool, tyro.conf.FlagCreatePairsOff, config_key("keep_raw")] = False
    assets: tuple[Path, ...] = ()
    """Folders of your own models, skies and surfaces to use besides the installed packs."""
    only_assets: tuple[Path, ...] = ()
    """The same, but nothing that is installed is used."""

    @property
    def folders(self) -> tuple[Path, ...]:
        """The user's own folders."""
        return (*self.assets, *self.only_assets)

    def configuration(self, made: dict[str, Any], **more: object) -> DatasetConfig:
        """Return what to make: what is given, over what a dataset was `made` with, else the defaults."""
        options = {key: value for key, value in vars(self).items() if key in DatasetConfig.model_fields} | more
        options["keep_raw"] = self.keep_raw or None
        options["only_assets"] = True if self.only_assets else None
        return load_config(self.config, options, self.preset, made)


@dataclass(kw_only=True)
class _Options(Settings):
    """What `dataset` and `scene` share besides."""

    out: str
    """Folder or address (s3://bucket/set) of the dataset; made where it is missing, continued where it is there."""
    log_json: Path | None = None
    """Add what happens to a file, a line of JSON an event: runs, scenes made and failed, why work stopped."""

    def continued(self, **more: object) -> DatasetConfig:
        """Return what to make: what is given, over the dataset's own settings where it is there, else the defaults."""
        from multilight.datagen.production.dataset import settings_of

        return self.configuration(settings_of(self.out), **more)


@dataclass(kw_only=True)
class Dataset(_Options):
    """Make a dataset, or continue one: finished scenes are kept, damaged ones made anew.

    Settings that are not given are those of the dataset where it is there already.
    """

    scenes: Annotated[int | None, config_key("scenes")] = None
    workers: int | None = None
    """Scenes that are made at once, a process each (default: one a core)."""
    repair: bool = False
    """Look at the contents of all that is there too, not at names and sizes only, and make anew what is damaged."""
    shard: str | None = None
    """Make part I of N only, counted from 0 (`2/8`), then help with parts that other runs on the folder have begun;
    `auto` asks the variables of Slurm and AWS Batch arrays, `auto/N` those of Kubernetes' indexed jobs."""

    executor: Literal["processes", "ray"] = "processes"
    """What makes scenes: processes of this machine, or a Ray cluster, whose nodes all see the output folder."""
    address: str = ""
    """Where the Ray cluster is, HOST:PORT (default: what RAY_ADDRESS says, or the one that runs on this machine)."""
    limit_minutes: float | None = None
    """Minutes that a scene may take (default: so many that only one that hangs exceeds them)."""
    limit_memory: float | None = None
    """GB of memory that a scene may take (default: what the machine has)."""
    retry: bool = False
    """Try again the scenes that were set aside since they failed three times."""

    def run(self) -> int:
        """Make what is missing and return the exit code."""
        from multilight.datagen.commands.output import logged
        from multilight.datagen.production.crew import limits_for

        config = self.continued()
        for name, value in (("minutes", self.limit_minutes), ("memory", self.limit_memory)):
            if value is not None and not 0 < value < math.inf:
                raise UserError(f"--limit-{name} {value} must be more than 0")
        shard = None if self.shard is None else parse_shard(self.shard, os.environ)
        with logged(self.log_json):
            return make_scenes(
                self.out,
                config,
                tuple(range(config.scenes)),
                workers=self.workers,
                assets=self.folders,
                repair=self.repair,
                shard=shard,
                limits=limits_for(config, self.limit_minutes, self.limit_memory),
                retry=self.retry,
                cluster=self.address if self.executor == "ray" else None,
            )


@dataclass(kw_only=True)
class Scene(_Options):
    """Make one scene, identical to that scene in a dataset of the same seed."""

    index: int = 0
    """Which scene of the dataset."""

    def run(self) -> int:
        """Make the scene and return the exit code."""
        from multilight.datagen.commands.output import logged

        if self.index < 0:
            raise UserError(f"--index {self.index} must be 0 or more")
        config = self.continued(scenes=self.index + 1)
        with logged(self.log_json):
            return make_scenes(self.out, config, (self.index,), workers=1, assets=self.folders, retry=True)


def make_scenes(
    out: str | Path,
    config: DatasetConfig,
    indices: tuple[int, ...],
    *,
    workers: int | None,
    assets: tuple[Path, ...],
    repair: bool = False,
    shard: Shard | None = None,
    limits: "Limits | None" = None,
    retry: bool = False,
    cluster: str | None = None,
) -> int:
    """Make what is missing or damaged of these scenes of a dataset, say how it went, and return the exit code."""
    from multilight.datagen.commands.doctor import slow_note
    from multilight.datagen.commands.output import progress
    from multilight.datagen.production.crew import limits_for
    from multilight.datagen.production.dataset import make_dataset
    from multilight.datagen.production.homes import local_folder
    from multilight.datagen.production.memory import default_workers
    from multilight.datagen.production.running import Plan

    folder = local_folder(out)
    if folder is not None and folder.is_symlink() and not folder.exists():
        raise UserError(f"--out {out} is a link that leads nowhere (to {folder.readlink()}); make that folder first")
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers} must be 1 or more")
    if note := slow_note(config.renderer):
        print(note, file=sys.stderr)
    address = str(out) if folder is None else ""
    workers = workers or (len(indices) if cluster is not None else default_workers(len(indices), config))
    limits = limits or limits_for(config)
    plan = Plan(folder or Path(), config, indices, workers, limits, assets, repair, shard, retry, cluster, address)
    start = time.monotonic()
    with progress("views", "starting") as report:
        outcome = make_dataset(plan, report)
    if outcome.broken:
        print(f"passed over {len(outcome.broken)} broken assets:", file=sys.stderr)
    for asset, reason in sorted(outcome.broken.items()):
        print(plain(f"  {asset}: {reason}"), file=sys.stderr)
    for index in outcome.changed:
        print(f"scene {index} is not what it was: assets or versions are others now", file=sys.stderr)
    for reason in outcome.tried_again:
        print(plain(f"tried again: {reason}"), file=sys.stderr)
    for index, reason in outcome.failures.items():
        print(plain(f"failed: scene {index}: {reason}"), file=sys.stderr)
    print(plain(f"{without_password(out)}: " + summary(plan, outcome, time.monotonic() - start)))
    return 1 if outcome.failures else 0


def summary(plan: "Plan", outcome: "Outcome", seconds: float) -> str:
    """Say in a line how a run went: scenes, time and what it went to, size, draws thrown away by reason."""
    count = len(outcome.made) + outcome.kept + outcome.others
    if not outcome.made and not outcome.failures and not outcome.others:
        return f"nothing to do, all {count} scenes are there"
    told = [
        f"{len(outcome.made)} made, {outcome.kept} kept"
        + f", {outcome.others} made by other runs" * bool(outcome.others)
        + f", {len(outcome.failures)} failed" * bool(outcome.failures)
        + f", {len(outcome.tried_again)} tries failed and were repeated" * bool(outcome.tried_again)
        + f", {outcome.retried} requests tried again" * bool(outcome.retried)
    ]
    told.append(f"{outcome.views} views, {size(outcome.size)}")
    spent = sum(outcome.seconds.values()) or 1.0
    stages = ", ".join(f"{stage} {took / spent:.0%}" for stage, took in outcome.seconds.items())
    told.append(f"{duration(seconds)} ({stages})")
    if outcome.thrown_away:
        reasons = Counter(reason.partition(":")[0] for reason in outcome.thrown_away)
        listed = ", ".join(f"{name} {number}" for name, number in reasons.most_common())
        told.append(f"{len(outcome.thrown_away)} drawn anew ({listed})")
    wanted = count + len(outcome.failures)
    whole = (
        f"{count} of {wanted} scenes ok" if outcome.failures else f"all {count} scenes ok" if count > 1 else "scene ok"
    )
    return f"{whole}: " + "; ".join(told)
