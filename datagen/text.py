"""Text that comes from data, made safe for where it is shown: terminal, Markdown."""

import difflib
import re
from collections.abc import Iterable, Sequence

from rich.markup import escape

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters, among them those that move a terminal's cursor, end a line or turn the direction of reading."""
_MARKUP = re.compile(r"[\\`*\[\]<>|&]")


def plain(text: str) -> str:
    """Return one line for a terminal or a file: control characters are written as escapes, \\n and \\x1b, say."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text)


def terminal(text: str) -> str:
    """Return one line for `rich`, which prints it as it is: neither control characters nor markup count."""
    return escape(plain(text))


def markdown(text: str) -> str:
    """Return the text as it stands in Markdown: one line, nothing in it marks anything up, tables included."""
    return _MARKUP.sub(r"\\\g<0>", plain(text))


def duration(seconds: float) -> str:
    """Say a time: `45 s`, `3 min 05 s`, `2 h 10 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    return (
        f"{whole // 60} min {whole % 60:02d} s" if whole < 3600 else f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    )


def size(count: int) -> str:
    """Say a number of bytes: `512 kB`, `1.3 GB`."""
    value, units = float(count), ["B", "kB", "MB", "GB", "TB"]
    while value >= 999.5 and len(units) > 1:
        value, units = value / 1000, units[1:]
    return f"{value:.3g} {units[0]}"


def ranges(numbers: Sequence[int], most: int = 10) -> str:
    """Name ascending whole numbers: `0, 3-7, 9`; of more than `most` ranges how many numbers more there are."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    told = ", ".join(f"{low}" if low == high else f"{low}-{high}" for low, high in runs[:most])
    more = sum(high - low + 1 for low, high in runs[most:])
    return told + (f" and {more} more" if more else "")


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Ask for the known word that looks most like a wrong one; empty where none does."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}? " if close else ""
