"""Formats of `export` that any dataset may take: shards, captures, layers."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from multilight.datagen.text import plain

if TYPE_CHECKING:
    from multilight.datagen.export.captures.capture import Write
    from multilight.datagen.storage.source import DatasetSource


@dataclass(kw_only=True)
class _Source:
    """What every format shares."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path
    """Folder to write into."""
    where: str | None = None
    """Which scenes: an SQL expression over the index, as in `multilight query`."""
    on_broken: Literal["raise", "skip"] = "raise"
    """What to do about a scene that cannot be read: stop with its file and the reason, or pass it over and count it."""

    @contextmanager
    def opened(self) -> "Iterator[tuple[DatasetSource, Callable[[float, float], None]]]":
        """Open the dataset, show progress, and say at the end what was passed over."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.storage.source import open_dataset

        source = open_dataset(self.dir, where=self.where, on_broken=self.on_broken)
        with progress("scenes") as report:
            yield source, report
        if source.skipped:
            print(f"passed over {len(source.skipped)} of {len(source.indices)} scenes:")
        for index, reason in source.skipped.items():
            print(plain(f"  scene {index}: {reason}"))


@dataclass(kw_only=True)
class Webdataset(_Source):
    """WebDataset shards with a Hugging Face dataset card: a sample a view, object and pair of lightings."""

    pairs: int = 2
    """Pairs of lightings a view and object, drawn without repetition."""
    shard_mb: int = 500
    """Largest size of a shard in megabytes."""

    def run(self) -> int:
        """Write the shards and return the exit code."""
        from multilight.datagen.errors import UserError
        from multilight.datagen.export.webdataset.export import ShardOptions, export_webdataset

        if self.pairs < 1 or self.shard_mb < 1:
            raise UserError(f"--pairs {self.pairs} and --shard-mb {self.shard_mb} must be 1 or more")
        threads = len(os.sched_getaffinity(0))
        with self.opened() as (source, report):
            shards = export_webdataset(
                source, self.out, ShardOptions(self.pairs, self.shard_mb * 10**6, threads), report
            )
        if shards is None:
            print(f"{self.out}: nothing to do, all shards are there, as they were written")
            return 0
        for split, files in shards.splits.items():
            print(f"{split}: {shards.samples_of(split)} samples in {len(files)} shards")
        return 0


@dataclass(kw_only=True)
class _Captures(_Source):
    conditions: int | None = None
    """Lightings a scene: the first of its conditions (default: all)."""
    points: int = 50_000
    """Most points of the initial point cloud."""

    def write(self, kind: Literal["nerfstudio", "colmap"], one: "Write") -> int:
        """Write all captures with `one` and return the exit code."""
        from multilight.datagen.export.captures.capture import export_captures

        with self.opened() as (source, report):
            count = export_captures(
                source, self.out, one, kind=kind, conditions=self.conditions, points=self.points, report=report
            )
        print(f"{self.out}: {count} captures")
        return 0


@dataclass(kw_only=True)
class Nerfstudio(_Captures):
    """A capture a scene and lighting for nerfstudio: transforms.json, images, depth, masks, points.ply."""

    def run(self) -> int:
        """Write the captures and return the exit code."""
        from multilight.datagen.export.captures.nerfstudio import write_nerfstudio

        return self.write("nerfstudio", write_nerfstudio)


@dataclass(kw_only=True)
class Colmap(_Captures):
    """A capture a scene and lighting as COLMAP and Gaussian splatting read it: images/, sparse/0/*.bin."""

    def run(self) -> int:
        """Write the captures and return the exit code."""
        from multilight.datagen.export.captures.colmap import write_colmap

        return self.write("colmap", write_colmap)


@dataclass(kw_only=True)
class Luxremix(_Source):
    """LuxRemix' layout: per-light HDR layers of each view, four mixes, geometry and masks, one folder a scene."""

    tar: bool = False
    """Write tars of ten scenes (training-0000.tar, test-0000.tar) instead of folders."""

    def run(self) -> int:
        """Write the scenes and return the exit code."""
        from multilight.datagen.export.luxremix.export import export_luxremix

        with self.opened() as (source, report):
            outcome = export_luxremix(source, self.out, tar=self.tar, report=report)
        print(f"{self.out}: {outcome.scenes} scenes, {outcome.layers} layers")
        for index in outcome.unlit:
            print(f"  left out scene {index}: it has no light besides its environment")
        return 0


Formats = (
    Annotated[Webdataset, tyro.conf.subcommand("webdataset", prefix_name=False)]
    | Annotated[Nerfstudio, tyro.conf.subcommand("nerfstudio", prefix_name=False)]
    | Annotated[Colmap, tyro.conf.subcommand("colmap", prefix_name=False)]
    | Annotated[Luxremix, tyro.conf.subcommand("luxremix", prefix_name=False)]
)
