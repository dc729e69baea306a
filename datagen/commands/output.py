"""What the commands print: progress with rate and time left, verification tables."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from multilight.datagen.storage.source import repair_command
from multilight.datagen.tables import print_table
from multilight.datagen.text import plain
from multilight.datagen.verification.dataset import ANEW, Result, Verification
from multilight.datagen.verification.views import CHECKS

PLAIN_INTERVAL = 15.0  # seconds between progress lines where there is no terminal
MOST_NAMED = 10
"""Scenes that a row of the table of checks names."""


@contextlib.contextmanager
def progress(unit: str) -> Iterator[Callable[[float, float], None]]:
    """Show progress as a bar on a terminal, as a line now and then elsewhere; yields `report(done, total)`."""
    console = Console(stderr=True)
    start = time.monotonic()
    if not console.is_terminal:
        yield _plain_report(console, unit, start)
        return
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.description}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(unit, total=None)

        def report(done: float, total: float) -> None:
            rate = done / max(time.monotonic() - start, 1e-9)
            bar.update(task, completed=done, total=total, description=f"{unit}, {rate:.2f}/s")

        yield report


def _plain_report(console: Console, unit: str, start: float) -> Callable[[float, float], None]:
    last = start

    def report(done: float, total: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last < PLAIN_INTERVAL and done < total:
            return
        last = now
        rate = done / max(now - start, 1e-9)
        left = f"{(total - done) / rate:.0f} s left" if rate > 0 else "time left unknown"
        console.print(f"{done:.0f}/{total:.0f} {unit}, {rate:.2f}/s, {left}", highlight=False)

    return report


def print_verification(root: str, verification: Verification, *, as_json: bool) -> int:
    """Print what was checked and return the exit code: 1 on any fault or where there is no scene."""
    checked = list(verification.results)
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
        if Path(root).is_dir() and not any(ANEW in fault.message for fault in faults):
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
