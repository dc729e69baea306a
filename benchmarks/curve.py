"""What more scenes are worth: gains over the composite by the number of scenes that a training had, as a plot.

Reads what `multilight evaluate` wrote about the trainings of `multilight ablate scenes`, and prints a row for each
number of scenes: the mean over seeds, in domain and out of it [dB].

    multilight ablate scenes out/volume-packed --size 64 --steps 12000 --batch 16 --seeds 1 --out out/curve
    multilight evaluate out/volume-packed --weights out/curve/runs/*/model.safetensors --groups 1000 --size 64 \\
        --lighting random --out out/curve/report
    python -m benchmarks.curve out/curve/report/evaluation.json --plot docs/curve.png
"""

import json
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

REGIONS = ("object", "effect", "object and effect")
SPLITS = {"test": "in domain", "test_ood": "out of domain"}
RAW = "raw composite"
Gains = dict[int, dict[tuple[str, str], list[float]]]


@dataclass
class Options:
    """What was evaluated, and where the plot goes."""

    evaluation: tyro.conf.Positional[Path]
    plot: Path | None = None


def gains(evaluation: Path) -> Gains:
    """Return, by number of scenes, each split's and region's gains over the composite [dB], one a seed."""
    methods = json.loads(evaluation.read_text(encoding="utf-8"))["methods"]
    found: Gains = defaultdict(lambda: defaultdict(list))
    for name, scores in methods.items():
        if told := re.match(r"(\d+)-of-\d+-scenes", name):
            for split in SPLITS:
                for region in REGIONS:
                    ours, raw = (m["subsets"][split][region]["PSNR"] for m in (scores, methods[RAW]))
                    found[int(told[1])][split, region].append(ours - raw)
    return dict(sorted(found.items()))


def draw(found: Gains, path: Path) -> None:
    """Plot the gains over the number of scenes."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(REGIONS), figsize=(9, 3), sharex=True, sharey=True)
    counts = list(found)
    for axis, region in zip(axes, REGIONS, strict=True):
        for (split, name), line in zip(SPLITS.items(), ("o-", "s--"), strict=True):
            axis.plot(counts, [np.mean(found[count][split, region]) for count in counts], line, label=name)
        axis.set_xscale("log")
        axis.set_xticks(counts, [str(count) for count in counts])
        axis.minorticks_off()
        axis.axhline(0.0, color="0.7", linewidth=0.8)
        axis.set_title(region, fontsize=10)
        axis.set_xlabel("scenes learnt from")
    axes[0].set_ylabel("gain over the composite [dB]")
    axes[0].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=100)


def main(options: Options) -> None:
    """Print the curve, and plot it."""
    found = gains(options.evaluation)
    print("scenes  seeds  " + "  ".join(f"{split}: {region}" for split in SPLITS.values() for region in REGIONS))
    for count, each in found.items():
        numbers = [f"{np.mean(values):+.2f}" for values in each.values()]
        print(f"{count:6}  {len(next(iter(each.values()))):5}  {'  '.join(numbers)}")
    if options.plot is not None:
        draw(found, options.plot)


if __name__ == "__main__":
    main(tyro.cli(Options))
