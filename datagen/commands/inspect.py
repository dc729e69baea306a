"""Commands that look at what was made: `verify`, `view`, `video`, `mix`, `sheet`, `stats`."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.errors import UserError
from multilight.datagen.tuples.request import MixRequest

if TYPE_CHECKING:
    from multilight.datagen.stats.collect import Summary
    from multilight.datagen.storage.open_dataset import DatasetSource
    from multilight.datagen.view.server import Server
    from multilight.datagen.view.space import Space


@dataclass
class Verify:
    """Check that a dataset is whole and unchanged, and what its pictures hold; exit code 1 on any fault.

    Finds what is missing, changed, too much or under another's name, in the index and dataset.json as well.

    Packed copies and exports, which have a manifest.json, are checked by it: every file is there, no other, unchanged.
    """

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset; folder of the packed copy or export."""
    json: bool = False
    """Print JSON instead of a table."""
    quick: bool = False
    """Look at names, sizes, records and the index, not at what the files hold."""
    sample: int | None = None
    """Look into so many scenes only, spread evenly, besides the index and which scenes there are."""
    source: str | None = None
    """Folder or address of a dataset: say as well what of a packed copy or export is not as that dataset is now."""

    def run(self) -> int:
        """Verify and return the exit code."""
        from multilight.datagen.commands.output import print_verification, progress
        from multilight.datagen.verification.copies import copy_at, print_copy_verification
        from multilight.datagen.verification.dataset import verify_dataset

        if self.sample is not None and self.sample < 1:
            raise UserError(f"--sample {self.sample} must be 1 or more")
        if (copy := copy_at(self.dir)) is not None:
            if self.sample is not None:
                raise UserError(f"--sample goes with a dataset, and {self.dir} is a packed copy or an export")
            return print_copy_verification(copy, quick=self.quick, source=self.source, as_json=self.json)
        if self.source is not None:
            raise UserError(f"--source goes with a packed copy or an export, and {self.dir} is neither")
        with progress("scenes", "verifying") as report:
            checked = verify_dataset(self.dir, quick=self.quick, sample=self.sample, report=report)
        return print_verification(self.dir, checked, as_json=self.json)


@dataclass
class View:
    """Open the light mixer in a browser: every light, object and view of a dataset, mixed live.

    The page is served on this machine alone, until it is stopped (Ctrl+C).
    """

    address: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    where: str | None = field(default=None, kw_only=True)
    """Which scenes: an SQL expression over the index, as in `multilight query`."""
    port: int | None = field(default=None, kw_only=True)
    """Port to listen on (default: 8765, or a free one where that is taken)."""
    no_open: bool = field(default=False, kw_only=True)
    """Only serve the page; open no browser."""
    _3d: Annotated[bool, tyro.conf.arg(name="3d")] = field(default=False, kw_only=True)
    """Show the scenes in space instead: what their views see, relit; cameras, lights and boxes of objects."""

    def run(self) -> int:
        """Serve the page until it is stopped."""
        from multilight.datagen.storage.open_dataset import open_dataset
        from multilight.datagen.view.server import open_browser

        if self.port is not None and not 0 <= self.port < 1 << 16:
            raise UserError(f"--port {self.port} must be 0 to {(1 << 16) - 1}")
        source = open_dataset(self.address, where=self.where)
        if not source.indices:
            chosen = f" for which {self.where}" if self.where else ""
            raise UserError(f"{self.address} holds no finished scene{chosen}")
        with self._listening(source) as server:
            opened = not self.no_open and open_browser(server.address)
            print(f"{server.address} {'is open in the browser' if opened else 'shows it'}; Ctrl+C ends", flush=True)
            server.serve_forever()
        return 0

    def _listening(self, source: "DatasetSource") -> "Server | Space":
        from multilight.datagen.view.server import listen

        if not self._3d:
            return listen(source, self.port)
        try:
            from multilight.datagen.view.space import Space
        except ModuleNotFoundError as error:
            raise UserError(f"--3d needs {error.name}: pip install 'multilight[3d]'") from None
        return Space(source, self.port)


class Mix(MixRequest):
    """Make a picture of a stored view under any lighting."""

    def run(self) -> int:
        """Write the picture and return the exit code."""
        from multilight.datagen.tuples.mixing import write_mix

        write_mix(self)
        return 0


