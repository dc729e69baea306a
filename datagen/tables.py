"""Tables that commands print: ruled and folded to fit a terminal, plain with whole names where something else reads."""

import sys
from collections.abc import Sequence
from typing import Any

from multilight.datagen.text import plain


def print_table(heads: Sequence[str], rows: Sequence[Sequence[Any]], *, title: str = "") -> None:
    """Print rows of cells under their heads, no heads where all are empty; what has no letters is set to the right."""
    cells = [[plain(_cell(cell)) for cell in row] for row in rows]
    numeric = [not any(letter.isalpha() for line in cells for letter in line[n]) for n in range(len(heads))]
    if title:
        print(plain(title))
    if sys.stdout.isatty():
        _print_ruled(heads, cells, numeric)
        return
    lines = [list(heads), *cells] if any(heads) else cells
    widths = [max((len(line[n]) for line in lines), default=0) for n in range(len(heads))]
    for line in lines:
        set_out = [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width, right in zip(line, widths, numeric, strict=True)
        ]
        print("  ".join(set_out).rstrip())


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
