"""Configurations with what each key means, as TOML and JSON: what `config show` and `train --show` print."""

import json
import textwrap
from dataclasses import asdict, dataclass
from typing import Any

from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import PRESETS, Preset
from multilight.scenes.frozen import Frozen

WIDTH = 80
"""Characters of a line of comment."""


@dataclass(frozen=True)
class Row:
    """One key: its value, unit (empty: a number or a word), range and meaning."""

    key: str
    value: Any
    unit: str
    range: str
    meaning: str


def config_rows(config: Frozen) -> list[Row]:
    """List every key of a configuration, nested ones with dots, from the models' own fields."""
    schema = type(config).model_json_schema()
    return _rows(config, schema, schema.get("$defs", {}), "")


def _rows(model: Frozen, schema: dict[str, Any], shared: dict[str, Any], prefix: str) -> list[Row]:
    rows = []
    for key, entry in schema["properties"].items():
        value = getattr(model, key)
        if isinstance(value, Frozen):
            rows += _rows(value, shared[entry["$ref"].rpartition("/")[2]], shared, f"{prefix}{key}.")
            continue
        plain = model.model_dump(mode="json")[key]
        meaning = " ".join(entry.get("description", "").split())
        rows.append(Row(prefix + key, plain, _unit(entry), _range(entry, shared), meaning))
    return rows


def _unit(schema: dict[str, Any]) -> str:
    """Find the unit in a field's schema, or in that of its items."""
    if "unit" in schema:
        return str(schema["unit"])
    return next((unit for item in schema.get("prefixItems", []) if (unit := _unit(item))), "")


def _range(schema: dict[str, Any], shared: dict[str, Any]) -> str:
    """Say what a field's schema allows."""
    if "$ref" in schema:
        inner = shared[schema["$ref"].rpartition("/")[2]]["properties"]
        return "tables of " + ", ".join(f"{key} ({_range(entry, shared)})" for key, entry in inner.items())
    if "anyOf" in schema:
        return " | ".join(_range(choice, shared) for choice in schema["anyOf"])
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
        return f"list of {_range(schema['items'], shared)}"
    least = schema.get("minimum", schema.get("exclusiveMinimum"))
    if "exclusiveMaximum" in schema:
        return f"{least} to below {schema['exclusiveMaximum']}"
    if "maximum" in schema:
        return f"{least} to {schema['maximum']}"
    return f"from {least}" if "minimum" in schema else f"above {least}"


def as_toml(config: Frozen, title: str = "") -> str:
    """Write a configuration as TOML to save and edit: every key with its meaning, unit and range above it."""
    lines = _comment(title)
    table = ""
    for row in sorted(config_rows(config), key=lambda row: row.key.rpartition(".")[0]):
        above, _, key = row.key.rpartition(".")
        if above != table:
            table = above
            lines += ["", f"[{table}]"]
        about = ", ".join(filter(None, (row.unit, row.range)))
        text = f"{row.meaning} ({about})" if about else row.meaning
        lines += ["", *_comment(text)]
        lines.append(f"# {key} =" if row.value is None else f"{key} = {_toml(row.value)}")
    return "\n".join(lines)


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ")


def _toml(value: Any) -> str:
    match value:
        case dict():
            return "{" + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + "}"
        case list():
            return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def print_config(preset: Preset | None, *, as_json: bool) -> int:
    """Print a preset's configuration, or the defaults, and return the exit code."""
    config = load_config(None, {}, preset)
    if as_json:
        print(json.dumps({"preset": preset, "keys": [asdict(row) for row in config_rows(config)]}, indent=1))
    else:
        meaning = (
            f"preset {preset}: {PRESETS[preset].meaning}" if preset else f"defaults; presets: {', '.join(PRESETS)}"
        )
        print(as_toml(config, meaning))
    return 0
