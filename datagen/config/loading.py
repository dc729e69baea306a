"""Configurations out of files and options: how they are read, joined and validated, and what is said of a wrong one."""

import difflib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, get_args

from pydantic import ValidationError

from multilight.datagen.errors import UserError
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
        inner = [t for t in (field.annotation, *get_args(field.annotation)) if isinstance(t, type)]
        tables = [t for t in inner if issubclass(t, Frozen)]
        yield from keys_of(tables[0], f"{prefix}{name}.") if tables else [prefix + name]


def _fault(error: ValidationError, kind: type[Frozen]) -> str:
    """Say what is wrong: the first key, its value and what is allowed, or the known keys and the most similar one."""
    first = error.errors()[0]
    key = ".".join(map(str, first["loc"])) or "configuration"
    if first["type"] == "extra_forbidden":
        key = ".".join(part for part in first["loc"] if isinstance(part, str))  # without the places in lists
        known = list(keys_of(kind))
        return f"unknown key {key!r}; {_hint(key, known)}known keys: {', '.join(known)}"
    if first["type"] == "missing":
        return f"{key} is missing"
    value = "" if isinstance(first["input"], dict) else f" = {shown(first['input'])}"
    return f"{key}{value}: {first['msg']}"


def _hint(key: str, known: list[str]) -> str:
    """Ask for the known key that looks most like a wrong one: as a whole, or without its table."""
    names = {key.rpartition(".")[2]: key for key in reversed(known)} | {key: key for key in known}
    close = difflib.get_close_matches(key, names, n=1) or difflib.get_close_matches(key.rpartition(".")[2], names, n=1)
    return f"did you mean {names[close[0]]!r}? " if close else ""
