"""Seconds and memory of each command on datasets of a thousand, ten thousand, a hundred thousand scenes.

Some closed-form scenes of 16x16 pixels are made, and their records written again and again under further numbers, with
views and previews as links: 2.5 GB for a hundred thousand. Then they go on as any dataset. The folder goes at the end.

    python -m benchmarks.many --sizes 1000 10000 100000
"""

import hashlib
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

from multilight.datagen.production.finishing import Survey, finish
from multilight.datagen.storage.blocks import BLOCK
from multilight.datagen.storage.index import index_row
from multilight.datagen.storage.store import read_dataset, read_scene, scene_dir, write_text
from multilight.datagen.tables import print_table

MADE = 50
"""Scenes that are made; of each further one the content is that of one of them."""
LINKS = 20_000
"""Scenes that share the files of one; file systems allow some 65,000 links."""
MARK = 123_456_789
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
    """Bring a dataset to a number of scenes, index and all."""
    dataset = read_dataset(root)
    grown = dataset.model_copy(update={"config": dataset.config.model_copy(update={"scenes": count})}).sealed()
    write_text(root / "dataset.json", grown.model_dump_json(indent=1))
    records = [read_scene(scene_dir(root, index)) for index in range(MADE)]
    rows = [index_row(record) for record in records]
    marked = [r.model_dump(mode="json", exclude={"record_sha256"}) | {"index": MARK, "split": ""} for r in records]
    texts = [json.dumps(record, sort_keys=True, separators=(",", ":")) for record in marked]
    there = Survey()
    for index in range(MADE, count):
        if (folder := scene_dir(root, index)).exists():
            continue
        kind, split = index % MADE, grown.config.split_of(index)
        _share(scene_dir(root, kind), folder, new=index // MADE % (LINKS // MADE) == 0)
        text = texts[kind].replace(f'"index":{MARK}', f'"index":{index}').replace('"split":""', f'"split":"{split}"')
        digest = hashlib.sha256(text.encode()).hexdigest()
        (folder / "scene.json").write_text(f'{{"record_sha256":"{digest}",{text[1:]}')
        there.add(rows[kind] | {"index": index, "split": split, "record_sha256": digest}, records[kind].assets)
        if len(there.rows) == BLOCK:
            finish(root, there)
    finish(root, there)
    time.sleep(0.1)
    for path in (root / "index.parquet", *root.glob("index/*")):
        os.utime(path)  # so that it is newer than files that were linked again


def _share(first: Path, folder: Path, *, new: bool) -> None:
    """Give a scene the views and the preview of another: as links, or as files of its own for others to share."""
    (folder / "views").mkdir(parents=True)
    for name in ("preview.png", "views/00.exr"):
        if new:
            shutil.copy(first / name, folder / name)
            (first / name).unlink()
            os.link(folder / name, first / name)
        else:
            os.link(first / name, folder / name)


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
        "nothing to do": timed([*make, str(count)]),
        f"{more} more": timed([*make, str(count + more)]),
        f"{more} more again": timed([*make, str(count + 2 * more)]),
        "query": timed([*command, "query", str(root)]),
        "query, few": timed([*command, "query", str(root), "contrast_ev > 1 and index < 300"]),
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
