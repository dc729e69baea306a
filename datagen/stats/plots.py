"""The plots of the statistics page, as SVG text."""

import io
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator

from multilight.datagen.stats.quantities import Coverage, Quantity, Value
from multilight.datagen.text import plain

BAR, PALE, INK, EDGE = "#3b6ea5", "#e8edf3", "#333a42", "#c9d1da"
MOST_WORDS = 18
"""Bars of a quantity of words; the rest becomes one more bar."""
LONGEST_WORD = 40
"""Letters of a word that are shown."""
STYLE: Any = {
    "font.size": 8,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": EDGE,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "svg.hashsalt": "multilight",  # the same data give the same bytes
}


def bar_plot(quantity: Quantity, coverage: Coverage) -> str:
    """Plot the counts of a quantity's bins."""
    if quantity.edges is None:
        return _word_plot(coverage)
    with mpl.rc_context(STYLE):
        figure, axes = _figure(2.1)
        edges = np.array(quantity.edges)
        axes.bar(edges[:-1], coverage.counts, np.diff(edges), align="edge", color=BAR, edgecolor="white", linewidth=0.8)
        if quantity.log:
            axes.set_xscale("log")
            ticks = _round_numbers(float(edges[0]), float(edges[-1]))
            axes.set_xticks(ticks, [f"{tick:,g}" for tick in ticks])
            axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xlim(edges[0], edges[-1])
        axes.set_xlabel(quantity.unit)
        return _svg(figure, axes)


def _round_numbers(low: float, high: float) -> list[float]:
    """Return three to seven round numbers of a range, for a logarithmic axis."""
    for digits in ((1,), (1, 2, 5), (1, 2, 3, 4, 5, 6, 8)):
        ticks = [digit * 10.0**power for power in range(-3, 6) for digit in digits]
        inside = [float(f"{tick:.3g}") for tick in ticks if 0.999 * low <= tick <= 1.001 * high]
        if len(inside) >= 3:
            return inside if len(inside) <= 7 else inside[::2]
    return [low, high]


def _word_plot(coverage: Coverage) -> str:
    """Plot words as horizontal bars, the most frequent on top."""
    order = sorted(range(len(coverage.labels)), key=lambda i: -coverage.counts[i])
    labels = [plain(coverage.labels[i])[:LONGEST_WORD].replace("_", " ") for i in order[:MOST_WORDS]]
    counts = [coverage.counts[i] for i in order[:MOST_WORDS]]
    if len(order) > MOST_WORDS:
        labels.append(f"{len(order) - MOST_WORDS} more together")
        counts.append(sum(coverage.counts[i] for i in order[MOST_WORDS:]))
    with mpl.rc_context(STYLE):
        figure, axes = _figure(max(2.1, 0.5 + 0.15 * len(labels)))
        # What is summed up is pale, and may run off the plot.
        single = counts[:MOST_WORDS]
        colours = [BAR] * len(single) + [EDGE] * (len(counts) - len(single))
        axes.barh(np.arange(len(labels)), np.minimum(counts, 1.1 * max(single)), color=colours, height=0.75)
        axes.set_yticks(np.arange(len(labels)), labels, parse_math=False)
        axes.set_ylim(len(labels) - 0.4, -0.6)
        for place, count in enumerate(counts):
            axes.text(min(count, 1.1 * max(single)), place, f" {count}", va="center", fontsize=7)
        axes.set_xlim(0, 1.25 * max(single))
        return _svg(figure, axes, counted="x")


def direction_plot(azimuth: Sequence[Value], elevation: Sequence[Value]) -> tuple[str, float]:
    """Map where lights come from, all bins of equal solid angle; also return the filled fraction of the upper half."""
    columns, rows = np.linspace(-180, 180, 25), np.linspace(-1, 1, 17)
    height = np.sin(np.radians(np.array(elevation, np.float64)))
    counts = np.histogramdd(np.stack([height, np.array(azimuth, np.float64)], axis=1), (rows, columns))[0]
    filled = float((counts[rows[:-1] >= 0] > 0).mean())
    with mpl.rc_context(STYLE):
        figure, axes = _figure(2.6)
        shown = np.ma.masked_equal(counts, 0)
        colours = LinearSegmentedColormap.from_list("counts", ["#bcd0e6", BAR, "#12263f"])
        axes.set_facecolor(PALE)
        mesh = axes.pcolormesh(columns, rows, shown, cmap=colours, vmin=0)
        ticks = np.array([-60, -30, 0, 30, 60, 90])
        axes.set_yticks(np.sin(np.radians(ticks)), [f"{tick}°" for tick in ticks])
        axes.set_xticks([-180, -90, 0, 90, 180], ["behind", "-90°", "cameras", "90°", "behind"])
        axes.axhline(0.0, color="white", linewidth=1)
        figure.colorbar(mesh, ax=axes, pad=0.02).outline.set_visible(False)
        return _svg(figure, axes, counted=""), filled


def _figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(3.6, height), layout="constrained")
    return figure, figure.add_subplot()


def _svg(figure: Figure, axes: Axes, *, counted: str = "y") -> str:
    """Finish a plot; whole numbers along the axis that counts."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=2, width=0.6)
    if counted:
        getattr(axes, f"{counted}axis").set_major_locator(MaxNLocator(4, integer=True))
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()
