"""How far a dataset in the making is, seen from outside: its scenes, and what the runs on it tell of themselves."""

import contextlib
import os
import re
import shutil
import socket
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from multilight.datagen.backends.machine.memory import free_bytes, used_bytes
from multilight.datagen.errors import StoreError
from multilight.datagen.production.aside import FOLDER as ASIDE
from multilight.datagen.production.drivers import FOLDER, LEASE
from multilight.datagen.storage.address import find_place
from multilight.datagen.storage.open_dataset import scene_names
from multilight.datagen.storage.store import MOST_RECORD, parse_dataset
from multilight.scenes.frozen import Frozen

STATE = ".json"
"""What follows a run's token in the name of the file that holds its state."""


RUN_GAUGES = {
    "workers": "Worker processes of a run.",
    "made": "Scenes that a run has made.",
    "memory": "Bytes of memory of a run and its workers.",
    "free_memory": "Bytes of memory free on its machine.",
    "free_disk": "Bytes of disk free for its files.",
}


class RunState(Frozen):
    """What a run tells of itself, every few seconds.

    `time` is its own clock's [s since 1970], `seconds` how long it has been at work, `memory` what it and its workers
    take, `free_memory` and `free_disk` what is left there [bytes].
    """

    host: str
    process: int
    time: float
    seconds: float
    workers: int
    made: int
    in_work: tuple[int, ...]
    memory: int
    free_memory: int
    free_disk: int


def state_here(root: Path, since: float, *, workers: int, made: int, in_work: tuple[int, ...]) -> RunState:
    """Describe this process's run, at work in `root` since a time of the monotonic clock."""
    return RunState(
        host=socket.gethostname(),
        process=os.getpid(),
        time=time.time(),
        seconds=time.monotonic() - since,
        workers=workers,
        made=made,
        in_work=in_work,
        memory=used_bytes(),
        free_memory=free_bytes(),
        free_disk=shutil.disk_usage(root).free,
    )


@dataclass(frozen=True)
class Status:
    """A dataset in the making: how many scenes it shall have and has, those set aside by reason, and runs at work."""

    address: str
    scenes: int
    done: int
    failed: dict[str, list[int]]
    runs: tuple[RunState, ...]

    @property
    def in_work(self) -> int:
        """Scenes that runs have in hand."""
        return len({scene for run in self.runs for scene in run.in_work})

    @property
    def per_hour(self) -> float:
        """Scenes an hour, of all runs together; 0 where none is made yet."""
        return sum(3600 * run.made / run.seconds for run in self.runs if run.made)

    @property
    def seconds_left(self) -> float | None:
        """How long it takes if it goes on so; None where that is not known."""
        return 3600 * (self.scenes - self.done) / self.per_hour if self.per_hour else None


def status_of(address: str) -> Status:
    """Look at a dataset at any address; raises `StoreError` where there is none."""
    place = find_place(address)
    record = parse_dataset(place.read("dataset.json", MOST_RECORD), f"{place.address}/dataset.json")
    runs = []
    for name in place.names(FOLDER) or ():
        if name.endswith(STATE):
            try:
                runs.append(RunState.from_json(place.read(f"{FOLDER}/{name}", MOST_RECORD).decode()))
            except (StoreError, ValidationError, UnicodeDecodeError):  # it has left meanwhile
                continue
    failed: dict[str, list[int]] = {}
    for name in place.names(ASIDE) or ():
        with contextlib.suppress(StoreError):  # it is tried again
            reason = place.read(f"{ASIDE}/{name}").decode(errors="replace").partition("\n")[0]
            failed.setdefault(kind_of_failure(reason), []).append(int(Path(name).stem))
    lately = (run for run in runs if abs(time.time() - run.time) < LEASE)
    done = sum(number < record.config.scenes for number in scene_names(place) or ())
    return Status(
        place.address,
        record.config.scenes,
        done,
        failed,
        tuple(sorted(lately, key=lambda run: (run.host, run.process))),
    )


def kind_of_failure(reason: str) -> str:
    """Return what is alike in the reasons of scenes that failed in one way."""
    return re.split("[:(]", re.sub(r"^scene \d+ (\(seed \d+\) )?", "", reason))[0].strip()


def prometheus(status: Status) -> str:
    """Return a status in Prometheus' text format, https://prometheus.io/docs/instrumenting/exposition_formats/."""
    lines: list[str] = []

    def gauge(name: str, about: str, values: Iterable[tuple[dict[str, str], float]]) -> None:
        lines.extend((f"# HELP multilight_{name} {about}", f"# TYPE multilight_{name} gauge"))
        for labels, value in values:
            told = ",".join(f'{key}="{_escaped(text)}"' for key, text in ({"dataset": status.address} | labels).items())
            lines.append(f"multilight_{name}{{{told}}} {value:.15g}")

    scenes = {"wanted": status.scenes, "done": status.done, "in_work": status.in_work}
    failed = ((({"reason": reason}), len(found)) for reason, found in status.failed.items())
    gauge("scenes", "Scenes by state.", (({"state": state}, count) for state, count in scenes.items()))
    gauge("scenes_failed", "Scenes that could not be made, by reason.", failed)
    gauge("scenes_per_hour", "Scenes made an hour, of all runs.", [({}, status.per_hour)])
    if status.seconds_left is not None:
        gauge("seconds_left", "Seconds until all scenes are made.", [({}, status.seconds_left)])
    gauge("runs", "Runs at work.", [({}, len(status.runs))])
    for name, about in RUN_GAUGES.items():
        unit = "_bytes" if about.startswith("Bytes") else ""
        values = (({"host": run.host, "process": str(run.process)}, getattr(run, name)) for run in status.runs)
        gauge(f"run_{name}{unit}", about, values)
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")
