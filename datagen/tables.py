"""Tables that commands print: ruled and folded to fit a terminal; plain, with whole names, elsewhere and where long."""

import re
import sys
from collections.abc import Sequence
from typing import Any

from multilight.datagen.text import plain

MOST_RULED = 500
"""Rows of the longest table that is ruled: laying cells out for a terminal takes two milliseconds a row."""
_LETTER = re.compile(r"[^\W\d_]")


def print_table(heads: Sequence[str], rows: Sequence[Sequence[Any]], *, title: str = "") -> None:
    """Print rows of cells under their heads, no heads where all are empty; what has no letters is set to the right."""
    cells = [[plain(_cell(cell)) for cell in row] for row in rows]
    numeric = [not any(_LETTER.search(line[n]) for line in cells) for n in range(len(heads))]
    if title:
        print(plain(title))
    if sys.stdout.isatty() and len(cells) <= MOST_RULED:
        _print_ruled(heads, cells, numeric)
        return
    lines = [list(heads), *cells] if any(heads) else cells
    widths = [max((len(line[n]) for line in lines), default=0) for n in range(len(heads))]
    form = "  ".join(f"{{:{'>' if right else '<'}{width}}}" for width, right in zip(widths, numeric, strict=True))
    sys.stdout.write("".join(f"{form.format(*line).rstrip()}\n" for line in lines))


def _print_ruled(heads: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[bool]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=any(heads))
    for head, right in zip(heads, numeric, strict=True):
        table.add_column(Text(head), justify="right" if right else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))  # not strings: brackets in them would count as markup
    Console().print(table)


def _cell(value: object) -> str:
    match value:
        case None:
            return ""
        case list() | tuple():
            return ", ".join(_cell(each) or "-" for each in value)
        case bool():
            return "yes" if value else "no"
    return str(value)
