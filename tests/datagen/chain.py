"""Records changed so that their hashes hold: what a maker with a fault, or someone hostile, would write."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from multilight.datagen.production.finishing import Survey, finish
from multilight.datagen.storage.index import index_row
from multilight.datagen.storage.records import record_hash
from multilight.datagen.storage.store import read_scene, scene_dir, scene_indices

Json = dict[str, Any]


def rewrite_json(path: Path, change: Callable[[Json], object]) -> None:
    """Change a record and give it the hash that it has then."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content | {"record_sha256": record_hash(content)}))


def chain(root: Path) -> None:
    """Write index and `dataset.json` as the scenes' records are now."""
    there = Survey(unread={0})
    for record in (read_scene(scene_dir(root, index)) for index in scene_indices(root)):
        there.add(index_row(record), record.assets)
    (root / "index.parquet").unlink(missing_ok=True)
    finish(root, there)
