"""Commands that make scenes: `dataset`, `scene`."""

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from datagen.errors import UserError
from datagen.presets import Preset
from datagen.text import plain

Kind = Literal["tabletop", "room", "outdoor", "studio", "custom", "spheres", "imported", "mixed"]
Renderer = Literal["auto", "mitsuba", "cycles", "analytic"]


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
        return make_scenes(self.out, config, tuple(range(config.scenes)), workers=self.workers, assets=self.assets)


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
        return make_scenes(self.out, config, (self.index,), workers=1, assets=self.assets)


def make_scenes(
    out: Path, config: object, indices: tuple[int, ...], *, workers: int | None, assets: tuple[Path, ...]
) -> int:
    """Make what is missing of these scenes of a dataset, say how it went, and return the exit code."""
    from datagen.config import DatasetConfig
    from datagen.dataset import Plan, default_workers, make_dataset
    from datagen.doctor import slow_note
    from datagen.report import progress

    assert isinstance(config, DatasetConfig)
    if workers is not None and workers < 1:
        raise UserError(f"--workers {workers} must be 1 or more")
    if note := slow_note(config.renderer):
        print(note, file=sys.stderr)
    plan = Plan(out, config, indices, workers or default_workers(len(indices)), assets)
    with progress("views") as report:
        outcome = make_dataset(plan, report)
    if outcome.broken:
        print(f"passed over {len(outcome.broken)} broken assets:", file=sys.stderr)
    for asset, reason in sorted(outcome.broken.items()):
        print(plain(f"  {asset}: {reason}"), file=sys.stderr)
    for index, reason in outcome.failures.items():
        print(plain(f"failed: scene {index}: {reason}"), file=sys.stderr)
    if spent := sum(outcome.seconds.values()):
        print(", ".join(f"{stage} {share / spent:.0%}" for stage, share in outcome.seconds.items()) + " of the time")
    if outcome.made or outcome.failures:
        summary = {"made": len(outcome.made), "kept": outcome.kept, "failed": len(outcome.failures)}
        print(f"{out}: " + json.dumps(summary).strip("{}").replace('"', ""))
    else:
        print(f"{out}: nothing to do, all {outcome.kept} scenes are there")
    return 1 if outcome.failures else 0
