"""How many draws fail their checks, and why: scenes made small, as a worker makes them, for the presets.

python -m benchmarks.draws --presets room --scenes 200
"""

import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.production.library import open_library
from multilight.datagen.production.scene import SceneFailedError, SceneMaker, make_scene
from multilight.datagen.tables import print_table


@dataclass
class Options:
    """What to draw."""

    presets: tuple[Preset, ...] = ("tabletop", "room", "outdoor", "studio", "mixed")
    scenes: int = 100
    size: int = 64
    views: int = 2
    seed: int = 77
    first: int = 0


def failures(options: Options, preset: Preset) -> tuple[int, list[str]]:
    """Make scenes; return how many draws that took, and why some were thrown away."""
    size = {"width": options.size, "height": options.size, "views": options.views}
    config = load_config(None, size | {"seed": options.seed, "scenes": options.first + options.scenes}, preset)
    library = open_library(config)
    made, told = 0, list[str]()
    with tempfile.TemporaryDirectory() as folder, open_backend("mitsuba", library) as backend:
        maker = SceneMaker(config, "mitsuba", Path(folder), library, backend, 1)
        for index in range(options.first, options.first + options.scenes):
            try:
                told += make_scene(maker, index).record.thrown_away
                made += 1
            except SceneFailedError as error:
                print(error, flush=True)
                told += [str(error)] * 3
    return made + len(told), told


def main(options: Options) -> None:
    """Print a table."""
    rows = []
    for preset in options.presets:
        draws, told = failures(options, preset)
        reasons = Counter(reason.partition(":")[0] for reason in told)
        said = ", ".join(f"{name} {count}" for name, count in reasons.most_common())
        rows.append((preset, draws, len(told), f"{len(told) / draws:.1%}", said))
        print_table(("preset", "draws", "failed", "of all", "why"), rows)


if __name__ == "__main__":
    main(tyro.cli(Options))
