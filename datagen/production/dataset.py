"""Make or continue a dataset: plan, worker processes, index; resumable after any kill."""

import contextlib
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

from multilight.datagen.backends.choose import resolve_renderer
from multilight.datagen.config.dataset import DatasetConfig, RendererName
from multilight.datagen.errors import StoreError, UserError, full_disk_told
from multilight.datagen.production.aside import aside_name, take_up, why_aside
from multilight.datagen.production.homes import Home, open_home
from multilight.datagen.production.library import check_library, located, same_background
from multilight.datagen.production.makers import Makers, makers_here
from multilight.datagen.production.running import Plan, Work, run_scenes
from multilight.datagen.report import Report, event
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.open_dataset import read_record, scene_names
from multilight.datagen.storage.records import DatasetRecord, ImportAccount
from multilight.datagen.storage.store import COPIES, MOST_RECORD, parse_dataset, read_dataset, scene_indices, write_text
from multilight.scenes.assets.cache import check_cache, file_digest
from multilight.scenes.assets.check import MODELS
from multilight.scenes.assets.info import AssetRole
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.assets.packs.background import PACK


@dataclass(frozen=True)
class Outcome:
    """What a run did; `failures` maps a scene, `broken` an asset that was passed over, to one line of reason.

    Scenes that failed are set aside; `tried_again` says of each failed try that was not the last why.
    `changed` are scenes that were damaged and came out otherwise than the index states; `seconds` maps each stage to
    the time it took, over all workers; `thrown_away` are the reasons of the draws that failed a check and were drawn
    anew; `views` and `size` are the number and the bytes of the views that were made, `others` the scenes that other
    runs on the folder made meanwhile, `retried` the requests to a bucket that were tried again.
    """

    made: tuple[int, ...]
    kept: int
    failures: dict[int, str]
    broken: dict[str, str]
    seconds: dict[str, float]
    changed: tuple[int, ...]
    thrown_away: tuple[str, ...] = ()
    views: int = 0
    size: int = 0
    others: int = 0
    tried_again: tuple[str, ...] = ()
    retried: int = 0


def make_dataset(plan: Plan, report: Report) -> Outcome:
    """Make what is missing or damaged of the plan's scenes, and finish: index and credits agree with the scenes then.

    Other runs may be at work in the folder. Raises `UserError` where it cannot be written, holds a dataset of another
    configuration or renderer, or is full.
    """
    renderer = resolve_renderer(plan.config.renderer)
    _check_kind(plan.config, renderer)
    if renderer != "analytic":
        check_cache()
    with open_home(plan.root, plan.address) as home:
        plan = replace(plan, config=located(plan.config, home.root), root=home.root)
        library = check_library(plan.config, plan.asset_folders)
        here = makers_here(renderer, library)
        with full_disk_told(plan.root):
            with home.held():
                record = _open_record(plan, renderer, home, here)
                if library is not None and (said := _accounts(library)) != record.imports:
                    record = record.model_copy(update={"imports": said}).sealed()
                    write_text(plan.root / "dataset.json", record.model_dump_json(indent=1))
                for leftover in plan.root.glob(".*.tmp*"):
                    leftover.unlink()
                driver = home.join(plan.shard)
            try:
                report(0, 0, "looking at what is there")
                there = home.survey(contents=plan.repair)
                gpu = record.variant.startswith("cuda")
                return _made(plan, Work(plan, renderer, gpu, there, home, driver, report), library, record, here)
            finally:
                with contextlib.suppress(UserError), home.held():  # on a full disk there may be no lock
                    driver.leave()


def _made(plan: Plan, work: Work, library: AssetLibrary | None, record: DatasetRecord, here: Makers) -> Outcome:
    """Make what is missing of the plan, and finish."""
    there = work.there
    wanted = sorted({*(i for i in plan.indices if plan.shard is None or plan.shard.has(i)), *there.damaged})
    missing = tuple(i for i in wanted if i not in there.sound)
    further = () if plan.shard is None else tuple(sorted({*plan.indices} - there.sound - {*missing}))
    for index in missing if plan.retry else ():
        take_up(plan.root, index)
    place = work.home.place.address
    event("run begins", out=place, scenes=len(wanted), missing=len(missing), workers=plan.workers)
    if missing or further:
        for index, reason in there.damaged.items():
            print(f"scene {index} is damaged and made anew: {reason}", file=sys.stderr)
        _check_makers(record, plan, here)
        work.broken.update({} if library is None else _broken_models(library))
        run_scenes(work, missing, further)
    home = work.home
    with home.held():
        home.finish(there)
        if {*missing, *further} - work.made.keys():  # of what runs made that were killed, nobody has written the rows
            home.finish(home.survey(contents=False))
    aside = {index: why_aside(plan.root, index) for index in missing if index not in work.made}
    failures = {
        index: f"{why}; set aside, --retry tries it again (seed {plan.config.seed}, log {place}/{aside_name(index)})"
        for index, why in aside.items()
        if why
    }
    event("run ends", made=len(work.made), failed=len(failures), scenes=len(there.sound))
    return Outcome(
        made=tuple(work.made),
        kept=len(wanted) - len(missing),
        failures=failures,
        broken=work.broken,
        seconds=work.seconds,
        changed=tuple(work.changed),
        thrown_away=tuple(work.thrown_away),
        tried_again=tuple(work.tried_again),
        views=sum(views for views, _ in work.made.values()),
        size=sum(size for _, size in work.made.values()),
        retried=len(work.retried) + len(home.retried),
        others=len(set(missing) - work.made.keys() - failures.keys()),
    )


