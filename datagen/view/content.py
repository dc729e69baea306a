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
from collections.abc import Collection, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.storage.halves import HALF_MAX
from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, scene_folder
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


class ViewFiles:
    """The files of one view; what is not asked for is not laid out. Layers come in the order of the rig."""

    def __init__(self, record: SceneRecord, view: ViewData) -> None:
        """Take a view as it was read."""
        self._view, self._order = view, [view.lights.index(name) for name in record.rig.names]
        self._scale = _scales(view.variants.values())[self._order]
        self._boxes = {name: _box(coverage) for name, coverage in view.coverage.items()}
        self._objects = {f"object_{name}.gz": name for name in view.coverage}

    def names(self) -> list[str]:
        """Name all files."""
        return ["view.json", "all.gz", *self._objects, "geometry.gz"]

    def file(self, name: str, level: int) -> bytes:
        """Return a file's content; arrays squeezed at a level of zlib, of which 0 only wraps. Raises `KeyError`."""
        if name == "view.json":
            return self._about()
        squeeze = zlib.compressobj(level, wbits=GZIP)
        parts = [squeeze.compress(array.tobytes()) for array in self._arrays(name)]
        return b"".join([*parts, squeeze.flush()])

    def _about(self) -> bytes:
        """Say sizes, where objects are, and the bytes of each file."""
        height, width = self._view.geometry.z_depth.shape
        texels, pixels = 3 * len(self._order), height * width
        sizes = {"all.gz": 2 * texels * pixels, "geometry.gz": 18 * pixels}
        objects = []
        for file, name in self._objects.items():
            top, bottom, left, right = self._boxes[name]
            covered = (bottom - top) * (right - left)
            sizes[file] = 2 * texels * (pixels + covered) + 2 * covered
            share = round(float(self._view.coverage[name].mean()), 6)
            objects.append({"name": name, "box": [left, top, right - left, bottom - top], "coverage": share})
        depth = depth_range(self._view.geometry.z_depth)
        about = {"width": width, "height": height, "scale": self._scale.tolist(), "depth": depth}
        return _json(about | {"objects": objects, "bytes": sizes})

    def _arrays(self, file: str) -> Iterator[NDArray[Any]]:
        if file == "all.gz":
            yield self._halves(ALL)
        elif file == "geometry.gz":
            geometry = self._view.geometry
            yield geometry.z_depth.astype("<f4")
            yield geometry.normal_world.astype("<f2")
            yield geometry.albedo.astype("<f2")
            yield geometry.instance_id.astype("<u2")
        else:
            name = self._objects[file]
            top, bottom, left, right = self._boxes[name]
            yield self._halves(Variant.without(name)).view("<u2") ^ self._halves(ALL).view("<u2")
            yield self._halves(Variant.foreground(name))[:, top:bottom, left:right]
            yield self._view.coverage[name][top:bottom, left:right].astype("<f2")

    def _halves(self, variant: Variant) -> NDArray[np.float16]:
        layers = self._view.variants[variant]
        return np.stack(
            [
                (layers[i] / scale if scale != 1 else layers[i]).astype("<f2")
                for i, scale in zip(self._order, self._scale, strict=True)
            ]
        )


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


def preview(source: DatasetSource, index: int) -> bytes:
    """Return a scene's preview (PNG); raises `StoreError`."""
    return source.place.read(f"{scene_folder(index)}/{PREVIEW}", MOST_PREVIEW)


def view_folder(number: int) -> str:
    """Return the name of a view's folder inside its scene's."""
    return f"views/{number:02d}"


def _scales(stacks: Iterable[Float32]) -> Float32:
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
