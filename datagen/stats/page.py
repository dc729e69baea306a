"""The statistics of a dataset as one self-contained HTML page, a JSON file and a table for the terminal."""

import base64
import json
from pathlib import Path

from rich.console import Console
from rich.table import Table

from multilight.datagen.errors import full_disk_told
from multilight.datagen.files.outputs import check_folder
from multilight.datagen.stats.collect import Summary, quantiles
from multilight.datagen.stats.plots import bar_plot, direction_plot
from multilight.datagen.stats.quantities import Quantity
from multilight.datagen.storage.store import write_text
from multilight.datagen.text import page, terminal

MOST_PAIRS = 100
"""Near-duplicates that the page lists; `stats.json` holds all."""
SECTIONS = ("scenes", "objects", "lights", "cameras", "pictures")
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222a33; background: #f4f6f8; margin: 0 auto; max-width: 1240px;
  padding: 24px }
h1 { font-size: 24px; margin: 0 0 4px } h2 { font-size: 18px; margin: 32px 0 10px } p { margin: 4px 0 }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(370px, 1fr)); gap: 14px; align-items: start }
.card { background: #fff; border-radius: 8px; padding: 12px 14px 10px; box-shadow: 0 1px 2px #0002 }
.card h3 { font-size: 14px; margin: 0 0 6px; font-weight: 600 } .card img { width: 100%; display: block }
.card p { font-size: 12.5px; color: #5a6672; margin: 6px 0 0 }
table { border-collapse: collapse; background: #fff; border-radius: 8px; font-size: 13.5px }
th, td { padding: 4px 12px; text-align: left; border-bottom: 1px solid #e6eaee } td.n { text-align: right }
.good { color: #23713a } .bad { color: #b3261e; font-weight: 600 }
"""


def write_page(summary: Summary, out: Path) -> None:
    """Write `index.html` and `stats.json` into a folder, which is made where it is missing."""
    check_folder(out)
    with full_disk_told(out):
        write_text(out / "stats.json", json.dumps(summary.as_json(), indent=1))
        write_text(out / "index.html", _page(summary))


def _page(summary: Summary) -> str:
    title = page(summary.title)
    body = [f"<h1>{title}</h1>", *_verdicts(summary)]
    for section in SECTIONS:
        cards = [_card(summary, q) for q in summary.quantities if q.section == section]
        if section == "lights":
            cards.insert(1, _direction_card(summary))
        if cards:
            body += [f"<h2>{section.capitalize()}</h2>", f'<div class="cards">{"".join(cards)}</div>']
    body += ["<h2>Coverage</h2>", _coverage_table(summary), *_pairs(summary)]
    head = f'<meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n{"".join(body)}\n</body></html>\n'


def _verdicts(summary: Summary) -> list[str]:
    """Say first what matters most: leaks and near-duplicates."""
    lines = []
    if summary.leaks:
        shown = ", ".join(f"{leak.what} ({' and '.join(leak.splits)})" for leak in summary.leaks[:20])
        lines.append(f'<p class="bad">{len(summary.leaks)} models or places cross splits: {page(shown)}</p>')
    else:
        lines.append('<p class="good">No model or environment place crosses splits.</p>')
    if summary.duplicates:
        lines.append(
            f'<p class="bad">{len(summary.duplicates)} pairs of scenes are near-duplicates (listed below).</p>'
        )
    else:
        lines.append('<p class="good">No two scenes are near-duplicates.</p>')
    return lines


def _card(summary: Summary, quantity: Quantity) -> str:
    coverage = summary.coverage[quantity.key]
    note = f"{len(summary.values[quantity.key])} values"
    if quantity.edges:
        q = quantiles(summary.values[quantity.key])
        low, middle, high = map(_number, q.values())
        note += f", median {middle}, nine in ten within {low} to {high} {quantity.unit}"
    note += f"<br>bins filled {100 * coverage.filled:.0f} %, evenness {coverage.evenness:.2f}"
    return _framed(quantity.title, bar_plot(quantity, coverage), note)


def _number(value: float) -> str:
    """Write a number with three digits, without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _direction_card(summary: Summary) -> str:
    svg, filled = direction_plot(summary.values["azimuth"], summary.values["elevation"])
    note = f"bins of equal solid angle; of those above the horizon {100 * filled:.0f} % filled"
    return _framed("where light comes from", svg, note)


def _framed(title: str, svg: str, note: str) -> str:
    """Put a plot on a card; as an image of its own, so that names inside the SVGs cannot clash."""
    data = base64.b64encode(svg.encode()).decode()
    picture = f'<img alt="{page(title)}" src="data:image/svg+xml;base64,{data}">'
    return f'<div class="card"><h3>{page(title)}</h3>{picture}<p>{note}</p></div>'


def _coverage_table(summary: Summary) -> str:
    rows = ["<tr><th>quantity</th><th>values</th><th>bins</th><th>filled</th><th>evenness</th></tr>"]
    for q in summary.quantities:
        c = summary.coverage[q.key]
        numbers = (len(summary.values[q.key]), len(c.counts), f"{100 * c.filled:.0f} %", f"{c.evenness:.2f}")
        cells = "".join(f'<td class="n">{number}</td>' for number in numbers)
        rows.append(f"<tr><td>{page(q.title)}</td>{cells}</tr>")
    return f"<table>{''.join(rows)}</table>"


def _pairs(summary: Summary) -> list[str]:
    if not summary.duplicates:
        return []
    rows = ["<tr><th>scene</th><th>scene</th><th>alike in</th><th>distance</th></tr>"]
    for pair in summary.duplicates[:MOST_PAIRS]:
        rows.append(f"<tr><td>{pair.first}</td><td>{pair.second}</td><td>{pair.by}</td><td>{pair.distance}</td></tr>")
    return ["<h2>Near-duplicates</h2>", f"<table>{''.join(rows)}</table>"]


def print_summary(summary: Summary) -> None:
    """Print a short table: each quantity with its spread and coverage; leaks and near-duplicates below."""
    table = Table(title=terminal(summary.title))
    table.add_column("quantity", no_wrap=True)
    for column in ("5 %", "median", "95 %", "filled", "even"):
        table.add_column(column, justify="right", no_wrap=True)
    for q in summary.quantities:
        coverage = summary.coverage[q.key]
        if q.edges:
            spread = [_number(number) for number in quantiles(summary.values[q.key]).values()]
        else:
            most = max(range(len(coverage.counts)), key=lambda i: coverage.counts[i])
            spread = ["", f"{coverage.labels[most]}", ""]
        name = f"{q.key} [{q.unit}]" if q.unit in ("m", "lx", "K", "deg", "mm", "stops") else q.key
        table.add_row(
            terminal(name), *map(terminal, spread), f"{100 * coverage.filled:.0f} %", f"{coverage.evenness:.2f}"
        )
    console = Console()
    console.print(table)
    console.print(f"{len(summary.leaks)} models or places cross splits; {len(summary.duplicates)} near-duplicate pairs")
