"""Configurations out of files and options: how they are read, joined and validated, and what is said of a wrong one."""

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from pydantic import ValidationError

from multilight.datagen.errors import UserError
from multilight.datagen.text import did_you_mean
from multilight.scenes.files.limits import read_toml, shown
from multilight.scenes.frozen import Frozen

Values = dict[str, Any]
"""Values by key; tables are nested."""
Config = TypeVar("Config", bound=Frozen)
NONE: Mapping[str, Any] = MappingProxyType({})


def read_values(path: Path) -> Values:
    """Read a TOML file; raises `UserError` naming it."""
    try:
        return read_toml(path)
    except FileNotFoundError:
        raise UserError(f"configuration file {path} does not exist") from None
    except ValueError as error:
        raise UserError(f"configuration file {path} cannot be read as TOML: {error}") from None
    except OSError as error:
        raise UserError(f"configuration file {path} cannot be read: {error.strerror}") from None


def joined(below: Mapping[str, Any], above: Mapping[str, Any]) -> Values:
    """Lay one table over another, table by table; neither is changed."""
    result = dict(below)
    for key, value in above.items():
        nested = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = joined(result[key], value) if nested else value
    return result


def validated(
    values: Values, kind: type[Config], source: Path | str | None, options: Mapping[str, Any] = NONE
) -> Config:
    """Lay options of the command line (by dotted key; None: not given) over values, and validate the whole.

    Raises `UserError` in one line: where it stands (`source`, or the command line), the key, the value and what is
    allowed, or the key that was probably meant.
    """
    given = {key: value for key, value in options.items() if value is not None}
    for key, value in given.items():
        for name in reversed(key.split(".")):
            value = {name: value}
        values = joined(values, value)
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        wrong = ".".join(map(str, error.errors()[0]["loc"]))
        optional = any(f"{wrong}.".startswith(f"{key}.") for key in given)
        raise UserError(f"{'command line' if optional or not source else source}: {_fault(error, kind)}") from None


def keys_of(kind: type[Frozen], prefix: str = "") -> Iterator[str]:
    """List every key of a configuration, nested ones with dots."""
    for name, field in kind.model_fields.items():
        table = _table(field.annotation)
        yield from keys_of(table, f"{prefix}{name}.") if table else [prefix + name]


def _table(annotation: Any) -> type[Frozen] | None:
    """Return the model that a key's table has, or each table of its list."""
    if isinstance(annotation, type) and issubclass(annotation, Frozen):
        return annotation
    return next(filter(None, map(_table, get_args(annotation))), None)


def _fault(error: ValidationError, kind: type[Frozen]) -> str:
    """Say what is wrong: an unknown key, else the first one, its value and what is allowed; and what was meant."""
    errors = sorted(error.errors(), key=lambda found: found["type"] != "extra_forbidden")
    first, key = errors[0], _key(errors[0])
    if first["type"] == "extra_forbidden":
        key = re.sub(r"\.\d+", "", key)  # without the places in lists
        return f"unknown key {key!r}; {_meant(key, list(keys_of(kind)))}"
    if first["type"] == "missing":
        return f"{key} is missing"
    said = first["msg"].removeprefix("Value error, ")
    if choices := [
        found["ctx"]["expected"] for found in errors if found["type"] == "literal_error" and _key(found) == key
    ]:
        words = re.findall("'(.*?)'", " ".join(choices))
        said = f"{did_you_mean(str(first['input']), words)}there are {' or '.join(choices)}"
    value = "" if isinstance(first["input"], dict) else f" = {shown(first['input'])}"
    return f"{key}{value}: {said}" if key else said


def _key(error: Any) -> str:
    """Return the key that is wrong; pydantic names the members of unions as well, with brackets in them."""
    return ".".join(part for part in map(str, error["loc"]) if "[" not in part)


def _meant(key: str, known: list[str]) -> str:
    """Ask for the known key or table that looks most like a wrong one, wherever it stands; else list those beside."""
    table, _, name = key.rpartition(".")
    every = [*known, *dict.fromkeys(filter(None, (other.rpartition(".")[0] for other in known)))]
    beside = {other.rpartition(".")[2]: other for other in every if other.rpartition(".")[0] == table}
    names = {other.rpartition(".")[2]: other for other in reversed(every)} | beside
    if close := get_close_matches(name, names, n=1):
        return f"did you mean {names[close[0]]!r}?"
    return f"known keys{' of ' + table if table else ''}: {', '.join(beside)}"