def settings_of(out: str | Path) -> dict[str, Any]:
    """Return what the dataset in a folder or at an address was made with, to be continued so; nothing for none."""
    with contextlib.suppress(StoreError):  # damaged: told where it is continued
        record = parse_dataset(find_place(out).read("dataset.json", MOST_RECORD), "")
        return record.config.model_dump(exclude={"renderer"}) | {"renderer": record.renderer}
    return {}


def _check_kind(config: DatasetConfig, renderer: RendererName) -> None:
    if renderer == "analytic" and config.kind not in ("spheres", "imported"):
        raise UserError(
            f"renderer 'analytic' is a closed form for spheres on a plane and cannot render kind {config.kind!r}; "
            "use --kind spheres, or --renderer cycles"
        )


def _check_makers(record: DatasetRecord, plan: Plan, here: Makers) -> None:
    """Raise `UserError` where packs that scenes drew from are missing; tell where others make what is new."""
    there = {PACK, *(folder.resolve().name for folder in plan.asset_folders), *AssetLibrary().packs}
    if missing := sorted({credit.pack for credit in record.assets} - there):
        raise UserError(
            f"{plan.place} was made with the pack {missing[0]!r}, which is not there; run `multilight assets fetch "
            f"{missing[0]}`, or name the folder of that name with --assets"
        )
    if said := here.others(record):
        print(f"{plan.place} was made with {'; '.join(said)}: scenes may come out otherwise", file=sys.stderr)


def _open_record(plan: Plan, renderer: RendererName, home: Home, here: Makers) -> DatasetRecord:
    """Write `dataset.json`, or check that what is there was made with the same configuration and renderer."""
    path, name = plan.root / "dataset.json", home.place.address
    if not path.exists() and not scene_indices(plan.root):
        if any(not p.name.startswith(".") for p in plan.root.iterdir()):
            raise UserError(f"output folder {name} holds other files and no dataset; choose an empty --out")
        return _new_record(plan, renderer, here)
    if any(home.place.exists(file) for file in COPIES):
        raise UserError(f"{name} is a packed copy or an export; the command that made it makes it anew")
    try:
        record = read_dataset(plan.root)
    except StoreError as error:
        return _restored_record(plan, renderer, home, here, error)
    if record.renderer != renderer:
        raise UserError(
            f"{name} was made with renderer {record.renderer!r} and cannot be continued with {renderer!r}; "
            f"use --renderer {record.renderer} or another --out"
        )
    if record.variant == "scalar_rgb":
        raise UserError(
            f"{name} was made with Mitsuba's variant 'scalar_rgb', which is gone and looks different; "
            "it can be read, but not continued: use another --out"
        )
    same = same_background(record, plan.config.background)
    if other := record.other_settings(plan.config, same_background=same):
        raise UserError(
            f"{name} was made with {', '.join(other)}; leave that away to continue it as it is, or use another --out"
        )
    if plan.config.scenes > record.config.scenes:
        grown = record.config.model_copy(update={"scenes": plan.config.scenes})
        record = record.model_copy(update={"config": grown}).sealed()
        write_text(path, record.model_dump_json(indent=1))
    return record


def _new_record(plan: Plan, renderer: RendererName, here: Makers) -> DatasetRecord:
    """Write the `dataset.json` of a dataset that begins."""
    seen = "" if plan.config.background is None else file_digest(plan.config.background) or ""
    made = DatasetRecord(config=plan.config, renderer=renderer, background_sha256=seen, **vars(here))
    record = made.sealed()
    write_text(plan.root / "dataset.json", record.model_dump_json(indent=1))
    return record


def _restored_record(plan: Plan, renderer: RendererName, home: Home, here: Makers, error: StoreError) -> DatasetRecord:
    """Write a damaged `dataset.json` anew from the options given, where every record that can be read agrees.

    Where none of the scenes can be read, nothing says that they are not of another version: they are left alone.
    """
    how = f"give --repair and the options that {plan.place} was made with"
    if not plan.repair:
        raise UserError(f"{error}; to write it anew, {how}")
    record = DatasetRecord(config=plan.config, renderer=renderer, versions={})
    scenes, agree = scene_names(home.place) or [], 0
    for index in scenes:
        with contextlib.suppress(StoreError):
            if reason := record.misfit(read_record(home.place, index)):
                raise UserError(f"{error}; to write it anew, {how}: of scene {index} {reason}")
            agree += 1
    if scenes and not agree:
        raise UserError(f"{error}; none of its {len(scenes)} scenes can be read either: choose another --out")
    print(f"{error}; it is written anew from the options given", file=sys.stderr)
    return _new_record(plan, renderer, here)


def _accounts(library: AssetLibrary) -> tuple[ImportAccount, ...]:
    """Say of each file of the user's what it states and is not carried."""
    infos = [info for role in get_args(AssetRole) for info in library.list(role)]
    own = [info for info in infos if info.as_made] + [i for i in infos if i.pack == PACK and i.role == "surrounding"][
        :1
    ]
    notes = ((info.id, tuple(map(str, library.notes(info.id)))) for info in own if info.role != "texture")
    return tuple(ImportAccount(asset=asset, notes=said) for asset, said in notes if said)


def _broken_models(library: AssetLibrary) -> dict[str, str]:
    """Name the models of the user's folders that cannot be used, with the reason."""
    for info in (info for role in MODELS for info in library.list(role)):
        if info.size is None:
            with contextlib.suppress(AssetError):
                library.mesh(info.id)
    return library.broken
