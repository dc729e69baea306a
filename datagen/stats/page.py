"""The statistics of a dataset as one self-contained HTML page, a JSON file and a table for the terminal."""

import json
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.errors import full_disk_told
from multilight.datagen.files.outputs import check_folder
from multilight.datagen.pages.render import data_uri, render_page
from multilight.datagen.stats.collect import Summary, quantiles
from multilight.datagen.stats.plots import bar_plot, direction_plot
from multilight.datagen.stats.quantities import Quantity
from multilight.datagen.storage.store import write_text
from multilight.datagen.tables import print_table

MOST_PAIRS = 100
"""Near-duplicates that the page lists; `stats.json` holds all."""
SECTIONS = ("scenes", "objects", "lights", "cameras", "pictures")


@dataclass(frozen=True)
class Card:
    """One plot of the page, as an image of its own, so that names inside the SVGs cannot clash."""

    title: str
    plot: str
    notes: tuple[str, ...]


def write_page(summary: Summary, out: Path) -> None:
    """Write `index.html` and `stats.json` into a folder, which is made where it is missing."""
    check_folder(out)
    with full_disk_told(out):
        write_text(out / "stats.json", json.dumps(summary.as_json(), indent=1))
        write_text(out / "index.html", _page(summary))


def _page(summary: Summary) -> str:
    sections = {s: [_card(summary, q) for q in summary.quantities if q.section == s] for s in SECTIONS}
    svg, filled = direction_plot(summary.values["azimuth"], summary.values["elevation"])
    note = f"bins of equal solid angle; of those above the horizon {100 * filled:.0f} % filled"
    sections["lights"].insert(1, Card("where light comes from", _address(svg), (note,)))
    values = {"title": summary.title, "summary": summary, "sections": sections, "most_pairs": MOST_PAIRS}
    return render_page(Path(__file__).with_name("page.html.jinja"), **values)


def _card(summary: Summary, quantity: Quantity) -> Card:
    coverage, values = summary.coverage[quantity.key], summary.values[quantity.key]
    counted = f"{len(values)} values"
    if quantity.edges:
        low, median, high = map(_number, quantiles(values).values())
        counted += f", median {median}, nine in ten within {low} to {high} {quantity.unit}"
    bins = f"bins filled {100 * coverage.filled:.0f} %, evenness {coverage.evenness:.2f}"
    return Card(quantity.title, _address(bar_plot(quantity, coverage)), (counted, bins))


def _address(svg: str) -> str:
    return data_uri(svg.encode(), "svg+xml")


def _number(value: float) -> str:
    """Write a number with three digits, without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def print_summary(summary: Summary) -> None:
    """Print a short table: each quantity with its spread and coverage; leaks and near-duplicates below."""
    rows = []
    for q in summary.quantities:
        coverage = summary.coverage[q.key]
        if q.edges:
            spread = [_number(number) for number in quantiles(summary.values[q.key]).values()]
        else:
            most = max(range(len(coverage.counts)), key=lambda i: coverage.counts[i])
            spread = ["", f"{coverage.labels[most]}", ""]
        name = f"{q.key} [{q.unit}]" if q.unit in ("m", "lx", "K", "deg", "mm", "stops") else q.key
        rows.append((name, *spread, f"{100 * coverage.filled:.0f} %", f"{coverage.evenness:.2f}"))
    print_table(("quantity", "5 %", "median", "95 %", "filled", "even"), rows, title=summary.title)
    if summary.thrown_away:
        print(f"{sum(summary.thrown_away.values())} draws failed a check and were drawn anew: {summary.failed}")
    print(f"{len(summary.leaks)} models or places cross splits; {len(summary.duplicates)} near-duplicate pairs")
