"""How options are read from the command line and told in help: defaults once, choices in order, the nearest."""

import dataclasses
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import tyro
from tyro.constructors import (
    MISSING_NONPROP,
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructFieldSpec,
    StructTypeInfo,
)

from multilight.datagen.errors import UserError
from multilight.datagen.text import did_you_mean
from multilight.scenes.files.limits import shown

CONFIG = (tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff)
REGISTRY = ConstructorRegistry()
_ASKED: set[type] = set()
METAVARS = {
    **dict.fromkeys(("dir", "address", "dataset", "data", "source"), "DIR|ADDRESS"),
    **dict.fromkeys(("config", "file", "background", "depth_model", "weights_2d", "weights_3d", "lpips"), "FILE"),
    **dict.fromkeys(("composite", "mask", "depth", "pose", "gaussians", "weights"), "FILE"),
    **dict.fromkeys(("capture", "owl", "foscom", "assets", "parts"), "DIR"),
    "which": "PACK|DIR",
    "asset": "FILE|PACK/NAME",
    "where": "SQL",
    **dict.fromkeys(("columns", "object"), "NAME"),
    **dict.fromkeys(("condition", "insert_condition"), "NAME|FILE|random:SEED"),
    "device": "auto|cpu|cuda",
}
"""What help shows in an option's place, by the option's name; others show their type."""


def hint(default: str) -> str:
    """Name a default; nothing where it says that the option is not given."""
    return "" if default in ("None", "", "False") else f"(default: {default})"


class UsageError(UserError):
    """A command or option that does not exist; the message names the nearest."""


def parsed(words: Sequence[str], commands: Mapping[str, type]) -> Any:
    """Return the options of the command that the words name.

    Raises `UsageError` for a command or option that is none, with the nearest; `SystemExit` after help (0), and where a
    value is missing or wrong (2).
    """
    said, (name, *rest) = "multilight", words
    for _ in range(2):
        if name not in commands:
            near = did_you_mean(name, commands)
            raise UsageError(f"{said} has no command {shown(name)}; {near}there are {', '.join(commands)}")
        kind, said = commands[name], f"{said} {name}"
        commands = _formats(kind)
        if not commands or not rest or rest[0].startswith("-"):
            break
        name, *rest = rest
    options = ["--help", *_options(kind)]
    for word in rest:
        option = word.partition("=")[0].replace("_", "-")
        if option.startswith("--") and option not in options:
            raise UsageError(f"{said} has no option {shown(option)}; {did_you_mean(option, options)}see {said} --help")
    return tyro.cli(kind, args=rest, prog=said, config=CONFIG, registry=REGISTRY)


def _formats(kind: type) -> dict[str, type]:
    """Return the sub-commands of a command by name: those that its first field is one of."""
    kinds = filter(_is_group, get_args(next(iter(get_type_hints(kind).values()))))
    return {re.sub("(?<!^)(?=[A-Z])", "-", kind.__name__).lower(): kind for kind in kinds}


def _is_group(hint: Any) -> bool:
    return dataclasses.is_dataclass(hint)


def _options(kind: type) -> Iterator[str]:
    """List the options of a command, those of its groups as well."""
    for name, inner in get_type_hints(kind).items():
        if _is_group(inner):
            yield from _options(inner)
        else:
            yield f"--{name.lstrip('_').replace('_', '-')}"  # `_3d`: names begin with no digit


@REGISTRY.struct_rule
def _hinted(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Take tyro's own rule for dataclasses, and have help name each default once, and none that is nothing."""
    if not dataclasses.is_dataclass(info.type) or info.type in _ASKED:
        return None
    _ASKED.add(info.type)
    try:
        spec = ConstructorRegistry.get_struct_spec(info)
    finally:
        _ASKED.remove(info.type)
    if not isinstance(spec, StructConstructorSpec):
        return None
    return dataclasses.replace(spec, fields=tuple(map(_shown, spec.fields)))


def _shown(field: StructFieldSpec) -> StructFieldSpec:
    """Say what a field takes, by its name or its choices, and its default once."""
    kind, *more = get_args(field.type) if get_origin(field.type) is Annotated else (field.type,)
    inner = get_args(kind)[0] if get_origin(kind) is tuple else kind
    words = ",".join(_words(inner))
    metavar = METAVARS.get(field.name) or (f"{{{words}}}" if words else None)
    if inner is not kind:
        metavar = f"{metavar or inner.__name__.upper()} ..."
    elif metavar and tyro.conf.Positional in more and field.default is not MISSING_NONPROP:
        metavar = f"[{metavar}]"
    shown_as = tyro.conf.arg(metavar=metavar, help_behavior_hint=hint)
    text = field.helptext
    joined = " ".join(((text() if callable(text) else text) or "").split())  # docstrings of two lines keep their break
    annotated: Any = Annotated[(kind, shown_as, *more)]
    return dataclasses.replace(field, type=annotated, helptext=joined or None)


@REGISTRY.primitive_rule
def _choices(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Read one of some words, or a tuple of them, which help lists in order; a wrong one is told with the nearest."""
    many = get_origin(info.type) is tuple
    words = tuple(_words(get_args(info.type)[0] if many else info.type))
    if not words:
        return None

    def read(given: list[str]) -> str | tuple[str, ...]:
        for word in given:
            if word not in words:
                raise ValueError(f"{shown(word)}; {did_you_mean(word, words)}there are {', '.join(words)}")
        return tuple(given) if many else given[0]

    return PrimitiveConstructorSpec(
        nargs="*" if many else 1,
        metavar="{" + ",".join(words) + "}",
        instance_from_str=read,
        is_instance=lambda value: value is None or value in words or many,
        str_from_instance=lambda value: list(value) if many else [str(value)],
    )


def _words(hint: Any) -> Iterator[str]:
    """List the words of a `Literal`, or of a union of them and None; none of any other type."""
    if get_origin(hint) is Literal:
        yield from get_args(hint)
    elif all(inner is type(None) or get_origin(inner) is Literal for inner in get_args(hint)):
        for inner in get_args(hint):
            yield from _words(inner)
