"""Look scenes up in a dataset's index, and print them: the command `query`."""

import json
from collections.abc import Sequence

import polars as pl

from multilight.datagen.errors import UserError
from multilight.datagen.storage.index import COLUMNS
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.tables import print_table
from multilight.datagen.text import did_you_mean


def query(address: str, where: str | None, columns: Sequence[str]) -> pl.DataFrame:
    """Return the rows for which an SQL expression holds; raises `UserError` naming a column that is not there."""
    table = open_dataset(address, where=where).table
    if "all" in columns:
        return table
    if unknown := [name for name in columns if name not in table.columns]:
        near = did_you_mean(unknown[0], table.columns)
        raise UserError(
            f"--columns: no column {', '.join(unknown)}; {near}`multilight query DIR --describe` lists them"
        )
    return table.select(columns)


def print_rows(rows: pl.DataFrame, *, as_json: bool) -> int:
    """Print the rows and return the exit code: 1 where there is none."""
    if as_json:
        print(json.dumps(rows.to_dicts(), indent=1))
    else:
        print_table(rows.columns, rows.rows())
        print(f"{len(rows)} scene{'s' if len(rows) != 1 else ''}")
    return 0 if len(rows) else 1


def describe(*, as_json: bool) -> int:
    """Print each column's name, type and meaning."""
    rows = [(name, str(kind).replace("String", "text"), meaning) for name, (kind, meaning) in COLUMNS.items()]
    if as_json:
        print(json.dumps([dict(zip(("column", "type", "meaning"), row, strict=True)) for row in rows], indent=1))
    else:
        print_table(("column", "type", "meaning"), rows)
    return 0
