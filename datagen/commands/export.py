"""The command `export`: a dataset written out in a layout that others read, one sub-command a format."""

import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from multilight.datagen.errors import UserError
from multilight.datagen.export.dtc.request import DtcExport
from multilight.datagen.text import plain

if TYPE_CHECKING:
    from multilight.datagen.export.captures.capture import Write
    from multilight.datagen.report import Report
    from multilight.datagen.storage.open_dataset import DatasetSource


class DtcMultilight(DtcExport):
    """MV-CoLight's own layouts: DTC-MultiLight-2D, -3D, -2DEval, -3DEval, with train.json and test.json."""

    def run(self) -> int:
        """Write the roots and return the exit code."""
        from multilight.datagen.commands.output import print_written, progress
        from multilight.datagen.export.dtc.export import export_dtc

        with progress("views", "exporting") as report:
            outcome = export_dtc(self, report)
        told = f"scenes written {outcome.written}, kept {outcome.kept}, passed over {len(outcome.skipped)}"
        print_written(self.out, told)
        for index, reason in outcome.skipped.items():
            print(plain(f"  scene {index}: {reason}"))
        return 0


@dataclass(kw_only=True)
class _Source:
    """What the formats share that any dataset may take."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path
    """Folder to write into."""
    where: str | None = None
    """Which scenes: an SQL expression over the index, as in `multilight query`."""
    on_broken: Literal["raise", "skip"] = "raise"
    """What to do about a scene that cannot be read: stop with its file and the reason, or pass it over and count it."""

    @contextmanager
    def opened(self) -> "Iterator[tuple[DatasetSource, Report]]":
        """Open the dataset, show progress, and say at the end what was passed over."""
        from multilight.datagen.commands.output import progress
        from multilight.datagen.storage.open_dataset import open_dataset

        source = open_dataset(self.dir, where=self.where, on_broken=self.on_broken)
        with progress("scenes", "exporting") as report:
            yield source, report
        if source.skipped:
            print(f"passed over {len(source.skipped)} of {len(source.indices)} scenes:")
        for index, reason in source.skipped.items():
            print(plain(f"  scene {index}: {reason}"))


@dataclass(kw_only=True)
class Usd(_Source):
    """An OpenUSD stage a scene: meshes, UsdPreviewSurface, UsdLux lights in nits and lux, cameras, lightings."""

    out: Path
    """Folder to write scene_000000/scene.usdc and its textures into; scenes that are there are kept."""
    scene: int | None = None
    """Index of the one scene to write (default: all)."""
    assets: tuple[Path, ...] = ()
    """Folders of your own models that the dataset was made with, and its background where that has moved."""

    def run(self) -> int:
        """Write the stages and return the exit code."""
        from multilight.datagen.commands.output import print_written
        from multilight.datagen.production.library import open_library_again
        from multilight.datagen.usd.write import export_usd

        with self.opened() as (source, report):
            library = open_library_again(source.record, Path(source.address), self.assets)
            made = export_usd(source, library, self.out, report, scene=self.scene)
        print_written(self.out, f"{len(made)} stages")
        return 0


@dataclass(kw_only=True)
class Webdataset(_Source):
    """WebDataset shards with a Hugging Face dataset card: a sample a view, object and pair of lightings."""

    pairs: int = 2
    """Pairs of lightings a view and object, drawn without repetition."""
    shard_mb: int = 500
    """Largest size of a shard in megabytes."""

    def run(self) -> int:
        """Write the shards and return the exit code."""
        from multilight.datagen.commands.output import print_written
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
        told = [f"{split} {shards.samples_of(split)} in {len(files)} shards" for split, files in shards.splits.items()]
        print_written(self.out, f"samples: {'; '.join(told)}")
        return 0


@dataclass(kw_only=True)
class _Captures(_Source):
    conditions: int | None = None
    """Lightings a scene: the first of its conditions (default: all)."""
    points: int = 50_000
    """Most points of the initial point cloud."""

    def write(self, kind: Literal["nerfstudio", "colmap"], one: "Write") -> int:
        """Write all captures with `one` and return the exit code."""
        from multilight.datagen.commands.output import print_written
        from multilight.datagen.export.captures.capture import export_captures

        with self.opened() as (source, report):
            count = export_captures(
                source, self.out, one, kind=kind, conditions=self.conditions, points=self.points, report=report
            )
        print_written(self.out, f"{count} captures")
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
        from multilight.datagen.commands.output import print_written
        from multilight.datagen.export.luxremix.export import export_luxremix

        with self.opened() as (source, report):
            outcome = export_luxremix(source, self.out, tar=self.tar, report=report)
        print_written(self.out, f"{outcome.scenes} scenes, {outcome.layers} layers")
        for index in outcome.unlit:
            print(f"  left out scene {index}: it has no light besides its environment")
        return 0


@dataclass(kw_only=True)
class Web(_Source):
    """The light mixer as a web page of plain files: as `multilight view`, for any web server."""

    scenes: tuple[int, ...] = ()
    """Indices of the scenes to show (default: all)."""

    def run(self) -> int:
        """Write the page and return the exit code."""
        from multilight.datagen.export.web.export import export_web

        if self.scenes:
            named = f"index in ({', '.join(map(str, self.scenes))})"
            self.where = named if self.where is None else f"({self.where}) and {named}"
        with self.opened() as (source, report):
            if missing := sorted(set(self.scenes) - set(source.indices)):
                raise UserError(f"--scenes {missing[0]} is not in {self.dir}, or not among those of --where")
            count = export_web(source, self.out, report)
        folder = shlex.quote(str(self.out))
        print(f"{self.out}: {count} scenes; look at it with: python3 -m http.server --directory {folder}")
        return 0


@dataclass
class Export:
    """Write a dataset out in a layout that others read."""

    format: tyro.conf.OmitSubcommandPrefixes[DtcMultilight | Usd | Webdataset | Nerfstudio | Colmap | Luxremix | Web]

    def run(self) -> int:
        """Run the format's own command and return the exit code."""
        return self.format.run()
