"""The index in blocks: `index.parquet` for scenes 0 to 9,999, `index/000001.parquet` for the next ten thousand, and on.

What is added changes its own block only. `dataset.json` states the hash of each; a block without rows has no file, but
for the first. An `index.parquet` of version 0.2.0 and before may hold scenes of further blocks.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import polars as pl

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.address import Place
from multilight.datagen.storage.index import index_table, parse_index
from multilight.datagen.storage.records import DatasetRecord

BLOCK = 10_000
"""Scenes of a block."""
MOST_INDEX = 1 << 29
"""Bytes of a file of the index; that of a million scenes in one has about half as many."""


@dataclass(frozen=True)
class Index:
    """An index as it was read: rows by block, as far as they can be understood, and by block what is wrong with it."""

    tables: dict[int, pl.DataFrame] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)

    def sound(self) -> dict[int, pl.DataFrame]:
        """Return the blocks that are as `dataset.json` states."""
        return {number: table for number, table in self.tables.items() if number not in self.faults}


def joined(tables: Iterable[pl.DataFrame]) -> pl.DataFrame:
    """Put tables together, ordered by scene."""
    whole = [table for table in tables if len(table)]
    if len(whole) < 2:
        return whole[0] if whole else index_table([])
    return pl.concat(whole, how="diagonal_relaxed").sort("index")


def block_file(number: int) -> str:
    """Return the name of a block's file."""
    return f"index/{number:06d}.parquet" if number else "index.parquet"


def stated_blocks(record: DatasetRecord) -> dict[int, str]:
    """Return the hash of each file that an index has by `dataset.json`."""
    more = {number: stated for number, stated in enumerate(record.index_more, 1) if stated}
    return {0: record.index_sha256} | more


def read_blocks(place: Place, record: DatasetRecord) -> Index:
    """Read the index of a dataset, each file held to `dataset.json`."""
    found = Index()
    for number, stated in stated_blocks(record).items():
        name = f"{place.address}/{block_file(number)}"
        try:
            content = place.read(block_file(number), MOST_INDEX)
            found.tables[number] = parse_index(content, name)
        except StoreError as error:
            found.faults[number] = str(error)
            continue
        if hashlib.sha256(content).hexdigest() != stated:
            found.faults[number] = f"{name} is not the one that dataset.json states"
    if doubled := sum(map(len, found.tables.values())) - joined(found.tables.values())["index"].n_unique():
        found.faults.update(dict.fromkeys(found.tables, f"{place.address}: the index has {doubled} scenes twice"))
    return found
