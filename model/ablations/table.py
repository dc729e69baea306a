"""What an ablation found, as Markdown and JSON: mean and half the range over seeds."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from multilight.datagen.errors import full_disk_told
from multilight.datagen.storage.store import write_text
from multilight.datagen.text import markdown as escaped
from multilight.model.ablations.run import AVERAGED, CARRIED, COMPOSITE, GLOW, STAGE_2D, Run
from multilight.model.evaluation.metrics import REGIONS
from multilight.model.evaluation.run import JUDGED_BY, Evaluation

NOTE = (
    "PSNR in dB, mean over frames, as mean ± half the range over seeds, by region. `validation`: object and effect "
    "under the scenes' stored lightings, in the split that trainings are watched on; all else under lightings that are "
    "drawn."
)
VIEWS_NOTE = (
    "`views disagree by`: mean difference of what two views show of one point, in grey levels of 255 (the truth: "
    "{truth:.2f})."
)


@dataclass(frozen=True)
class Row:
    """One variant; `figures` holds each column's values, one a seed."""

    name: str
    parameters: int | None
    steps: tuple[int, ...]
    seconds: tuple[float, ...]
    """Of a step, one a seed."""
    figures: Mapping[str, tuple[float, ...]]


def rows_of(runs: Sequence[Run], found: Evaluation) -> list[Row]:
    """Return a row each for what was not trained here (the composite, the 2D stage), and for each variant."""
    rows = []
    for method in (COMPOSITE, STAGE_2D, AVERAGED, CARRIED):
        if method in found.methods:
            key = {COMPOSITE: "composite", STAGE_2D: "2D"}.get(method, "")
            figures = _figures(found, [method]) | {"validation": (runs[0].validation.get(key, math.nan),)}
            rows.append(Row(method, None, (), (), figures))
    names = dict.fromkeys(run.variant for run in runs)
    for name in names:
        own = [run for run in runs if run.variant == name]
        judged = tuple(run.validation.get("3D", run.validation.get("network", math.nan)) for run in own)
        figures = _figures(found, [run.method for run in own]) | {"validation": judged}
        seconds = tuple(run.seconds / max(run.steps, 1) for run in own)
        rows.append(Row(name, own[0].parameters, tuple(run.steps for run in own), seconds, figures))
    return rows


def _figures(found: Evaluation, methods: Sequence[str]) -> dict[str, tuple[float, ...]]:
    def psnr(region: str, subset: str | None = None) -> tuple[float, ...]:
        return tuple(found.means(method, subset).get(region, {}).get("PSNR", math.nan) for method in methods)

    figures = {region: psnr(region) for region in REGIONS}
    figures |= {subset: psnr(JUDGED_BY, subset) for subset in GLOW if subset in found.subsets}
    if _of_views(found):
        figures["views disagree by"] = tuple(255.0 * found.inconsistency(method)[0] for method in methods)
    return figures


def _of_views(found: Evaluation) -> bool:
    """Say whether views are to be compared: between single pictures' networks a blurred one would win."""
    return STAGE_2D in found.methods and bool(found.consistency)


def markdown(title: str, rows: Sequence[Row], about: Mapping[str, str], notes: Sequence[str]) -> str:
    """Write the table as Markdown."""
    columns = list(rows[0].figures)
    lines = [f"# {title}", "", *(f"- {escaped(key)}: {escaped(value)}" for key, value in about.items())]
    for note in notes:
        lines += ["", note]
    lines += ["", "| variant | parameters | steps | s a step | " + " | ".join(columns) + " |"]
    lines.append("|---|" + "---:|" * (len(columns) + 3))
    for row in rows:
        steps = "–".join(map(str, sorted({min(row.steps), max(row.steps)}))) if row.steps else "–"
        parameters = "–" if row.parameters is None else f"{row.parameters:,}"
        cells = [row.name, parameters, steps, spread(row.seconds, 3), *(spread(row.figures[c], 2) for c in columns)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def spread(values: Sequence[float], digits: int) -> str:
    """Write values as mean ± half their range; a dash where there are none."""
    known = [value for value in values if not math.isnan(value)]
    if not known:
        return "–"
    mean = f"{sum(known) / len(known):.{digits}f}"
    return mean if len(known) == 1 else f"{mean} ± {(max(known) - min(known)) / 2:.{digits}f}"


def write_tables(title: str, runs: Sequence[Run], found: Evaluation, about: Mapping[str, str], out: Path) -> str:
    """Write `table.md` and `table.json` into a folder; returns the Markdown.

    The JSON holds every seed's figures, and every method's means of all metrics, by region.
    """
    rows = rows_of(runs, found)
    notes = [NOTE]
    if _of_views(found):
        notes.append(VIEWS_NOTE.format(truth=255.0 * found.inconsistency("target")[0]))
    text = markdown(title, rows, about, notes)
    record = {
        "title": title,
        "about": dict(about),
        "rows": [{**vars(row), "figures": {k: [_known(x) for x in v] for k, v in row.figures.items()}} for row in rows],
        "methods": {method: found.means(method) for method in found.methods},
    }
    with full_disk_told(out):
        write_text(out / "table.json", json.dumps(record, indent=1))
        write_text(out / "table.md", text)
    return text


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
