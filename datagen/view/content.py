"""What the page of the light mixer reads: JSON that says what there is, and arrays as gzip beside it.

    dataset.json                              the scenes
    scenes/000123/scene.json, preview.png     lights, objects, bodies, stored conditions, views
    scenes/000123/views/03/view.json          sizes, and the arrays of each file beside it
    scenes/000123/views/03/all.gz             layers with every object
    scenes/000123/views/03/object_<name>.gz   layers without an object, and the object's own
    scenes/000123/views/03/geometry.gz        depth, normals, albedo, ids

Arrays stand one after the other, little-endian. Radiance is half float, divided by a power of two where it would
overflow. Layers without an object come as their bits exclusive-or those of `all`: zero where nothing changed.
"""

import json
import zlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.source import DatasetSource
from multilight.datagen.storage.store import HALF_MAX, ViewData, scene_folder
from multilight.datagen.storage.variants import ALL, Variant
from multilight.datagen.text import plain
from multilight.datagen.tuples.pictures import depth_range
from multilight.lights.describe import describe
from multilight.lights.spec import Light
from multilight.scenes.appearance import material_class
from multilight.scenes.arrays import Float32
from multilight.scenes.spec import Body

GZIP = 16 + zlib.MAX_WBITS
PREVIEW = "preview.png"
MOST_PREVIEW = 1 << 24
"""Bytes of a scene's preview."""


@dataclass(frozen=True)
class ViewFiles:
    """The files of one view by name, yet to be squeezed."""

    about: dict[str, Any]
    arrays: Mapping[str, Mapping[str, NDArray[Any]]]

    def names(self) -> list[str]:
        """Name all files."""
        return ["view.json", *self.arrays]

    def file(self, name: str, level: int) -> bytes:
        """Return a file's content; arrays squeezed at a level of zlib, of which 0 only wraps. Raises `KeyError`."""
        if name == "view.json":
            return _json(self.about)
        squeeze = zlib.compressobj(level, wbits=GZIP)
        parts = [squeeze.compress(np.ascontiguousarray(array)) for array in self.arrays[name].values()]
        return b"".join([*parts, squeeze.flush()])


def dataset_json(source: DatasetSource, indices: Collection[int], address: str) -> bytes:
    """Say which scenes there are, of those with an index in `indices`; `address` is how commands name the dataset."""
    columns = ("index", "kind", "split", "views", "lights", "insertable")
    scenes = [
        {"index": index, "kind": kind, "split": split, "views": views, "lights": len(lights), "objects": len(objects)}
        for index, kind, split, views, lights, objects in source.table.select(columns).iter_rows()
        if index in indices
    ]
    return _json({"address": plain(address), "scenes": scenes})


def scene_json(record: SceneRecord) -> bytes:
    """Say what is in a scene and what shines; `start` are the lightings that the page begins with: the
    object under the faintest light alone, so that the composite is plainly wrong."""
    energy = record.views[0].energy[ALL]
    faint = min(record.conditions, key=lambda lit: (len(lit.gains), sum(energy[name].mean for name in lit.gains)))
    return _json(
        {
            "index": record.index,
            "kind": record.scene.kind,
            "split": record.split,
            "renderer": record.renderer,
            "lights": [_light(light) for light in record.rig.lights],
            "objects": list(record.scene.insertable),
            "bodies": [_body(body) for body in record.scene.bodies],
            "conditions": [condition.model_dump(mode="json") for condition in record.conditions],
            "views": len(record.views),
            "width": record.views[0].width,
            "height": record.views[0].height,
            "start": {"scene": record.conditions[0].name, "object": faint.name},
        }
    )


def view_files(record: SceneRecord, view: ViewData) -> ViewFiles:
    """Lay out a view's arrays, layers in the order of the rig."""
    order = [view.lights.index(name) for name in record.rig.names]
    stacks = {name: layers[order] for name, layers in view.variants.items()}
    scale = _scales(list(stacks.values()))
    halves = {name: (stack / scale[:, None, None, None]).astype("<f2") for name, stack in stacks.items()}
    arrays: dict[str, dict[str, NDArray[Any]]] = {"all.gz": {"all": halves[ALL]}}
    objects = []
    for name, coverage in view.coverage.items():
        top, bottom, left, right = _box(coverage)
        changed = halves[Variant.without(name)].view("<u2") ^ halves[ALL].view("<u2")
        arrays[f"object_{name}.gz"] = {
            "without": changed,
            "foreground": halves[Variant.foreground(name)][:, top:bottom, left:right],
            "coverage": coverage[top:bottom, left:right].astype("<f2"),
        }
        box = [left, top, right - left, bottom - top]
        objects.append({"name": name, "box": box, "coverage": round(float(coverage.mean()), 6)})
    geometry = view.geometry
    arrays["geometry.gz"] = {
        "depth": geometry.z_depth.astype("<f4"),
        "normal": geometry.normal_world.astype("<f2"),
        "albedo": geometry.albedo.astype("<f2"),
        "ids": geometry.instance_id.astype("<u2"),
    }
    height, width = geometry.z_depth.shape
    about = {
        "width": width,
        "height": height,
        "scale": scale.tolist(),
        "depth": depth_range(geometry.z_depth),
        "objects": objects,
        "bytes": {name: sum(array.nbytes for array in group.values()) for name, group in arrays.items()},
    }
    return ViewFiles(about, arrays)


def preview(source: DatasetSource, index: int) -> bytes:
    """Return a scene's preview (PNG); raises `StoreError`."""
    return source.place.read(f"{scene_folder(index)}/{PREVIEW}", MOST_PREVIEW)


def view_folder(number: int) -> str:
    """Return the name of a view's folder inside its scene's."""
    return f"views/{number:02d}"


def _scales(stacks: list[Float32]) -> Float32:
    """Return for each light the power of two that its layers (L, H, W, 3) are divided by to be half floats."""
    peaks = np.max([stack.max(axis=(1, 2, 3)) for stack in stacks], axis=0)
    return np.exp2(np.ceil(np.log2(np.maximum(peaks / HALF_MAX, 1.0)))).astype(np.float32)


def _box(coverage: Float32) -> tuple[int, int, int, int]:
    """Return top, bottom, left and right of what is covered, at least one pixel."""
    rows, columns = (np.flatnonzero(coverage.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return 0, 1, 0, 1
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def _light(light: Light) -> dict[str, Any]:
    peak = max(light.amount)
    return {
        "name": light.name,
        "kind": light.kind,
        "about": plain(describe(light)),
        "kelvin": light.colour_temperature,
        "colour": [channel / peak if peak else 1.0 for channel in light.amount],
    }


def _body(body: Body) -> dict[str, str]:
    materials = dict.fromkeys(material_class(material) for material in body.materials)
    return {"name": body.name, "category": plain(body.category), "material": ", ".join(materials)}


def _json(content: Any) -> bytes:
    return json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
