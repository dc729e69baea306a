"""The index: one Parquet row a scene, for look-ups without opening the scenes."""

import io
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import polars as pl

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.object_variants import ALL
from multilight.datagen.storage.parquet import check_parquet
from multilight.datagen.storage.records import SceneRecord
from multilight.lights.photometry.angular_size import angular_diameter
from multilight.scenes.appearance import is_mirror, material_class
from multilight.scenes.cameras.pinhole import focal_length_mm
from multilight.scenes.frozen import Matrix4

Row = dict[str, Any]
"""A row of the index, by the names of the columns."""
_TEXTS, _NUMBERS = pl.List(pl.String), pl.List(pl.Float64)
COLUMNS: dict[str, tuple[pl.DataType, str]] = {
    "index": (pl.Int64(), "number of the scene"),
    "seed": (pl.Int64(), "seed of the dataset"),
    "kind": (pl.String(), "tabletop, room, studio, outdoor, custom or spheres"),
    "split": (pl.String(), "train, val, test or test_ood"),
    "renderer": (pl.String(), "mitsuba, cycles or analytic"),
    "denoised": (pl.Boolean(), "whether the layers were denoised"),
    "attempt": (pl.Int64(), "draws thrown away before this one"),
    "views": (pl.Int64(), "number of views"),
    "width": (pl.Int64(), "of a view, pixels"),
    "height": (pl.Int64(), "of a view, pixels"),
    "lens_mm": (_NUMBERS, "each view's focal length, full frame"),
    "depth_of_field": (pl.Boolean(), "whether any view is out of focus somewhere"),
    "objects": (pl.Int64(), "number of objects"),
    "insertable": (_TEXTS, "names of the objects that can be taken out"),
    "categories": (_TEXTS, "each object's: vase, mug"),
    "surroundings": (_TEXTS, "categories of all else, each once: sofa, window"),
    "materials": (_TEXTS, "looks of the objects, each once: mirror, metal, glass, coated, glossy, satin, matte"),
    "mirror": (pl.Boolean(), "whether something in the scene mirrors the objects"),
    "lights": (_TEXTS, "names of the lights, one a layer"),
    "light_kinds": (_TEXTS, "each light's: environment, sun, point, spot, area, emissive"),
    "light_shares": (_NUMBERS, "each light's share of the light in the pictures, of 1"),
    "light_sizes_deg": (_NUMBERS, "each light's diameter as the objects see it; null: environment, emissive"),
    "temperatures_k": (_NUMBERS, "each light's colour temperature; null: coloured otherwise"),
    "gels": (_TEXTS, "names of the colour gels, each once"),
    "emissive": (pl.Boolean(), "whether something glows"),
    "patterned": (pl.Boolean(), "whether a light throws a pattern (gobo), has a beam profile or shows a picture"),
    "contrast_ev": (pl.Float64(), "strongest light against all others in the pictures; null: a single light"),
    "hardest_deg": (pl.Float64(), "smallest diameter of a lamp or sun that gives a tenth of the light; small: hard"),
    "conditions": (_TEXTS, "names of the lighting conditions"),
    "licences": (_TEXTS, "of the assets, each once"),
    "bytes": (pl.Int64(), "of all views"),
    "scene_sha256": (pl.String(), "hash of what is there"),
    "rig_sha256": (pl.String(), "hash of what shines"),
    "record_sha256": (pl.String(), "hash of the whole record, which holds the hashes of the scene's files"),
    "thrown_away": (_TEXTS, "checks that earlier draws of the scene failed, each of which was drawn anew"),
    "assets": (_TEXTS, "ids of the assets, each once"),
    "pixels": (_NUMBERS, "how many pixels each insertable object covers, view after view; null: not stated"),
}
"""Each column's type and meaning."""
ADDED = ("thrown_away", "assets", "pixels")
"""Columns that an index of version 0.2.0 and before lacks; they are null there."""

LEAST_SHAPING = 0.1  # of the light in the pictures: a lamp that gives less shapes no shadows one would notice


def index_table(records: Iterable[SceneRecord]) -> pl.DataFrame:
    """Summarize scenes, a row each, ordered by index; columns as in `COLUMNS`."""
    return table_of(index_row(record) for record in records)


def table_of(rows: Iterable[Row]) -> pl.DataFrame:
    """Put rows that `index_row` made together, ordered by index."""
    return pl.DataFrame(list(rows), schema={name: kind for name, (kind, _) in COLUMNS.items()}).sort("index")


def index_bytes(table: pl.DataFrame) -> bytes:
    """Return a table as the content of an `index.parquet`; equal tables give equal bytes."""
    stream = io.BytesIO()
    table.rechunk().write_parquet(stream)
    return stream.getvalue()


