"""Milliseconds and bytes of one training tuple: packed, from the EXR store, and as four 8-bit PNGs, side by side.

A tuple is composite, background, target, depth, mask and effect of one object in one view under two lightings, read
from warm storage on one thread. The methods alternate, so that all of them meet the same machine. The PNGs (composite,
background, target, depth) are those that a dataset of finished pictures would hold, decoded to the same float tensors.
Bytes are of one view; the published set stores each picture at 12 lightings x 4 exposures.

    python benchmarks/tuple_speed.py out/dataset out/packed
"""

import io
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from PIL import Image

from multilight.datagen.export.images import png, to_byte
from multilight.datagen.storage.object_variants import Variant
from multilight.datagen.storage.open_training import TrainingSource, open_training
from multilight.datagen.storage.packed import PackedView
from multilight.lights.display.tonemap import to_display
from multilight.model.data import MultiLightDataset, SampleSettings
from multilight.model.data.augment import PLAIN, centre_crop
from multilight.model.data.dataset import cropped_sample
from multilight.model.data.mixing import mix_tuple

Place = tuple[int, int, str]


@dataclass
class Options:
    """What to measure."""

    native: tyro.conf.Positional[str]
    """The dataset."""
    packed: tyro.conf.Positional[str]
    """Its packed copy."""
    rounds: int = 100
    """Tuples that every method makes; the EXR store makes a tenth of them."""


def tuple_of(source: TrainingSource, place: Place) -> dict[str, torch.Tensor]:
    """Read a view and mix one tuple under two of its stored lightings."""
    scene, number, name = place
    return mixed(source.view(scene, number), name)


def mixed(view: PackedView, name: str) -> dict[str, torch.Tensor]:
    """Mix one tuple under the last two of the view's stored lightings."""
    insert, base = view.conditions[-2:]
    pictures = mix_tuple(view, name, insert=insert, base=base, camera=PLAIN, own=np.zeros(len(insert), bool))
    return cropped_sample(view, pictures, centre_crop(*view.z_depth.shape), min(view.z_depth.shape))


def read_pngs(files: list[bytes]) -> list[torch.Tensor]:
    """Decode pictures to float tensors in [0, 1]."""
    return [torch.from_numpy(np.array(Image.open(io.BytesIO(f)))).float().div_(255) for f in files]


def published_bytes(source: TrainingSource, scene: int, number: int, name: str) -> int:
    """Return the bytes of one object's backgrounds as finished pictures: 12 lightings at 4 exposures."""
    view, total = source.view(scene, number), 0
    layers = view.variant(Variant.without(name)).astype(np.float32)
    for gains in view.conditions[:12]:
        linear = np.einsum("lhwc,lc->hwc", layers, gains)
        for stops in (-1.0, -0.5, 0.0, 0.5):
            total += len(png(to_display(linear, stops)))
    return total


def milliseconds(methods: dict[str, Callable[[int], object]], rounds: int) -> dict[str, list[float]]:
    """Time every method, one after the other in every round, in milliseconds of processor time."""
    spent: dict[str, list[float]] = {name: [] for name in methods}
    for number in range(-5, rounds):
        for name, make in methods.items():
            if name.startswith("EXR") and number % 10:
                continue
            start = time.thread_time()
            make(number)
            if number >= 0:
                spent[name].append((time.thread_time() - start) * 1e3)
    return spent


def main(options: Options) -> None:
    """Print time and bytes of every method."""
    torch.set_num_threads(1)
    native, packed = open_training(options.native), open_training(options.packed)
    plan = MultiLightDataset(options.packed, SampleSettings(split=None)).plan
    places: list[Place] = [(p.scene, p.seen[0], p.object) for p in plan.places[:: max(1, len(plan.places) // 32)]]
    files = []
    for place in places:
        sample = tuple_of(packed, place)
        depth = sample["z_depth"] / sample["z_depth"].max()
        pictures = (sample["composite"], sample["background"], sample["target"], depth)
        files.append([png(to_byte(p.permute(1, 2, 0).squeeze(2).numpy())) for p in pictures])
    views = [packed.view(*place[:2]) for place in places]
    random = MultiLightDataset(options.packed, SampleSettings(split=None, augment=False, length=options.rounds + 5))
    varied = MultiLightDataset(options.packed, SampleSettings(split=None, length=options.rounds + 5))
    count = len(places)
    methods: dict[str, Callable[[int], object]] = {
        "packed: read and mix": lambda i: tuple_of(packed, places[i % count]),
        "  of it mixing": lambda i: mixed(views[i % count], places[i % count][2]),
        "  and with new lighting, metered": lambda i: random[i % len(random)],
        "  and augmented": lambda i: varied[i % len(varied)],
        "four 8-bit PNGs": lambda i: read_pngs(files[i % count]),
        "EXR store": lambda i: tuple_of(native, places[i % count]),
    }
    for name, spent in milliseconds(methods, options.rounds).items():
        low, median = np.percentile(spent, (5, 50))
        print(f"{name:36}{median:8.2f} ms (median), {low:.2f} ms (5th percentile)")
    print_bytes(packed, native, places)


def print_bytes(packed: TrainingSource, native: TrainingSource, places: list[Place]) -> None:
    """Print what a view takes in each form."""
    seen = list(dict.fromkeys((scene, view) for scene, view, _ in places))
    own = np.mean([packed.size(*view) for view in seen])
    exr = np.mean([native.size(*view) for view in seen])
    pictures = np.mean([published_bytes(packed, *place) for place in places[::4]])
    print(f"bytes of a view: packed {own / 1e6:.2f} MB, EXR {exr / 1e6:.2f} MB, both with all their objects; "
          f"48 PNGs of one object's background {pictures / 1e6:.2f} MB, and as much again of the target")  # fmt: skip


if __name__ == "__main__":
    main(tyro.cli(Options))
