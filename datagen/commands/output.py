"""What the commands print: progress with rate and time left, verification tables."""

import contextlib
import json
import logging
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from multilight.datagen.commands.terminal import end_if_asked
from multilight.datagen.files.outputs import check_file
from multilight.datagen.report import LOG, Report, event
from multilight.datagen.storage.open_dataset import repair_command
from multilight.datagen.tables import print_table
from multilight.datagen.text import duration, plain, size, terminal
from multilight.datagen.verification.dataset import Result, Verification
from multilight.datagen.verification.views import CHECKS

FIRST_LINE, LINES = 10.0, 60.0
"""Seconds to the first line of progress and from one to the next where there is no terminal."""
BAR = 8
"""Characters of a bar on a terminal; what is too long for a line is cut in the note."""
SLOW = 0.1
"""What is done a second below which it is counted by the minute."""
MOST_NAMED = 10
"""Scenes that a row of the table of checks names."""


@dataclass
class _Meter:
    """How far a run is, in words."""

    unit: str
    note: str
    start: float
    done: float = 0.0
    total: float = 0.0
    first: tuple[float, float] | None = None
    """When something was done first, and how much; what comes before, getting ready or an earlier run, has no rate."""

    def update(self, done: float, total: float, note: str) -> None:
        self.done, self.total, self.note = done, total, note or self.note
        if done and self.first is None:
            self.first = time.monotonic(), done

    @property
    def elapsed(self) -> float:
        return time.monotonic() - self.start

    @property
    def rate(self) -> float:
        """How much is done a second; 0 where that is not known yet."""
        since, before = self.first or (0.0, self.done)
        return (self.done - before) / max(time.monotonic() - since, 1e-9)

    def count(self) -> str:
        """Say how much is done of how much, and how fast: `12/64 views, 0.45/s`."""
        if not self.total:
            return ""
        told = f"{self.done:.0f}/{self.total:.0f} {self.unit}"
        if not self.rate:
            return told
        pace, unit = (self.rate, "s") if self.rate >= SLOW else (60.0 * self.rate, "min")
        return f"{told}, {f'{pace:.3g}' if pace < 100 else round(pace)}/{unit}"

    def left(self) -> str:
        """Say how long it will take if it goes on as it did."""
        return duration((self.total - self.done) / self.rate) if self.rate else "unknown"


@contextlib.contextmanager
def progress(unit: str, note: str) -> Iterator[Report]:
    """Show progress as a bar on a terminal, as a line a minute elsewhere; yields what to report to.

    `note` says what is going on until a report says otherwise. What is over within seconds shows no line. A report ends
    the command that was asked to end and did not hear it.
    """
    console = Console(stderr=True)
    meter = _Meter(unit, note, time.monotonic())
    with _bar(console, meter) if console.is_terminal else _lines(console, meter) as report:

        def heard(done: float, total: float, note: str = "") -> None:
            end_if_asked()
            report(done, total, note)

        yield heard


@contextlib.contextmanager
def _bar(console: Console, meter: _Meter) -> Iterator[Report]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=BAR),
        TextColumn("{task.fields[count]}"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console, redirect_stdout=sys.stdout.isatty()) as bar:
        task = bar.add_task(meter.note, total=None, count="", left="elapsed")

        def report(done: float, total: float, note: str = "") -> None:
            meter.update(done, total, note)
            left = f"elapsed, {meter.left()} left" if meter.done else "elapsed"
            count = meter.count()
            spare = console.width - len(count) - len(left) - BAR - len(" 0:00:00    ")
            note = meter.note if len(meter.note) <= spare else f"{meter.note[: max(spare, BAR) - 3]}..."
            bar.update(task, completed=done, total=total or None, description=terminal(note), count=count, left=left)

        yield report


@contextlib.contextmanager
def _lines(console: Console, meter: _Meter) -> Iterator[Report]:
    over = threading.Event()

    def tell() -> None:
        wait = FIRST_LINE
        while not over.wait(wait):
            wait = LINES
            told = [meter.note, meter.count(), f"{duration(meter.elapsed)} elapsed, {meter.left()} left"]
            console.print(", ".join(part for part in told if part), markup=False, highlight=False, soft_wrap=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield lambda done, total, note="": meter.update(done, total, note)
    finally:
        over.set()
        teller.join()


class _Lines(logging.FileHandler):
    """A line of JSON an event; where the file cannot be written any more, that is told once."""

    def format(self, record: logging.LogRecord) -> str:
        when = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds")
        about = {"time": when, "event": record.getMessage(), "process": record.process}
        return json.dumps(about | getattr(record, "about", {}), default=str)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802  (the library's name)
        LOG.removeHandler(self)
        print(
            plain(f"{self.baseFilename} cannot be written: {getattr(sys.exc_info()[1], 'strerror', None)}"),
            file=sys.stderr,
        )


@contextlib.contextmanager
def logged(path: Path | None) -> Iterator[None]:
    """Add what happens to a file, a line of JSON an event; raises `UserError` where it cannot be written."""
    if path is None:
        yield
        return
    check_file(path)
    handler = _Lines(path, encoding="utf-8")
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    try:
        yield
    except BaseException as error:
        event("run stopped", reason=str(error) or type(error).__name__)
        raise
    finally:
        LOG.removeHandler(handler)
        with contextlib.suppress(OSError):  # told above
            handler.close()


def print_written(out: Path, what: str) -> None:
    """Print what was written where, and how big it is."""
    files = [out] if out.is_file() else [file for file in out.rglob("*") if file.is_file()]
    print(plain(f"{out}: {what}, {size(sum(file.stat().st_size for file in files))}"))


def print_verification(root: str, verification: Verification, *, as_json: bool) -> int:
    """Print what was checked and return the exit code: 1 on any fault or where there is no scene."""
    checked = verification.results
    faults = [fault for _, found in checked for fault in found]
    scenes = [result for result in checked if result[0] is not None]
    if as_json:
        about = {"written_by": verification.written_by, "scenes": len(scenes)}
        print(json.dumps(about | {"faults": [asdict(fault) for fault in faults]}, indent=1))
        return 1 if faults or not scenes else 0
    _print_table(f"{root}: {len(scenes)} scenes ({verification.written_by})", scenes)
    for fault in faults:
        where = "dataset" if fault.scene is None else f"scene {fault.scene}"
        where += "" if fault.view is None else f", view {fault.view}"
        print(plain(f"{where}: {fault.check}: {fault.message}"))
    if not scenes:
        print(f"{root}: no finished scene")
    elif not faults:
        print(f"all {len(scenes)} scenes ok" if len(scenes) > 1 else "the scene is ok")
    else:
        print(f"{sum(not found for _, found in scenes)} of {len(scenes)} scenes ok, {len(faults)} faults")
        if Path(root).is_dir():
            print(plain(f"what is damaged is made anew by: {repair_command(root)}"))
    return 1 if faults or not scenes else 0


def _print_table(title: str, scenes: list[Result]) -> None:
    """Print a row for each check: what it found, and in which scenes."""
    rows = []
    for check in CHECKS:
        counts = {index: sum(fault.check == check for fault in found) for index, found in scenes}
        bad = [str(index) for index, count in counts.items() if count]
        named = ", ".join(bad[:MOST_NAMED]) + (f" and {len(bad) - MOST_NAMED} more" if len(bad) > MOST_NAMED else "")
        rows.append((check, f"{sum(counts.values())} in scenes {named}" if bad else "ok"))
    print_table(("check", "faults"), rows, title=title)
