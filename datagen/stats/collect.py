"""Measure a dataset on disk, or scenes that are only sampled, and sum up."""

import itertools
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.errors import UserError
from multilight.datagen.production.scene import sample_scene
from multilight.datagen.report import Report
from multilight.datagen.stats.duplicates import Bits, Pair, alike_in_content, alike_in_picture, picture_hash
from multilight.datagen.stats.facts import SceneFacts, scene_facts
from multilight.datagen.stats.pictures import picture_values, read_preview
from multilight.datagen.stats.quantities import QUANTITIES, Coverage, Quantity, Value, coverage_of
from multilight.datagen.storage.open_dataset import open_dataset, spread
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.splits import SPLITS, Split
from multilight.scenes.random_streams import Streams

MOST_MEASURED = 2000
"""Scenes that are measured unless more are asked for: finding those that are alike takes the square of it."""


@dataclass(frozen=True)
class Leak:
    """A model or place that two splits share."""

    what: str
    splits: tuple[Split, Split]


@dataclass(frozen=True)
class Summary:
    """A dataset in numbers: coverage by quantity (those with values only), leaks and near-duplicates.

    `thrown_away` counts the draws that failed a check and were drawn anew, by check, in the whole dataset.
    """

    title: str
    scenes: int
    values: dict[str, list[Value]]
    coverage: dict[str, Coverage]
    leaks: tuple[Leak, ...]
    duplicates: tuple[Pair, ...]
    quantities: tuple[Quantity, ...] = field(default=())
    thrown_away: dict[str, int] = field(default_factory=dict)

    @property
    def failed(self) -> str:
        """Say which checks failed how often."""
        return ", ".join(f"{check} {count}" for check, count in self.thrown_away.items())

    def as_json(self) -> dict[str, Any]:
        """Return what `stats.json` holds: bins, counts and quantiles of each quantity, leaks, duplicates."""
        return {
            "title": self.title,
            "scenes": self.scenes,
            "thrown_away": self.thrown_away,
            "quantities": [
                {"key": q.key, "title": q.title, "unit": q.unit, "values": len(self.values[q.key])}
                | {"quantiles": quantiles(self.values[q.key]) if q.edges else None, "edges": q.edges}
                | asdict(self.coverage[q.key])
                for q in self.quantities
            ],
            "leaks": [asdict(leak) for leak in self.leaks],
            "duplicates": [asdict(pair) for pair in self.duplicates],
        }


def quantiles(values: list[Value]) -> dict[str, float]:
    """Return the 5th, 50th and 95th percentile of numbers."""
    low, median, high = np.percentile(np.array(values, np.float64), [5, 50, 95])
    return {"p5": round(float(low), 5), "p50": round(float(median), 5), "p95": round(float(high), 5)}


def measure_dataset(address: str | Path, library: AssetLibrary, report: Report, most: int = MOST_MEASURED) -> Summary:
    """Measure the finished scenes of a dataset, at most so many, spread evenly; raises `UserError` where none is."""
    source = open_dataset(address)
    where = source.address
    if not source.indices:
        raise UserError(f"{where} holds no finished scene; make some with: multilight dataset --out {where}")
    chosen = spread(source.indices, most)
    facts, hashes = [], []
    for number, index in enumerate(chosen):
        record = source.scene(index)
        found = scene_facts(record.scene, record.rig, record.split, library)
        facts.append(replace(found, values=found.values | picture_values(source, record)))
        hashes.append(picture_hash(read_preview(source, record)))
        report(number + 1, len(chosen))
    count = f"{len(facts)} of " * (len(facts) < len(source.indices)) + f"{len(source.indices)} scenes"
    return replace(
        summarize(f"{where.rpartition('/')[2]}: {count}", facts, hashes), thrown_away=source.record.thrown_away
    )


def measure_samples(config: DatasetConfig, count: int, library: AssetLibrary, report: Report) -> Summary:
    """Sample the first `count` scenes of a configuration, without rendering, and measure them."""
    facts = []
    for index in range(count):
        scene, rig = sample_scene(config, library, Streams(config.seed, index))
        facts.append(scene_facts(scene, rig, config.split_of(index), library))
        report(index + 1, count)
    return summarize(f"{count} sampled scenes, kind {config.kind}, seed {config.seed}", facts, [])


def summarize(title: str, facts: list[SceneFacts], hashes: list[Bits]) -> Summary:
    """Sum up measured scenes; `hashes` are those of their previews, or empty."""
    values = {q.key: [v for scene in facts for v in scene.values.get(q.key, ())] for q in QUANTITIES}
    quantities = tuple(q for q in QUANTITIES if values[q.key])
    indices = [scene.index for scene in facts]
    pairs = alike_in_content(indices, [scene.tokens for scene in facts])
    return Summary(
        title=title,
        scenes=len(facts),
        values=values,
        coverage={q.key: coverage_of(q, values[q.key]) for q in quantities},
        leaks=tuple(_leaks(facts)),
        duplicates=tuple(pairs + alike_in_picture(indices, hashes)),
        quantities=quantities,
    )


def _leaks(facts: list[SceneFacts]) -> Iterator[Leak]:
    """List the models and places that scenes of two splits both show."""
    by_split = {split: frozenset[str]().union(*(f.owned for f in facts if f.split == split)) for split in SPLITS}
    for first, second in itertools.combinations(SPLITS, 2):
        for what in sorted(by_split[first] & by_split[second]):
            yield Leak(what, (first, second))
