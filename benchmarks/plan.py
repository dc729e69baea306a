"""Is `multilight plan` right? It predicts a dataset, which is then made by the clock.

python -m benchmarks.plan --preset tabletop --scenes 40 --views 1 --width 128 --height 96
"""

import contextlib
import io
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

from multilight.datagen.cli import main


def run(words: list[str]) -> None:
    told = io.StringIO()
    with contextlib.redirect_stdout(told):
        assert main(["plan", *words, "--json"]) == 0
    plan = json.loads(told.getvalue())
    with tempfile.TemporaryDirectory() as folder:
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        main(["dataset", "--out", f"{folder}/made", *words])  # scenes that fail are told
        wall, after = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
        size = sum(file.stat().st_size for file in Path(folder, "made", "scenes").rglob("*.*"))
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    print(f"{plan['measured']} of {plan['scenes']} scenes were made for the plan")
    for name, planned, taken, unit in (
        ("computing", 3600 * plan["core_hours"], spent, "core-seconds"),
        ("time", 3600 * plan["hours"], wall, "s"),
        ("disk", plan["bytes"] / 1e6, size / 1e6, "MB"),
        ("memory of a worker", plan["memory"] / 1e9, after.ru_maxrss / 1e6, "GB"),
    ):
        print(f"{name}: planned {planned:.4g}, taken {taken:.4g} {unit}; ratio {planned / taken:.2f}")


if __name__ == "__main__":
    run(sys.argv[1:])
