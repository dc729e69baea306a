"""Datasets made of parts, each in a folder of its own, put together: the bytes of one that was never split."""

import os
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from multilight.datagen.errors import StoreError, UserError, full_disk_told
from multilight.datagen.files.locks import locked
from multilight.datagen.production.drivers import Driver
from multilight.datagen.production.finishing import Survey, finish, survey
from multilight.datagen.production.homes import PATIENCE
from multilight.datagen.report import Report
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.blocks import joined, read_blocks
from multilight.datagen.storage.index import Row
from multilight.datagen.storage.records import DatasetRecord, view_file
from multilight.datagen.storage.store import read_dataset, scene_dir, write_text
from multilight.datagen.verification.dataset import PREVIEW
from multilight.scenes.files.atomic import sync

GROWN = ("assets", "index_sha256", "index_more", "index_rows", "thrown_away")
"""What of a `dataset.json` comes of its scenes."""


@dataclass(frozen=True)
class Merged:
    """How many scenes were put in and how many were there already; which are missing, and which damaged with why."""

    placed: int
    kept: int
    missing: tuple[int, ...]
    damaged: dict[Path, dict[int, str]]


@dataclass(frozen=True)
class _Part:
    """A part, what is there of it, and the rows of its sound scenes."""

    root: Path
    record: DatasetRecord
    there: Survey
    rows: dict[int, Row] = field(repr=False)


def merge_parts(parts: Sequence[Path], out: Path, report: Report) -> Merged:
    """Put the scenes of parts into one dataset, by hard links where the file system has them, and finish it.

    Parts may overlap, and lack scenes. What was stopped goes on. Raises `UserError` naming both where two parts are not
    of one dataset, or hold another scene under the same number.
    """
    found = [_opened(part) for part in parts if not (out.exists() and out.samefile(part))]
    found.sort(key=lambda part: (min(part.rows, default=sys.maxsize), part.root))
    with full_disk_told(out):
        with locked(out, PATIENCE):
            here = _begun(out, found)
            driver = Driver(out)
        try:
            wanted = _chosen(here, found)
            for done, (number, part) in enumerate(wanted.items()):
                report(done, len(wanted))
                row = part.rows[number]
                _place(part.root, out, row, out / "work" / f"{number:06d}-{os.getpid()}-{driver.token}")
                here.there.add(row, part.record.assets)
            with locked(out, PATIENCE):
                finish(out, here.there)
        finally:
            with locked(out, PATIENCE):
                driver.leave()
    sound = here.there.sound
    return Merged(
        placed=len(wanted),
        kept=len(sound) - len(wanted),
        missing=tuple(n for n in range(read_dataset(out).config.scenes) if n not in sound),
        damaged={part.root: part.there.damaged for part in found if part.there.damaged},
    )


def _opened(root: Path) -> _Part:
    record = read_dataset(root)
    index = read_blocks(find_place(root), record)
    there = survey(root, record, index, contents=False)
    rows = {row["index"]: row for row in joined(index.sound().values()).iter_rows(named=True)} | there.rows
    return _Part(root, record, there, {number: rows[number] for number in there.sound})


def _begun(out: Path, parts: Sequence[_Part]) -> _Part:
    """Hold the parts to each other, and write the `dataset.json` of the whole where there is none, or too small."""
    if (out / "dataset.json").exists():
        first = _opened(out)
    elif not parts or any(not path.name.startswith(".") for path in out.iterdir()):
        raise UserError(f"--out {out} holds no dataset; choose an empty folder" if parts else f"{out} is the only part")
    else:
        first = parts[0]
    for part in parts:
        _check_same(first, part)
    scenes = max(part.record.config.scenes for part in (first, *parts))
    record = first.record.model_copy(update={"config": first.record.config.model_copy(update={"scenes": scenes})})
    if first.root != out:
        bare = {name: DatasetRecord.model_fields[name].get_default(call_default_factory=True) for name in GROWN}
        record, first = record.model_copy(update=bare), _Part(out, record, Survey(), {})
    if record.sealed() != first.record:
        write_text(out / "dataset.json", record.sealed().model_dump_json(indent=1))
    return first


def _check_same(one: _Part, other: _Part) -> None:
    """Raise `UserError` naming both where parts are not of one dataset; tell where other versions made them."""
    mine, theirs = one.record, other.record
    for name in DatasetRecord.model_fields.keys() - {*GROWN, "config", "versions", "variant", "record_sha256"}:
        if getattr(mine, name) != getattr(theirs, name):
            raise _not_one(one, other, f"other {name}")
    if told := mine.other_settings(theirs.config, same_background=mine.background_sha256 != ""):
        raise _not_one(one, other, ", ".join(told))
    credits = {credit.id: credit for credit in mine.assets}
    if unlike := [credit.id for credit in theirs.assets if credits.get(credit.id, credit) != credit]:
        raise _not_one(one, other, f"another asset {unlike[0]!r}")
    if (mine.versions, mine.variant) != (theirs.versions, theirs.variant):
        print(f"{other.root} was made with other versions than {one.root}: scenes may differ", file=sys.stderr)


def _not_one(one: _Part, other: _Part, what: str) -> UserError:
    return UserError(f"{one.root} and {other.root} are not parts of one dataset: {what}")


def _chosen(here: _Part, parts: Sequence[_Part]) -> dict[int, _Part]:
    """Choose for each scene that the whole lacks the part that it is taken from; of equal ones the first."""
    chosen: dict[int, _Part] = {}
    for part in parts:
        for number, row in part.rows.items():
            first = here if number in here.rows else chosen.setdefault(number, part)
            if first.rows[number]["record_sha256"] != row["record_sha256"]:
                raise _not_one(first, part, f"scene {number} is another in each; other assets or versions made it")
    return dict(sorted(chosen.items()))


def _place(source: Path, out: Path, row: Row, work: Path) -> None:
    """Give a whole scene its place; nothing is there under its name before."""
    final, origin = scene_dir(out, row["index"]), scene_dir(source, row["index"])
    shutil.rmtree(work, ignore_errors=True)
    for name in ("scene.json", PREVIEW, *map(view_file, range(row["views"]))):
        (work / name).parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(origin / name, work / name)
        except OSError:  # another file system, or one without hard links
            try:
                shutil.copyfile(origin / name, work / name)
            except FileNotFoundError:
                raise StoreError(f"{origin / name} went away meanwhile; run the same command again") from None
        sync(work / name)
    final.parent.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(final, ignore_errors=True)  # damaged
    work.rename(final)
    sync(final.parent)