def parse_index(content: bytes, name: str) -> pl.DataFrame:
    """Understand the content of an `index.parquet`: a row a scene, ordered by scene; `name` is for the error.

    Raises `StoreError` where it is damaged, lacks columns, has a scene twice, or holds more than is read.
    """
    try:
        check_parquet(content)
        table = pl.read_parquet(io.BytesIO(content))
    except (OSError, ValueError, pl.exceptions.PolarsError) as error:
        reason = (str(error).splitlines() or ["empty"])[0]
        raise StoreError(f"{name} cannot be read: {reason}") from None
    if not any(name in table.columns for name in ADDED):
        table = table.with_columns(pl.lit(None, COLUMNS[name][0]).alias(name) for name in ADDED)
    if wrong := [column for column, (kind, _) in COLUMNS.items() if table.schema.get(column) != kind]:
        raise StoreError(f"{name} has no column {wrong[0]!r}, or one of another type")
    numbers = table["index"]
    if numbers.has_nulls() or not (numbers >= 0).all():
        raise StoreError(f"{name} has rows of no scene")
    if doubled := numbers.filter(numbers.is_duplicated()).to_list():
        raise StoreError(f"{name} has {doubled.count(doubled[0])} rows of scene {doubled[0]}")
    return table.sort("index")


def index_row(record: SceneRecord) -> Row:
    """Summarize a scene: what is in it, what shines, how large it is."""
    bodies, cameras = record.scene.bodies, record.scene.cameras
    objects = [body for body in bodies if body.role == "object"]
    return {
        "index": record.index,
        "seed": record.seed,
        "kind": record.scene.kind,
        "split": record.split,
        "renderer": record.renderer,
        "denoised": record.denoised,
        "attempt": record.attempt,
        "conditions": [condition.name for condition in record.conditions],
        "licences": sorted({credit.licence for credit in record.assets}),
        "bytes": sum(view.bytes for view in record.views),
        "scene_sha256": record.scene_sha256,
        "rig_sha256": record.rig_sha256,
        "record_sha256": record.record_sha256,
        "thrown_away": [reason.partition(":")[0] for reason in record.thrown_away],
        "assets": [credit.id for credit in record.assets],
        "pixels": _pixels(record),
        "views": len(record.views),
        "width": record.views[0].width,
        "height": record.views[0].height,
        "lens_mm": [round(focal_length_mm(camera), 1) for camera in cameras],
        "depth_of_field": any(camera.aperture_radius > 0 for camera in cameras),
        "objects": len(objects),
        "insertable": list(record.scene.insertable),
        "categories": [body.category for body in objects],
        "surroundings": sorted({body.category for body in bodies if body.role != "object"}),
        "materials": sorted({material_class(material) for body in objects for material in body.materials}),
        "mirror": any(is_mirror(body) for body in bodies),
        **_lights(record, [body.world_from_body for body in objects]),
    }


def _pixels(record: SceneRecord) -> list[float] | None:
    names = record.scene.insertable
    return [view.pixels[name] for view in record.views for name in names] if record.views[0].pixels else None


def _lights(record: SceneRecord, places: Sequence[Matrix4]) -> dict[str, Any]:
    lights = record.rig.lights
    centre = np.mean([np.array(pose)[:3, 3] for pose in places], axis=0) if places else np.zeros(3)
    diameters = [angular_diameter(light, centre) for light in lights]
    sizes = [None if size is None else round(float(np.degrees(size)), 3) for size in diameters]
    fractions = light_fractions(record)
    strongest = max(fractions)
    shaping = [size for size, part in zip(sizes, fractions, strict=True) if size is not None and part >= LEAST_SHAPING]
    return {
        "lights": list(record.rig.names),
        "light_kinds": [light.kind for light in lights],
        "light_shares": [round(part, 4) for part in fractions],
        "light_sizes_deg": sizes,
        "temperatures_k": [light.colour_temperature for light in lights],
        "gels": sorted({light.gel for light in lights if light.gel}),
        "emissive": any(light.kind == "emissive" for light in lights),
        "patterned": any(light.is_shaped for light in lights),
        "contrast_ev": round(float(np.log2(strongest / (1.0 - strongest))), 2) if 0 < strongest < 1 else None,
        "hardest_deg": min(shaping, default=None),
    }


def light_fractions(record: SceneRecord) -> list[float]:
    """Return each light's fraction of the radiance in all views before denoising, in the rig's order; zeros if dark."""
    names = record.rig.names
    means = [np.mean([view.energy[ALL][name].mean for view in record.views]) for name in names]
    total = float(np.sum(means))
    return [float(mean) / total if total > 0 else 0.0 for mean in means]
