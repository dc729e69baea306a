"""The index: one Parquet row a scene, for look-ups without opening the scenes."""

from pathlib import Path
from typing import Any

import polars as pl

from datagen.records import SceneRecord
from datagen.store import read_scene, scene_dir, scene_indices


def write_index(root: Path) -> None:
    """Write `index.parquet` anew from the finished scenes, under a temporary name first."""
    rows = [index_row(read_scene(scene_dir(root, index))) for index in scene_indices(root)]
    path = root / "index.parquet"
    temporary = path.with_suffix(".tmp")
    pl.DataFrame(rows).write_parquet(temporary)
    temporary.replace(path)


def index_row(record: SceneRecord) -> dict[str, Any]:
    """Summarize a scene: what is in it, what shines, how large it is."""
    objects = [body for body in record.scene.bodies if body.role == "object"]
    return {
        "index": record.index,
        "seed": record.seed,
        "kind": record.scene.kind,
        "split": record.split,
        "renderer": record.renderer,
        "views": len(record.views),
        "width": record.views[0].width,
        "height": record.views[0].height,
        "objects": len(objects),
        "insertable": list(record.scene.insertable),
        "categories": [body.category for body in objects],
        "lights": list(record.rig.names),
        "light_kinds": [light.kind for light in record.rig.lights],
        "emissive": any(light.kind == "emissive" for light in record.rig.lights),
        "conditions": [condition.name for condition in record.conditions],
        "bytes": sum(view.bytes for view in record.views),
        "scene_sha256": record.scene_sha256,
        "rig_sha256": record.rig_sha256,
    }
