"""Making a dataset, or one scene of it."""

import contextlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

from multilight.datagen.backends.protocol import BackendError
from multilight.datagen.commands.output import progress as shown
from multilight.datagen.config.dataset import DatasetConfig, load_config
from multilight.datagen.config.presets import PRESETS, Preset
from multilight.datagen.errors import UserError
from multilight.datagen.production.crew import limits_for
from multilight.datagen.production.dataset import Outcome, make_dataset, settings_of
from multilight.datagen.production.homes import local_folder
from multilight.datagen.production.memory import default_workers
from multilight.datagen.production.running import Plan
from multilight.datagen.report import silent
from multilight.datagen.text import plain
from multilight.reading import Dataset, Scene, open
from multilight.scenes.assets.info import AssetError

Folders = str | Path | Iterable[str | Path]


def make(
    out: str | Path,
    *,
    preset: Preset | None = None,
    config: str | Path | None = None,
    assets: Folders = (),
    workers: int | None = None,
    repair: bool = False,
    progress: bool = True,
    **settings: Any,
) -> Dataset:
    """Make a dataset, or continue one, in the folder or at the address `out`, and open it.

    `settings` are those that `multilight config show` lists: `scenes`, `seed`, `kind`, `renderer`, `width`, `height`,
    `views`, `spp` and so on, tables as dicts (`cameras={"lens_mm": (35.0, 50.0)}`). They go over the TOML file
    `config`, that over the `preset`, and all of it over what the dataset was made with, if it is there already:
    finished scenes are kept, damaged ones made anew (`repair` looks at what their pictures hold as well).

    `assets` are folders of your own models. `workers` processes, one a core unless said, work at scenes; `progress` is
    shown on standard error. Raises `UserError` naming the value and what is allowed, or the scenes that failed.
    """
    wanted = _configuration(out, preset, config, settings)
    return _made(out, wanted, tuple(range(wanted.scenes)), assets, workers, repair, progress)


def make_scene(
    out: str | Path,
    index: int = 0,
    *,
    preset: Preset | None = None,
    config: str | Path | None = None,
    assets: Folders = (),
    progress: bool = True,
    **settings: Any,
) -> Scene:
    """Make one scene of a dataset, the same as it is in the whole one of that seed, and open it; else as `make`."""
    if type(index) is not int or index < 0:
        raise UserError(f"index {index!r} must be a whole number from 0 up")
    wanted = _configuration(out, preset, config, {"scenes": index + 1} | settings)
    return _made(out, wanted, (index,), assets, 1, False, progress, retry=True).scene(index)


def _configuration(
    out: str | Path, preset: Preset | None, config: str | Path | None, settings: dict[str, Any]
) -> DatasetConfig:
    """Lay settings over file, preset and what the dataset was made with."""
    if preset is not None and preset not in PRESETS:
        raise UserError(f"preset {preset!r}: there are {', '.join(PRESETS)}")
    try:
        return load_config(None if config is None else Path(config), settings, preset, settings_of(out))
    except UserError as error:
        raise UserError(str(error).removeprefix("command line: ")) from None


def _made(
    out: str | Path,
    config: DatasetConfig,
    indices: tuple[int, ...],
    assets: Folders,
    workers: int | None,
    repair: bool,
    progress: bool,
    retry: bool = False,
) -> Dataset:
    if workers is not None and (type(workers) is not int or workers < 1):
        raise UserError(f"workers {workers!r} must be a whole number from 1 up")
    folders = tuple(Path(folder) for folder in ([assets] if isinstance(assets, str | Path) else assets))
    count, folder = workers or default_workers(len(indices), config), local_folder(out)
    address = str(out) if folder is None else ""
    limits = limits_for(config)
    plan = Plan(folder or Path(), config, indices, count, limits, folders, repair, retry=retry, address=address)
    try:
        with _no_main(), shown("views", "starting") if progress else contextlib.nullcontext(silent) as report:
            outcome = make_dataset(plan, report)
    except (AssetError, BackendError) as error:
        raise UserError(str(error)) from error
    _tell(outcome)
    return open(out)


def _tell(outcome: Outcome) -> None:
    """Say which assets were passed over; raise `UserError` where scenes failed."""
    for asset, reason in sorted(outcome.broken.items()):
        print(plain(f"passed over a broken asset: {asset}: {reason}"), file=sys.stderr)
    if outcome.failures:
        index, reason = min(outcome.failures.items())
        raise UserError(f"{len(outcome.failures)} scenes failed, {len(outcome.made)} were made; {index}: {reason}")


@contextlib.contextmanager
def _no_main() -> Iterator[None]:
    """Keep workers from running the caller's script, which would make the dataset again in each of them."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
