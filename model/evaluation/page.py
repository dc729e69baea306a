"""The evaluation as Markdown, JSON, and one self-contained HTML page with pictures."""

import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from multilight.datagen.errors import full_disk_told
from multilight.datagen.files.outputs import check_folder
from multilight.datagen.pages.render import data_uri, render_page
from multilight.datagen.storage.store import write_text
from multilight.datagen.text import markdown as escaped
from multilight.model.evaluation.cases import VARIANT
from multilight.model.evaluation.metrics import HIGHER_IS_BETTER, METRICS, REGIONS, Scores, flip_picture
from multilight.model.evaluation.run import JUDGED_BY, Evaluation, Shown
from multilight.model.inference.pictures import to_bytes
from multilight.scenes.arrays import Float32

DIGITS = {"PSNR": 2, "SSIM": 4, "FLIP": 4, "LPIPS": 4}


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
        regions = sorted(REGIONS, key=lambda region: region != JUDGED_BY)
        over = tuple(subset for subset in found.subsets if subset.startswith(VARIANT))
        plain = tuple(subset for subset in found.subsets if subset not in over)
        tables += [_subset_table(found, region, "by subset", plain) for region in regions]
        tables += [_subset_table(found, region, "made over", over) for region in regions if over]
    return tables


def _metric_table(metric: str, means: Mapping[str, Scores]) -> Table:
    regions = tuple(region for region in REGIONS if any(region in scores for scores in means.values()))
    rows = {
        method: tuple(scores.get(region, {}).get(metric, math.nan) for region in regions)
        for method, scores in means.items()
    }
    higher: tuple[bool | None, ...] = (HIGHER_IS_BETTER[metric],) * len(regions)
    unit = f"{'dB, ' if metric == 'PSNR' else ''}{'higher' if HIGHER_IS_BETTER[metric] else 'lower'} is better"
    return Table(metric, unit, regions, rows, (DIGITS[metric],) * len(regions), higher)


def _cost_table(found: Evaluation) -> Table:
    rows = {}
    for method in found.methods:
        own, ratio = found.inconsistency(method)
        rows[method] = (255.0 * own, ratio, found.seconds(method), found.megabytes[method])
    columns = ("views disagree by", "over the truth's", "s a frame", "MB")
    note = "disagreement of views in grey levels of 255, in the object-and-effect region; mean time, peak memory"
    return Table("Consistency and cost", note, columns, rows, (2, 2, 3, 0), (None, False, None, None))


def _subset_table(found: Evaluation, region: str, title: str, subsets: tuple[str, ...]) -> Table:
    rows = {}
    for method in found.methods:
        scores = [found.means(method, subset) for subset in subsets]
        rows[method] = tuple(each.get(region, {}).get("PSNR", math.nan) for each in scores)
    columns = tuple(f"{subset.removeprefix(VARIANT)} ({len(found.frames_of(subset))})" for subset in subsets)
    size = len(subsets)
    return Table(f"PSNR {title}: {region}", "dB; number of frames", columns, rows, (2,) * size, (True,) * size)


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
    last = found.methods[-1]
    examples = [_case(shown, found.methods) for shown in found.examples]
    return render_page(
        Path(__file__).with_name("page.html.jinja"),
        title="Evaluation",
        about=about,
        tables=tables,
        titles=[figure["title"] for figure in examples[0]["figures"]] if examples else [],
        examples=examples,
        worst=[_case(shown, (last,)) for shown in found.worst],
        last=last,
        region=JUDGED_BY,
    )


def _case(shown: Shown, methods: tuple[str, ...]) -> dict[str, Any]:
    """Lay a case out in a row: composite, outputs, truth, and where the last output differs from it."""
    case, figures = shown.case, []
    if methods[0] != "raw composite":
        figures.append(_figure("composite", case.composite, _psnr(shown, "raw composite")))
    figures += [_figure(method, shown.outputs[method], _psnr(shown, method)) for method in methods]
    if case.target is not None:
        figures.append(_figure("target", case.target))
        figures.append(_figure(f"error of {methods[-1]} (FLIP)", flip_picture(shown.outputs[methods[-1]], case.target)))
    else:
        figures.append(_figure("background", case.background))
    return {"name": case.name, "subsets": shown.subsets, "figures": figures}


def _psnr(shown: Shown, method: str) -> str:
    scores = shown.scores.get(method, {})
    region = JUDGED_BY if JUDGED_BY in scores else "image"
    return f"{scores[region]['PSNR']:.2f} dB" if region in scores else ""


def _figure(title: str, picture: Float32, note: str = "") -> dict[str, str]:
    stream = io.BytesIO()
    Image.fromarray(to_bytes(picture)).save(stream, "JPEG", quality=92, subsampling=0)
    return {"title": title, "picture": data_uri(stream.getvalue(), "jpeg"), "note": note}
