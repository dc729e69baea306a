"""WebDataset shards: a sample a (scene, view, object, pair of lightings), with a dataset card beside them."""

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.errors import UserError
from multilight.datagen.export.images import depth_mm, png, to_byte
from multilight.datagen.export.tars import TarShards
from multilight.datagen.export.webdataset.card import Shards, write_card
from multilight.datagen.report import Report
from multilight.datagen.storage.copies import making
from multilight.datagen.storage.open_dataset import DatasetSource
from multilight.datagen.storage.records import AssetCredit, SceneRecord
from multilight.datagen.storage.store import ViewData
from multilight.datagen.tuples import compose
from multilight.lights.display.tonemap import to_display
from multilight.lights.relight import gain_matrix
from multilight.lights.spec import LightingCondition
from multilight.scenes.random_streams import Streams

LEAST_PIXELS = 16
"""Pixels that an object must cover more than half of, or the view makes no sample of it."""

Sample = tuple[str, dict[str, bytes]]


@dataclass(frozen=True)
class ShardOptions:
    """How many pairs of lightings a view and object, how large a shard may be, how many threads encode."""

    pairs: int
    most_bytes: int
    threads: int


def export_webdataset(source: DatasetSource, out: Path, options: ShardOptions, report: Report) -> Shards | None:
    """Write `<split>-00000.tar`, ... and README.md into a new folder; None where they are there, undamaged.

    Raises `UserError` where `out` holds something else.
    """
    with making(out, "webdataset", source, {"pairs": options.pairs, "shard_mb": options.most_bytes // 10**6}) as copy:
        if copy.holds(source.indices):
            return None
        with copy.filling() as (folder, scenes):
            shards, credits = _fill(source, folder, scenes, options, report)
            write_card(folder, shards, source.record, list(credits.values()), title=out.name)
    return shards


def _fill(
    source: DatasetSource, folder: Path, scenes: list[int], options: ShardOptions, report: Report
) -> tuple[Shards, dict[str, AssetCredit]]:
    """Write all shards and note the scenes that went in; returns whom to credit as well."""
    credits: dict[str, AssetCredit] = {}
    with ThreadPoolExecutor(options.threads) as pool, TarShards(folder, options.most_bytes) as tars:
        for done, record in enumerate(source.scenes()):
            with source.passing_over(record.index):
                samples = [sample for view in _views(source, record, options, pool) for sample in view]
                for key, members in samples:
                    tars.add(record.split, {f"{key}.{name}": content for name, content in members.items()})
                credits |= {credit.id: credit for credit in record.assets}
                scenes.append(record.index)
            report(done + 1, len(source.indices))
    shards = Shards(tars.shards)
    if not shards.samples:
        raise UserError(f"{source.address}: no view shows an insertable object; nothing to export")
    return shards, credits


def draw_pairs(record: SceneRecord, view: int, name: str, count: int) -> list[tuple[int, int]]:
    """Draw pairs of different lightings (inserted, base) without repetition; one lighting alone pairs with itself."""
    numbers = range(len(record.conditions))
    every = list(permutations(numbers, 2)) or [(0, 0)]
    rng = Streams(record.seed, record.index, record.attempt)(f"export/webdataset/{view}/{name}")
    return [every[int(i)] for i in rng.permutation(len(every))[:count]]


def _views(
    source: DatasetSource, record: SceneRecord, options: ShardOptions, pool: ThreadPoolExecutor
) -> Iterator[list[Sample]]:
    def samples(number: int) -> list[Sample]:
        view = source.view(record, number)
        return [
            _sample(record, number, view, name, pair)
            for name in record.scene.insertable
            if np.count_nonzero(view.coverage[name] > 0.5) >= LEAST_PIXELS
            for pair in enumerate(draw_pairs(record, number, name, options.pairs))
        ]

    return pool.map(samples, range(len(record.views)))


def _sample(record: SceneRecord, number: int, view: ViewData, name: str, pair: tuple[int, tuple[int, int]]) -> Sample:
    place, (first, second) = pair
    insert, base = record.conditions[first], record.conditions[second]
    members = {
        "background.png": png(to_display(compose.background(view, name, base))),
        "composite.png": png(to_display(compose.composite(view, name, insert=insert, base=base))),
        "depth.png": png(depth_mm(view.geometry.z_depth)),
        "mask.png": png(to_byte(view.coverage[name])),
        "meta.json": json.dumps(_meta(record, number, view, name, insert, base)).encode(),
        "target.png": png(to_display(compose.target(view, base))),
    }
    return f"{record.index:06d}-{number:02d}-{name}-{place:02d}", members


def _meta(
    record: SceneRecord, number: int, view: ViewData, name: str, insert: LightingCondition, base: LightingCondition
) -> dict[str, Any]:
    """Say where a sample comes from; the same keys and types in every sample, so that tables can be made of them."""
    stated = record.views[number]
    rows, columns = np.nonzero(to_byte(view.coverage[name]))
    return {
        "scene": record.index,
        "view": number,
        "object": name,
        "category": record.scene.body(name).category,
        "kind": record.scene.kind,
        "split": record.split,
        "insert_condition": insert.name,
        "base_condition": base.name,
        "lights": list(record.rig.names),
        "insert_gains": _gains(record.rig.names, insert),
        "base_gains": _gains(record.rig.names, base),
        "box": [int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1],
        "K": [[float(x) for x in row] for row in stated.K],
        "c2w": [[float(x) for x in row] for row in stated.c2w],
    }


def _gains(lights: Sequence[str], condition: LightingCondition) -> list[list[float]]:
    return [[round(float(gain), 6) for gain in row] for row in gain_matrix(lights, condition)]
