"""The generator's command line; the commands themselves stand in `datagen/commands/`."""

import dataclasses
import math
import sys
import textwrap
from collections.abc import Mapping
from importlib.metadata import version
from inspect import cleandoc
from typing import Any

from multilight.datagen.commands import (
    dataset,
    export,
    import_scene,
    inspect,
    installed,
    merge,
    pack,
    plan,
    query,
    status,
)
from multilight.datagen.commands.arguments import UsageError, parsed
from multilight.datagen.commands.terminal import (
    PIPE_BROKEN,
    EndedError,
    check_memory,
    drop_unwritten,
    one_line,
    prepare_streams,
    reason_of,
    set_warnings_aside,
    signals_end_it,
)
from multilight.datagen.errors import UserError
from multilight.scenes.errors import MultilightError
from multilight.scenes.files.limits import shown

ABOUT = "Synthetic multi-light data for object compositing, harmonization, relighting and shadow generation."
LONGEST_WORD = 4096
"""Characters of the longest argument that is taken; paths have no more."""
LARGEST_NUMBER = 2**53
"""The largest whole number that every library takes, as a float as well."""
STOPPED, GOES_ON = "stopped", "; the same command goes on where it was"
CONTINUED = ("dataset", "scene", "import", "merge", "pack", "export", "train", "ablate")
"""Commands that go on where they were stopped."""
GROUPS = {
    "make": ("dataset", "scene", "import", "plan", "merge"),
    "look": ("status", "view", "verify", "mix", "sheet", "stats", "query"),
    "share": ("export", "pack"),
    "learn": ("train", "evaluate", "ablate", "study"),
    "use on your own pictures": ("harmonize", "insert"),
    "set up": ("assets", "config", "doctor"),
}
"""The commands as help lists them."""
EXTRAS = {
    "train": "train",
    "evaluate": "train",
    "ablate": "train",
    "harmonize": "train",
    "insert": "captures",
    "ray": "ray",
}
"""What to install for a command, or for a module, that needs more than what is there, if it is not `render`."""
OPTIONS = (
    "multilight COMMAND --help explains a command and its options.",
    "",
    "  --version    print the version",
    "  --traceback  with any command: show where an error came from",
)
WIDTH, INDENT = 80, 13

COMMANDS: dict[str, type] = {
    "dataset": dataset.Dataset,
    "scene": dataset.Scene,
    "plan": plan.Plan,
    "merge": merge.Merge,
    "status": status.Status,
    "verify": inspect.Verify,
    "view": inspect.View,
    "mix": inspect.Mix,
    "sheet": inspect.Sheet,
    "stats": inspect.Stats,
    "query": query.Query,
    "export": export.Export,
    "import": import_scene.Import,
    "pack": pack.Pack,
    "assets": installed.Assets,
    "config": installed.Config,
    "doctor": installed.Doctor,
}
"""Each command's name and its options, as a dataclass whose `run` returns the exit code."""


def main(arguments: list[str] | None = None, commands: Mapping[str, type] = COMMANDS) -> int:
    """Run one command and return the exit code: 0 only on success; errors take one line on standard error.

    `--traceback` anywhere shows where an error came from.
    """
    prepare_streams()
    if arguments is None:  # the process is the command's own
        set_warnings_aside()
    words = list(sys.argv[1:] if arguments is None else arguments)
    traceback = "--traceback" in words
    words = [word for word in words if word != "--traceback"]
    for word in words:
        if len(word) > LONGEST_WORD:
            print(f"error: {one_line(shown(word))} has {len(word)} characters; shorten it", file=sys.stderr)
            return 2
        if not word.isascii() and word.encode(errors="replace").decode() != word:  # native libraries cannot open it
            print(f"error: {one_line(word)} is no text in UTF-8; rename it", file=sys.stderr)
            return 2
    name = words[0] if words else ""
    stopped = STOPPED + GOES_ON if name in CONTINUED else STOPPED
    try:
        return _run(words, commands)
    except UsageError as error:
        print(f"error: {one_line(str(error))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(stopped, file=sys.stderr)
        return 130
    except EndedError as ended:
        print(stopped, file=sys.stderr)
        return ended.code
    except BrokenPipeError:
        drop_unwritten()
        return PIPE_BROKEN
    except (MultilightError, OSError, MemoryError, ModuleNotFoundError) as error:
        if traceback or (isinstance(error, ModuleNotFoundError) and str(error.name).startswith("multilight")):
            raise
        drop_unwritten()
        print(f"error: {one_line(_told(error, name))}", file=sys.stderr)
        return 1


def _run(words: list[str], commands: Mapping[str, type]) -> int:
    """Run the command that the words name, or print help or the version, and return the exit code."""
    if not words or words[0] in ("-h", "--help", "--version"):
        print(f"multilight {version('multilight')}" if words == ["--version"] else overview(commands))
        sys.stdout.flush()
        return 0 if words else 2
    try:
        command = parsed(words, commands)
    except SystemExit as ended:  # tyro's, after help, and where a value is missing or wrong
        sys.stdout.flush()
        return int(ended.code or 0)
    check_memory()
    _check_numbers(command)
    with signals_end_it():
        try:
            code = int(command.run())
        except SystemExit as error:
            raise BrokenPipeError from error  # rich makes the one of the other
        finally:
            _tell_of_cache()
        sys.stdout.flush()
        return code


def overview(commands: Mapping[str, type]) -> str:
    """Return what `multilight --help` says: the commands in groups, each in a sentence."""
    lines = ["usage: multilight COMMAND ...", "", *textwrap.wrap(ABOUT, WIDTH)]
    for title, names in GROUPS.items():
        there = [name for name in names if name in commands]
        lines += ["", title] if there else []
        for name in there:
            sentence = cleandoc(commands[name].__doc__ or "").partition("\n\n")[0]
            about = f"  {name:<{INDENT - 3}} {sentence}"
            lines += textwrap.wrap(about, WIDTH, subsequent_indent=" " * INDENT)
    return "\n".join([*lines, "", *OPTIONS])


def _check_numbers(command: Any) -> None:
    """Raise `UserError` where an option is no finite number, or larger than any count or seed may be."""
    for field in dataclasses.fields(command):
        value = getattr(command, field.name)
        name = f"--{field.name.replace('_', '-')}"
        if dataclasses.is_dataclass(value):
            _check_numbers(value)
        elif value == () != field.default:
            raise UserError(f"{name}: name one or more")
        elif isinstance(value, float) and not math.isfinite(value):
            raise UserError(f"{name} {value} must be a finite number")
        elif isinstance(value, int) and abs(value) > LARGEST_NUMBER:
            raise UserError(f"{name} has {len(str(abs(value)))} digits; {LARGEST_NUMBER} is the largest number taken")


def _tell_of_cache() -> None:
    """Say what was damaged in the asset cache."""
    if cache := sys.modules.get("multilight.scenes.assets.cache"):  # slow to import, and few commands need it
        cache.tell_thrown_away()


def _told(error: Exception, command: str) -> str:
    """Say what a user can act on."""
    match error:
        case MemoryError():
            return (
                f"not enough memory ({error or 'none left'}); free some, or ask for fewer workers or smaller pictures"
            )
        case OSError():
            return f"{reason_of(error)}; free some space, or choose another place"
        case ModuleNotFoundError():
            extra = EXTRAS.get(error.name or "", EXTRAS.get(command, "render"))
            return f"multilight {command} needs {error.name}: pip install 'multilight[{extra}]'"
    return str(error)
