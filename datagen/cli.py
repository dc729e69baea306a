"""The generator's command line; the commands themselves stand in `datagen/commands/`."""

import contextlib
import os
import sys
from collections.abc import Mapping
from typing import Annotated, Any, Union

import tyro

from datagen.commands import export, import_scene, installed, look, make, pack, query
from datagen.errors import UserError
from datagen.text import plain

COMMANDS: dict[str, type] = {
    "dataset": make.Dataset,
    "scene": make.Scene,
    "verify": look.Verify,
    "mix": look.Mix,
    "sheet": look.Sheet,
    "stats": look.Stats,
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
    words = list(sys.argv[1:] if arguments is None else arguments)
    traceback = "--traceback" in words
    words = [word for word in words if word != "--traceback"]
    choices: Any = tuple(Annotated[kind, tyro.conf.subcommand(name)] for name, kind in commands.items())
    every: Any = Union[choices]  # noqa: UP007  (made at run time)
    command = tyro.cli(
        every,
        args=words,
        prog="multilight",
        description="Synthetic multi-light data for object compositing, relighting and shadow generation.",
        config=(tyro.conf.OmitArgPrefixes,),
    )
    try:
        code = int(command.run())
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("stopped; the same command goes on where it was", file=sys.stderr)
        return 130
    except RuntimeError as error:
        if traceback or not _is_for_users(error):
            raise
        print(f"error: {plain(str(error))}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        _drop_output()
        return 1
    except OSError as error:  # a folder that cannot be written, a full disk, a file that went away
        if traceback:
            raise
        if error.filename is None:
            _drop_output()
        told = str(error) if error.filename is None else f"{error.filename}: {error.strerror}"
        print(f"error: {plain(told)}; free some space, or choose another place", file=sys.stderr)
        return 1


def _drop_output() -> None:
    """Let nothing more be written to a standard output that takes nothing, at the end of the process either."""
    with contextlib.suppress(OSError):  # there may be none
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _is_for_users(error: RuntimeError) -> bool:
    from datagen.backends import BackendError
    from scenes.assets.info import AssetError

    return isinstance(error, (UserError, BackendError, AssetError))