@dataclass
class Video:
    """Write a film of a scene: its views, lit by one light after another; then composite against target.

    Small pictures are enlarged to 480 lines. Many views make a quicker film, not a much longer one.
    """

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path = field(kw_only=True)
    """File to write: .mp4, or .webp, which goes round for ever."""
    scene: int = 0
    """Index of the scene."""
    object: str | None = None
    """Insertable object of the composites (default: the one that covers most of a view)."""

    def run(self) -> int:
        """Write the film and return the exit code."""
        from multilight.datagen.commands.output import print_written, progress
        from multilight.datagen.files.outputs import check_file, written
        from multilight.datagen.files.video import CODECS, write_video
        from multilight.datagen.storage.open_dataset import open_dataset
        from multilight.datagen.tuples.film import film
        from multilight.datagen.tuples.mixing import checked_object, checked_scene

        if self.out.suffix.lower() not in CODECS:
            raise UserError(f"--out {self.out}: the suffix must be {' or '.join(CODECS)}")
        source = open_dataset(self.dir)
        record = checked_scene(source, self.scene)
        if self.object is not None:
            checked_object(self.object, record)
        check_file(self.out)
        with progress("shots", "reading") as report, written(self.out) as work:
            seconds = write_video(work, film(source, record, self.object, report))
        views, lights = len(record.views), len(record.rig.lights)
        print_written(self.out, f"{seconds:.0f} s, {views} views, {lights} lights")
        return 0


@dataclass
class Sheet:
    """Write a contact sheet: scenes x (background, composite, target, depth, effect)."""

    dir: tyro.conf.Positional[str]
    """Folder or address of the dataset."""
    out: Path = field(kw_only=True)
    """PNG file to write."""
    scenes: int = 24
    """Most scenes to show."""

    def run(self) -> int:
        """Write the sheet and return the exit code."""
        from multilight.datagen.files.outputs import check_file, written
        from multilight.datagen.storage.open_dataset import open_dataset
        from multilight.datagen.tuples.sheet import contact_sheet

        if not 1 <= self.scenes <= 10_000:
            raise UserError(f"--scenes {self.scenes} must be 1 to 10000")
        source = open_dataset(self.dir)
        if not source.indices:
            raise UserError(f"{self.dir} holds no finished scene; make some with: multilight dataset --out {self.dir}")
        if self.out.suffix.lower() not in (".png", ".jpg", ".webp"):
            raise UserError(f"--out {self.out}: the suffix must be .png, .jpg or .webp")
        check_file(self.out)
        sheet = contact_sheet(source, scenes=self.scenes)
        with written(self.out) as work:
            sheet.save(work)
        print(f"contact sheet: {self.out}")
        return 0


@dataclass
class Stats:
    """Measure how varied a dataset is: histograms, coverage, leaks between splits, near-duplicate scenes."""

    dir: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[DIR|ADDRESS]")] = None
    """Folder or address of the dataset."""
    sample: int | None = None
    """Measure so many scenes of the folder, spread evenly (default: all, at most 2000); without a folder: draw so many,
    without rendering."""
    out: Path | None = None
    """Folder for index.html and stats.json (default: stats in the dataset's folder, none of an address)."""
    preset: Preset | None = None
    """Where scenes are drawn: named starting point of the configuration."""
    config: Path | None = None
    """Where scenes are drawn: TOML file of the configuration."""
    assets: tuple[Path, ...] = ()
    """Folders of your own models that the scenes use."""

    def run(self) -> int:
        """Measure, print a table, write the page and return the exit code: 1 where something leaks."""
        from multilight.datagen.files.outputs import check_folder
        from multilight.datagen.stats.page import print_summary, write_page
        from multilight.datagen.storage.store import file_inside

        if self.dir is None and self.sample is None:
            raise UserError(
                "say which dataset to measure (multilight stats DIR), or how many scenes to draw: --sample N"
            )
        if self.sample is not None and self.sample < 1:
            raise UserError(f"--sample {self.sample} must be 1 or more")
        out = self.out
        if out is None and self.dir is not None and Path(self.dir).is_dir():
            out = file_inside(Path(self.dir), "stats")
        if out is not None:
            check_folder(out)
        summary = self._measure()
        print_summary(summary)
        if out is not None:
            write_page(summary, out)
            print(f"statistics: {out / 'index.html'}")
        return 1 if summary.leaks else 0

    def _measure(self) -> "Summary":
        from multilight.datagen.commands.output import progress
        from multilight.datagen.stats.collect import MOST_MEASURED, measure_dataset, measure_samples
        from multilight.scenes.assets.library import AssetLibrary

        config = load_config(self.config, {}, self.preset)
        library = AssetLibrary(folders=self.assets)
        with progress("scenes", "measuring") as report:
            if self.dir is not None:
                return measure_dataset(self.dir, library, report, self.sample or MOST_MEASURED)
            assert self.sample is not None
            return measure_samples(config, self.sample, library, report)
