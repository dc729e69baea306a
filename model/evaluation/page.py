"""The evaluation as Markdown, JSON, and one self-contained HTML page with pictures."""

import base64
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import flip_evaluator
import numpy as np
from PIL import Image

from multilight.datagen.errors import full_disk_told
from multilight.datagen.files.outputs import check_folder
from multilight.datagen.storage.store import write_text
from multilight.datagen.text import markdown as escaped
from multilight.datagen.text import page
from multilight.model.evaluation.metrics import HIGHER_IS_BETTER, METRICS, REGIONS, Scores
from multilight.model.evaluation.run import JUDGED_BY, Evaluation, Shown
from multilight.model.inference.pictures import to_bytes
from multilight.scenes.arrays import Float32

DIGITS = {"PSNR": 2, "SSIM": 4, "FLIP": 4, "LPIPS": 4}
UNITS = {
    "PSNR": "dB, higher is better",
    "SSIM": "higher is better",
    "FLIP": "lower is better",
    "LPIPS": "lower is better",
}
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #222a33; background: #f4f6f8; margin: 0 auto; max-width: 1320px;
  padding: 24px }
h1 { font-size: 24px; margin: 0 0 4px } h2 { font-size: 18px; margin: 34px 0 8px } p { margin: 4px 0; max-width: 80ch }
.about { color: #5a6672; font-size: 13.5px; max-width: none }
.tables { display: flex; flex-wrap: wrap; gap: 16px }
table { border-collapse: collapse; background: #fff; border-radius: 8px; font-size: 13.5px;
  box-shadow: 0 1px 2px #0002 }
caption { text-align: left; font-weight: 600; padding: 2px 2px 6px } caption span { color: #5a6672; font-weight: 400 }
th, td { padding: 5px 12px; text-align: right; border-bottom: 1px solid #e6eaee; white-space: nowrap }
th { font-weight: 600; color: #45505c } th:first-child, td:first-child { text-align: left }
tr:last-child td { border-bottom: 0 } td.best { font-weight: 700; color: #14632f }
.case { background: #fff; border-radius: 8px; padding: 10px 12px 12px; margin: 0 0 14px; box-shadow: 0 1px 2px #0002 }
.case h3 { font-size: 13.5px; font-weight: 600; margin: 0 0 8px } .case h3 span { color: #5a6672; font-weight: 400 }
.row { display: grid; grid-auto-flow: column; grid-auto-columns: minmax(0, 1fr); gap: 8px }
.worst .row { max-width: 860px }
figure { margin: 0 } img { width: 100%; display: block; border-radius: 3px }
figcaption { font-size: 12px; color: #45505c; margin-top: 4px; line-height: 1.3 }
"""


@dataclass(frozen=True)
class Table:
    """Numbers to show: rows are methods; `best` of each column is set off. NaN shows as a dash."""

    title: str
    note: str
    columns: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]
    digits: tuple[int, ...]
    higher: tuple[bool | None, ...]

    def cells(self, method: str) -> list[tuple[str, bool]]:
        """Return a row's numbers as text, and whether each is the best of its column (to the digits shown)."""
        found = []
        for column, (value, digits, higher) in enumerate(zip(self.rows[method], self.digits, self.higher, strict=True)):
            others = [round(row[column], digits) for row in self.rows.values() if not math.isnan(row[column])]
            extreme = None if higher is None or len(set(others)) < 2 else (max if higher else min)(others)
            text = "–" if math.isnan(value) else f"{value:.{digits}f}"
            found.append((text, extreme is not None and round(value, digits) == extreme))
        return found


def write_evaluation(found: Evaluation, about: Mapping[str, str], out: Path) -> None:
    """Write `index.html`, `table.md` and `evaluation.json` into a folder; `about` says what was evaluated on what."""
    check_folder(out)
    tables = tables_of(found)
    with full_disk_told(out):
        write_text(out / "evaluation.json", json.dumps(as_json(found, about), indent=1))
        write_text(out / "table.md", markdown(tables, about))
        write_text(out / "index.html", _page(found, tables, about))


def tables_of(found: Evaluation) -> list[Table]:
    """Lay out every table: a metric each by region, cost and consistency, and PSNR by subset."""
    means = {method: found.means(method) for method in found.methods}
    tables = []
    if any(means.values()):
        metrics = [metric for metric in METRICS if metric in next(iter(means[found.methods[0]].values()))]
        tables += [_metric_table(metric, means) for metric in metrics]
    tables.append(_cost_table(found))
    if any(means.values()):
        tables += [_subset_table(found, region) for region in (JUDGED_BY, "image")]
    return tables


def _metric_table(metric: str, means: Mapping[str, Scores]) -> Table:
    regions = tuple(region for region in REGIONS if any(region in scores for scores in means.values()))
    rows = {
        method: tuple(scores.get(region, {}).get(metric, math.nan) for region in regions)
        for method, scores in means.items()
    }
    higher: tuple[bool | None, ...] = (HIGHER_IS_BETTER[metric],) * len(regions)
    return Table(metric, UNITS[metric], regions, rows, (DIGITS[metric],) * len(regions), higher)


def _cost_table(found: Evaluation) -> Table:
    rows = {}
    for method in found.methods:
        own, ratio = found.inconsistency(method)
        rows[method] = (255.0 * own, ratio, found.seconds(method), found.megabytes[method])
    columns = ("views disagree by", "over the truth's", "s a frame", "MB")
    note = "disagreement of views in grey levels of 255, in the object-and-effect region; median time, peak memory"
    return Table("Consistency and cost", note, columns, rows, (2, 2, 3, 0), (None, False, None, None))


def _subset_table(found: Evaluation, region: str) -> Table:
    subsets = found.subsets
    rows = {}
    for method in found.methods:
        scores = [found.means(method, subset) for subset in subsets]
        rows[method] = tuple(each.get(region, {}).get("PSNR", math.nan) for each in scores)
    columns = tuple(f"{subset} ({len(found.frames_of(subset))})" for subset in subsets)
    size = len(subsets)
    return Table(f"PSNR by subset: {region}", "dB; number of frames", columns, rows, (2,) * size, (True,) * size)


def markdown(tables: list[Table], about: Mapping[str, str]) -> str:
    """Write the tables as Markdown."""
    lines = ["# Evaluation", "", *(f"- {escaped(key)}: {escaped(value)}" for key, value in about.items())]
    for table in tables:
        columns = " | ".join(map(escaped, table.columns))
        lines += ["", f"## {escaped(table.title)}", "", table.note, "", f"| method | {columns} |"]
        lines.append("|---|" + "---:|" * len(table.columns))
        for method in table.rows:
            cells = [f"**{text}**" if best else text for text, best in table.cells(method)]
            lines.append(f"| {escaped(method)} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def as_json(found: Evaluation, about: Mapping[str, str]) -> dict[str, object]:
    """Return everything that was measured: means by subset, cost, consistency, and every frame."""
    methods = found.methods
    return {
        "about": dict(about),
        "methods": {
            method: {
                "all": found.means(method),
                "subsets": {subset: found.means(method, subset) for subset in found.subsets},
                "seconds": found.seconds(method),
                "megabytes": found.megabytes[method],
                "disagreement": _numbers(found.inconsistency(method)),
            }
            for method in methods
        },
        "frames": [
            {"name": f.name, "subsets": list(f.subsets), "scores": dict(f.scores), "seconds": dict(f.seconds)}
            for f in found.frames
        ],
    }


def _numbers(pair: tuple[float, float]) -> dict[str, float] | None:
    return None if math.isnan(pair[0]) else {"mean": pair[0], "over_truth": pair[1]}


def _page(found: Evaluation, tables: list[Table], about: Mapping[str, str]) -> str:
    facts = " · ".join(f"{page(key)}: {page(value)}" for key, value in about.items())
    body = [f'<h1>Evaluation</h1><p class="about">{facts}</p>']
    body += ["<h2>How close to the truth</h2>", f'<div class="tables">{"".join(map(_html_table, tables))}</div>']
    if found.examples:
        body += ["<h2>Examples</h2>", *(_case(shown, found.methods) for shown in found.examples)]
    if found.worst:
        last = page(found.methods[-1])
        note = f"Where {last} is furthest from the truth, by PSNR in the {JUDGED_BY} region."
        body += [f"<h2>The worst {len(found.worst)} cases</h2><p>{note}</p>", '<div class="worst">']
        body += [*(_case(shown, (found.methods[-1],)) for shown in found.worst), "</div>"]
    head = f'<meta charset="utf-8"><title>Evaluation</title><style>{_STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n{"".join(body)}\n</body></html>\n'


def _html_table(table: Table) -> str:
    head = "".join(f"<th>{page(name)}</th>" for name in ("method", *table.columns))
    rows = []
    for method in table.rows:
        cells = "".join(f'<td class="best">{t}</td>' if best else f"<td>{t}</td>" for t, best in table.cells(method))
        rows.append(f"<tr><td>{page(method)}</td>{cells}</tr>")
    caption = f"{page(table.title)} <span>({page(table.note)})</span>"
    return f"<table><caption>{caption}</caption><tr>{head}</tr>{''.join(rows)}</table>"


def _case(shown: Shown, methods: tuple[str, ...]) -> str:
    """Show a case in a row: composite, outputs, truth, and where the last output differs from it."""
    case, figures = shown.case, []
    if methods[0] != "raw composite":
        figures.append(_figure("composite", case.composite, _psnr(shown, "raw composite")))
    figures += [_figure(method, shown.outputs[method], _psnr(shown, method)) for method in methods]
    if case.target is not None:
        figures.append(_figure("target", case.target))
        figures.append(_figure(f"error of {methods[-1]} (FLIP)", _error(shown.outputs[methods[-1]], case.target)))
    else:
        figures.append(_figure("background", case.background))
    tags = page(", ".join(shown.subsets))
    title = f"{page(case.name)} <span>{tags}</span>"
    return f'<div class="case"><h3>{title}</h3><div class="row">{"".join(figures)}</div></div>'


def _psnr(shown: Shown, method: str) -> str:
    scores = shown.scores.get(method, {})
    region = JUDGED_BY if JUDGED_BY in scores else "image"
    return f"{scores[region]['PSNR']:.2f} dB" if region in scores else ""


def _figure(title: str, picture: Float32, note: str = "") -> str:
    stream = io.BytesIO()
    Image.fromarray(to_bytes(picture)).save(stream, "JPEG", quality=92, subsampling=0)
    data = base64.b64encode(stream.getvalue()).decode()
    words = page(title)
    image = f'<img alt="{words}" src="data:image/jpeg;base64,{data}">'
    return f"<figure>{image}<figcaption>{words}<br>{note}</figcaption></figure>"


def _error(output: Float32, target: Float32) -> Float32:
    pair = [np.ascontiguousarray(np.clip(picture, 0.0, 1.0), np.float32) for picture in (target, output)]
    coloured, _, _ = flip_evaluator.evaluate(*pair, "LDR", inputsRGB=True, applyMagma=True, computeMeanError=False)
    return np.asarray(coloured, np.float32)
