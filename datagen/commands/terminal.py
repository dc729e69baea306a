"""What the command line meets from outside: closed streams, broken pipes, signals that end it."""

import contextlib
import io
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator
from types import FrameType

from multilight.datagen.errors import UserError
from multilight.datagen.text import plain

PIPE_BROKEN = 128 + signal.SIGPIPE
"""Exit code where nobody reads any more: what a shell says of a tool that the broken pipe ended."""


LEAST_MEMORY = 2_000_000_000
"""Bytes of address space that any command needs; with less, native libraries abort instead of raising errors."""


class EndedError(BaseException):
    """A signal asked the process to end; `code` is the exit code that a shell gives for it."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.code = 128 + number


class _Output(io.TextIOWrapper):
    """Standard output without the warnings that OpenEXR's binding prints, word by word: they go to standard error."""

    warns = False
    before: io.TextIOWrapper

    def write(self, text: str, /) -> int:
        self.warns = self.warns or text.startswith("Warning: Exception raised")
        if not self.warns:
            return super().write(text)
        self.warns = not text.endswith("\n")
        return sys.stderr.write(text)


def set_warnings_aside() -> None:
    """Keep standard output to what the command itself says."""
    if isinstance(out := sys.stdout, io.TextIOWrapper):
        sys.stdout = _Output(out.buffer, out.encoding, out.errors, line_buffering=out.line_buffering)
        sys.stdout.before = out  # whose end would close the buffer


def prepare_streams() -> None:
    """Stand the null device in for standard streams that are closed: else the next file opened becomes one of them.

    Names of files that are no text are shown by their bytes.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # gets the lowest number that is free: this one
    sys.stdout = sys.stdout or open(1, "w", closefd=False)  # noqa: SIM115  (until the process ends)
    sys.stderr = sys.stderr or open(2, "w", closefd=False)  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def check_memory() -> None:
    """Raise `UserError` where the process may not have the memory that any command needs."""
    allowed, _ = resource.getrlimit(resource.RLIMIT_AS)
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_MEMORY:
        raise UserError(
            f"memory is limited to {allowed / 1e6:.0f} MB (ulimit -v), it takes {LEAST_MEMORY / 1e6:.0f} MB"
        )


_asked: list[int] = []
"""The signals that asked the command to end."""


def end_if_asked() -> None:
    """Raise `EndedError` again where a signal came while a library was being loaded that swallowed it."""
    if _asked and sys.exc_info()[1] is None and threading.current_thread() is threading.main_thread():
        raise EndedError(_asked[-1])


@contextlib.contextmanager
def signals_end_it() -> Iterator[None]:
    """Have TERM and HUP raise `EndedError`, so that what was begun is stopped and cleared away."""

    def end(number: int, frame: FrameType | None) -> None:
        _asked.append(number)
        raise EndedError(number)

    taken = []
    if threading.current_thread() is threading.main_thread():
        # What the caller ignores (nohup) stays ignored.
        taken = [n for n in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(n) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)
        _asked.clear()


def drop_unwritten() -> None:
    """Send what standard streams cannot take (nobody reads, a full disk) nowhere, so that the end is quiet."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def reason_of(error: OSError) -> str:
    """Say in a few words why a file could not be used, with its name where that is known."""
    name = error.filename
    if name is None or isinstance(name, int):
        return error.strerror or str(error)
    if os.path.islink(name) and not os.path.exists(name):
        return f"{name} is a link that leads nowhere (to {os.readlink(name)})"
    return f"{name}: {error.strerror}"


def one_line(text: str, most: int = 2000) -> str:
    """Return a message as one line that a terminal shows as it is; what is longer than `most` characters is cut."""
    joined = " ".join(text.split("\n"))
    return plain(joined if len(joined) <= most else f"{joined[: most - 1]}…")
