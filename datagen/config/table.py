"""The configuration as a table: what `multilight config show` prints."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from multilight.datagen.config.dataset import DatasetConfig, load_config
from multilight.datagen.config.presets import PRESETS, Preset
from multilight.scenes.frozen import Frozen


@dataclass(frozen=True)
class Row:
    """One key: its value, unit (empty: a number or a word), range and meaning."""

    key: str
    value: Any
    unit: str
    range: str
    meaning: str


def config_rows(config: DatasetConfig) -> list[Row]:
    """List every key of a configuration, nested ones with dots, from the models' own fields."""
    schema = DatasetConfig.model_json_schema()
    return _rows(config, schema, schema["$defs"], "")


def _rows(model: Frozen, schema: dict[str, Any], shared: dict[str, Any], prefix: str) -> list[Row]:
    rows = []
    for key, entry in schema["properties"].items():
        value = getattr(model, key)
        if isinstance(value, Frozen):
            rows += _rows(value, shared[entry["$ref"].rpartition("/")[2]], shared, f"{prefix}{key}.")
            continue
        plain = list(value) if isinstance(value, tuple) else str(value) if isinstance(value, Path) else value
        meaning = " ".join(entry.get("description", "").split())
        rows.append(Row(prefix + key, plain, _unit(entry), _range(entry), meaning))
    return rows


def _unit(schema: dict[str, Any]) -> str:
    """Find the unit in a field's schema, or in that of its items."""
    if "unit" in schema:
        return str(schema["unit"])
    return next((unit for item in schema.get("prefixItems", []) if (unit := _unit(item))), "")


def _range(schema: dict[str, Any]) -> str:
    """Say what a field's schema allows."""
    if "anyOf" in schema:
        return " | ".join(_range(choice) for choice in schema["anyOf"])
    if "const" in schema:
        return str(schema["const"])
    if "enum" in schema:
        return " | ".join(str(word) for word in schema["enum"])
    if schema.get("type") == "null":
        return "none"
    if schema.get("type") == "string":
        return str(schema.get("format", "text"))
    if schema.get("type") == "boolean":
        return "true | false"
    if "prefixItems" in schema:
        low, high = schema["prefixItems"]
        least, most = low.get("minimum", high.get("minimum")), high.get("maximum", low.get("maximum"))
        return f"two of {least} to {most}, ascending"
    if schema.get("type") == "array":
        return f"list of {_range(schema['items'])}"
    least = schema.get("minimum", schema.get("exclusiveMinimum"))
    if "exclusiveMaximum" in schema:
        return f"{least} to below {schema['exclusiveMaximum']}"
    return f"{least} to {schema.get('maximum')}"


def print_config(preset: Preset | None, *, as_json: bool) -> int:
    """Print a preset's configuration, or the defaults, and return the exit code."""
    rows = config_rows(load_config(None, {}, preset))
    if as_json:
        print(json.dumps({"preset": preset, "keys": [asdict(row) for row in rows]}, indent=1))
        return 0
    title = f"preset {preset}: {PRESETS[preset].meaning}" if preset else "defaults; presets: " + ", ".join(PRESETS)
    defaults = {row.key: row.value for row in config_rows(DatasetConfig())}
    table = Table(title=title, caption="values in bold differ from the default")
    table.add_column("key", no_wrap=True)
    for column in ("value", "unit", "range", "meaning"):
        table.add_column(column, overflow="fold")
    for row in rows:
        value = Text(json.dumps(row.value), style="" if row.value == defaults[row.key] else "bold")
        table.add_row(row.key, value, row.unit, row.range, row.meaning)
    Console().print(table)
    return 0
