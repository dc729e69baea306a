"""What long commands say: where they are while they run, and how it went."""

import contextlib
import os
import re
import signal
import time
from pathlib import Path

import pytest

from multilight.datagen.commands import output
from multilight.datagen.commands.dataset import summary
from multilight.datagen.commands.output import progress
from multilight.datagen.commands.terminal import EndedError, signals_end_it
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.crew import limits_for
from multilight.datagen.production.dataset import Outcome
from multilight.datagen.production.running import Plan
from multilight.datagen.text import duration, size


def test_lines_say_what_goes_on_how_far_it_is_and_how_long_it_takes(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(output, "FIRST_LINE", 0.05)
    monkeypatch.setattr(output, "LINES", 0.05)

    def line_with(words: str) -> str:
        for _ in range(500):
            time.sleep(0.02)
            for line in capsys.readouterr().err.splitlines():
                if words in line:
                    return line
        raise AssertionError(f"no line with {words}")

    with output.progress("views", "starting") as report:
        first = line_with("starting")
        report(3, 12, "rendering")
        report(6, 12)
        second = line_with("6/12")
    assert re.fullmatch("starting, [0-9] s elapsed, unknown left", first)
    assert second.startswith("rendering, 6/12 views, ")
    assert re.search(r"/s, [0-9] s elapsed, [0-9] s left$", second), second


def test_what_is_over_at_once_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress("views", "starting") as report:
        report(12, 12, "rendering")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("seconds", "said"), [(0.4, "0 s"), (59.6, "1 min 00 s"), (185, "3 min 05 s"), (7800, "2 h 10 min")]
)
def test_times_in_words(seconds: float, said: str) -> None:
    assert duration(seconds) == said


@pytest.mark.parametrize(
    ("count", "said"), [(0, "0 B"), (999, "999 B"), (512_300, "512 kB"), (999_600, "1 MB"), (1_340_000_000, "1.34 GB")]
)
def test_sizes_in_words(count: int, said: str) -> None:
    assert size(count) == said


def test_the_last_line_counts_scenes_bytes_and_draws_thrown_away(tmp_path: Path) -> None:
    plan = Plan(tmp_path, DatasetConfig(), (0, 1, 2, 3), 2, limits_for(DatasetConfig()))
    reasons = ("contacts: nothing carries glasses", "noise: view 1: too much", "contacts: nothing carries cup")
    outcome = Outcome((0, 1), 1, {3: "no"}, {}, {"render": 3.0, "rest": 1.0}, (), reasons, 6, 6000)
    assert summary(plan, outcome, 65.0) == (
        "3 of 4 scenes ok: 2 made, 1 kept, 1 failed; 6 views, 6 kB; 1 min 05 s (render 75%, rest 25%); "
        "3 drawn anew (contacts 2, noise 1)"
    )
    assert summary(plan, Outcome((), 4, {}, {}, {}, ()), 1.0) == "nothing to do, all 4 scenes are there"


def test_a_signal_that_a_library_swallowed_ends_the_command_at_the_next_report() -> None:
    told = []

    def command() -> None:
        with signals_end_it(), progress("scenes", "starting") as report:
            with contextlib.suppress(BaseException):  # as extension modules do while they are imported
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(5)
            try:
                report(1, 4)
            finally:
                report(2, 4)  # what clears up is not stopped by it
                told.append(2)

    with pytest.raises(EndedError) as ended:
        command()
    assert told == [2]
    assert ended.value.code == 128 + signal.SIGTERM
    with progress("scenes", "starting") as report:
        report(1, 4)
