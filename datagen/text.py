"""Text that comes from data, made safe for where it is shown: terminal, Markdown."""

import difflib
import re
from collections.abc import Iterable

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


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Ask for the known word that looks most like a wrong one; empty where none does."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {close[0]!r}? " if close else ""
