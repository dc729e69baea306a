"""Seconds and memory of each command on datasets of a thousand, ten thousand, a hundred thousand scenes.

Some closed-form scenes of 16x16 pixels are made, and their records written again and again under further numbers, with
views and previews as links: 2.5 GB for a hundred thousand. The folder goes at the end.

    python -m benchmarks.many --sizes 1000 10000 100000
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

from multilight.datagen.storage.records import record_hash
from multilight.datagen.storage.store import read_dataset, scene_dir
from multilight.datagen.tables import print_table

MADE = 200
"""Scenes that are made; of each further one the content is that of one of them."""
LINKS = 20_000
"""Scenes that share the files of one; file systems allow some 65,000 links."""
SETTINGS = "--kind spheres --renderer analytic --width 16 --height 16 --views 1 --spp 1 --seed 1"
OPEN = "import sys, multilight; data = multilight.open(sys.argv[1]); print(len(data), data[-1].lights)"
TRAIN = (
    "import sys; from multilight.model.data import MultiLightDataset, SampleSettings; "
    "data = MultiLightDataset(sys.argv[1], SampleSettings(size=16, visible=1)); print(data[0]['composite'].shape)"
)


@dataclass
class Options:
    """What to measure."""

    sizes: tuple[int, ...] = (1000, 10_000, 100_000)
    folder: Path | None = None
    """Where the datasets lie for the while (default: the folder for temporary files)."""


def fill(root: Path, count: int) -> None:
    """Write scenes up to a number, as if they had been made and the run killed before it wrote any index."""
    split_of = read_dataset(root).config.model_copy(update={"scenes": count}).split_of
    contents = [json.loads((scene_dir(root, index) / "scene.json").read_text()) for index in range(MADE)]
    for index in range(MADE, count):
        if (folder := scene_dir(root, index)).exists():
            continue
        first = scene_dir(root, index % MADE)
        (folder / "views").mkdir(parents=True)
        for name in ("preview.png", "views/00.exr"):
            if index // MADE % (LINKS // MADE):
                os.link(first / name, folder / name)
            else:  # a new file, so that none gets too many links
                shutil.copy(first / name, folder / name)
                (first / name).unlink()
                os.link(folder / name, first / name)
        record = contents[index % MADE] | {"index": index, "split": split_of(index)}
        (folder / "scene.json").write_text(json.dumps(record | {"record_sha256": record_hash(record)}))


def timed(words: list[str]) -> str:
    """Run a command; return its core-seconds, seconds and largest memory in words."""
    start = time.monotonic()
    process = subprocess.Popen([sys.executable, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None
    said = process.stderr.read().decode().strip()
    _, status, used = os.wait4(process.pid, 0)
    if status:
        print(f"{' '.join(words)}: {said}", file=sys.stderr)
    seconds = used.ru_utime + used.ru_stime
    return f"{seconds:.1f} ({time.monotonic() - start:.1f}) s, {used.ru_maxrss / 1000:.0f} MB"


def measured(root: Path, count: int, more: int) -> dict[str, str]:
    """Run every command on a dataset, which is brought to `count` scenes, and then grows by `more` and `more` again."""
    make = ["-m", "multilight", "dataset", "--out", str(root), "--workers", "1", "--scenes"]
    command = ["-m", "multilight"]
    fill(root, count)
    return {
        "index from records": timed([*make, str(count)]),
        "nothing to do": timed([*make, str(count)]),
        f"{more} more": timed([*make, str(count + more)]),
        f"{more} more again": timed([*make, str(count + 2 * more)]),
        "query": timed([*command, "query", str(root)]),
        "query, few": timed([*command, "query", str(root), "contrast_ev > 9"]),
        "open, one scene": timed(["-c", OPEN, str(root)]),
        "MultiLightDataset": timed(["-c", TRAIN, str(root)]),
        "verify --sample 100": timed([*command, "verify", str(root), "--sample", "100"]),
        "stats --sample 100": timed([*command, "stats", str(root), "--sample", "100"]),
    }


def main(options: Options) -> None:
    """Print a table: a row a command, a column a size."""
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        root = Path(folder) / "set"
        words = ["-m", "multilight", "dataset", "--out", str(root), "--scenes", str(MADE), *SETTINGS.split()]
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
        columns = {}
        for count in sorted(options.sizes):
            columns[count] = measured(root, count, 10)
            rows = [(name, *(found[name] for found in columns.values())) for name in columns[count]]
            print_table(("core-seconds (seconds), memory", *(f"{size:,}" for size in columns)), rows)


if __name__ == "__main__":
    main(tyro.cli(Options))
