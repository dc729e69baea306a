"""What each piece of knowledge about the light is worth, told by the true layers: gains in dB over the raw composite.

Of held-out objects under two of their scene's stored conditions. On the object: one true gain a channel; the true
irradiance by normal, of nine spherical harmonics (Ramamoorthi and Hanrahan 2001) fitted to the true pictures over the
true albedo, under either lighting. On its surroundings: each light's layer of the background loses its direct share
where the object hides the light, as found by marching through the depth map (`model.networks.shading`) with the true
direction at the object; environments count as one wide light above. The true direct share is one number a light, fitted
to the true layers.

    python -m benchmarks.oracles out/volume
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
import tyro

from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.store import ViewData
from multilight.lights.display.tonemap import tone_curve
from multilight.lights.relight import gain_matrix
from multilight.model.data.lights import KINDS, SceneLights, read_lights
from multilight.model.evaluation.metrics import Regions, psnr
from multilight.model.networks.shading import FOCAL, points, visibility
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.splits import Split
from multilight.scenes.colour import luminance, srgb_encode

SHOWN = ("object", "effect", "object and effect")
ENVIRONMENT = KINDS.index("environment")
ABOVE, SKY = (0.0, 0.0, 1.0), 1.0
"""What an environment's shadow is taken for: that of a light straight above, this tangent of half its diameter wide."""
LEAST = 30.0
"""Pixels that an object must cover."""
DARK = 1e-3


@dataclass
class Options:
    """What to measure on."""

    dataset: tyro.conf.Positional[str]
    """Native dataset: normals and albedo are not in a packed copy."""
    splits: tuple[Split, ...] = ("test", "test_ood")
    pairs: int = 2
    """Pairs of conditions for each object and view."""
    seed: int = 0


@dataclass(frozen=True)
class Example:
    """One object in one view under two lightings, in linear light: layers (L, H, W, 3), pictures (H, W, 3)."""

    view: ViewData
    name: str
    insert: Float32  # (L, 3) gains
    base: Float32
    lights: SceneLights
    c2w: np.ndarray
    focal: float

    @property
    def mask(self) -> Float32:
        return self.view.coverage[self.name]

    def layers(self, variant: str, gains: Float32) -> Float32:
        return np.asarray(self.view.variants[Variant(variant)] * gains[:, None, None, :])

    def foreground(self, gains: Float32) -> Float32:
        return self.layers(Variant.foreground(self.name), gains).sum(axis=0)

    def background(self) -> Float32:
        return self.layers(Variant.without(self.name), self.base)

    def seen(self, focal: float, *, hard: bool = False) -> Float32:
        """Return how much of each light the object leaves, (L, H, W), by the depth map."""
        told = self.lights.seen(self.c2w, self.name, mirrored=False)
        count = len(self.base)
        towards, size = told["light_towards"][:count], (told["light_size"][:count] / 2).tan()
        environment = told["light_kind"][:count] == ENVIRONMENT
        above = torch.tensor(np.array(ABOVE) @ self.c2w[:3, :3], dtype=torch.float32)
        towards = torch.where(environment[:, None], above, towards)
        softness = torch.where(environment, SKY, torch.zeros_like(size) if hard else size)
        z = self.view.geometry.z_depth
        depth = torch.from_numpy(np.where(z > 0, z, 4 * z.max()) / z.max())[None, None].float()
        mask = torch.from_numpy(self.mask)[None, None]
        found = [
            visibility(points(depth, focal), mask, t[None, None], s[None, None], focal)[0, 0]
            for t, s in zip(towards, softness, strict=True)
        ]
        return torch.stack(found).numpy()


Oracle = Callable[[Example], tuple[Float32, Float32]]
"""Returns the object's picture, premultiplied by its coverage, and that of its surroundings, both (H, W, 3) linear."""


def raw(example: Example) -> tuple[Float32, Float32]:
    """Change nothing."""
    return example.foreground(example.insert), example.background().sum(axis=0)


def one_gain(example: Example) -> Float32:
    """Give the object the mean true gain of each channel, in the logarithm."""
    came, true = example.foreground(example.insert), example.foreground(example.base)
    inside = example.mask > 0.5
    logs = np.log(true[inside] + DARK) - np.log(came[inside] + DARK)
    return np.asarray(came * np.exp(logs.mean(axis=0)), np.float32)


def by_normal(example: Example) -> Float32:
    """Give the object, normal by normal, the true irradiance over that which it came with."""
    came, geometry = example.foreground(example.insert), example.view.geometry
    inside = example.mask > 0.5
    basis = harmonics(geometry.normal_world)
    albedo = np.maximum(geometry.albedo, 0.02)
    lit = []
    for picture in (example.foreground(example.base), came):
        weight = albedo[inside]  # of the error in the picture, not in irradiance
        shading = [
            np.linalg.lstsq(basis[inside] * weight[:, c : c + 1], picture[inside][:, c], rcond=None)[0]
            for c in range(3)
        ]
        lit.append(np.maximum(basis @ np.stack(shading, axis=1), DARK))
    return np.asarray(came * np.clip(lit[0] / lit[1], 0.01, 100.0), np.float32)


def harmonics(normal: Float32) -> Float32:
    """Return the nine real spherical harmonics up to order two, unnormalized, of normals (H, W, 3): (H, W, 9)."""
    x, y, z = np.moveaxis(normal, -1, 0)
    return np.stack((np.ones_like(x), x, y, z, x * y, y * z, x * z, 3 * z * z - 1, x * x - y * y), axis=-1)


def shadowed(
    example: Example, *, share: bool, focal: float | None = None, hard: bool = False, strongest: bool = False
) -> Float32:
    """Take from the background what the object hides of its lamps, all of each or its true direct share."""
    layers = example.background()
    hidden = 1.0 - example.seen(example.focal if focal is None else focal, hard=hard)[..., None]
    outside = (1.0 - example.mask)[..., None]
    if share:
        lost = (layers - example.layers(ALL, example.base)) * outside
        shape = layers * hidden * outside
        fitted = (lost * shape).sum(axis=(1, 2, 3)) / np.maximum((shape**2).sum(axis=(1, 2, 3)), 1e-12)
        hidden = hidden * np.clip(fitted, 0.0, 1.0)[:, None, None, None]
    if strongest:
        strength = luminance(layers * outside).sum(axis=(1, 2))
        hidden = hidden * (np.arange(len(layers)) == strength.argmax())[:, None, None, None]
    return np.asarray((layers * (1.0 - hidden)).sum(axis=0), np.float32)


def region_gain(example: Example) -> Float32:
    """Give all that the object's effect reaches visibly one gain a channel."""
    before, after = example.background().sum(axis=0), example.layers(ALL, example.base).sum(axis=0)
    region = np.abs(shown(after) - shown(before)).max(axis=-1) > 0.02
    region &= example.mask <= 0.5
    if not region.any():
        return np.asarray(before)
    gain = np.exp((np.log(after[region] + DARK) - np.log(before[region] + DARK)).mean(axis=0))
    return np.where(region[..., None], before * gain, before).astype(np.float32)


ORACLES: dict[str, Oracle] = {
    "composite": raw,
    "object: one true gain a channel": lambda e: (one_gain(e), raw(e)[1]),
    "object: true irradiance by normal": lambda e: (by_normal(e), raw(e)[1]),
    "effect: where it is, and one gain a channel": lambda e: (raw(e)[0], region_gain(e)),
    "effect: shadows, all light direct": lambda e: (raw(e)[0], shadowed(e, share=False)),
    "effect: shadows, true direct shares": lambda e: (raw(e)[0], shadowed(e, share=True)),
    "  of the strongest light alone": lambda e: (raw(e)[0], shadowed(e, share=True, strongest=True)),
    "  of lights without size": lambda e: (raw(e)[0], shadowed(e, share=True, hard=True)),
    "  through an assumed lens": lambda e: (raw(e)[0], shadowed(e, share=True, focal=FOCAL)),
    "gain a channel, shadows of true shares": lambda e: (one_gain(e), shadowed(e, share=True)),
    "irradiance by normal, shadows of true shares": lambda e: (by_normal(e), shadowed(e, share=True)),
    "the object as it should be": lambda e: (e.foreground(e.base), raw(e)[1]),
}


def shown(radiance: Float32) -> Float32:
    """Return what a display shows of linear radiance."""
    return np.asarray(srgb_encode(tone_curve(radiance)), np.float32)


def examples(source: DatasetSource, options: Options) -> Iterator[Example]:
    """Yield every object that is seen well, in every view, under `pairs` pairs of stored conditions."""
    for record in source.scenes():
        rng = np.random.default_rng((options.seed, record.index))
        for number, camera in enumerate(record.views):
            view = source.view(record, number)
            lights = read_lights(source.place, record.index, view.lights, len(view.lights))
            gains = [gain_matrix(view.lights, condition) for condition in record.conditions]
            c2w, focal = np.array(camera.c2w), np.array(camera.K)[0, 0] / max(view.geometry.z_depth.shape)
            for name in sorted(view.coverage):
                if view.coverage[name].sum() >= LEAST:
                    for _ in range(options.pairs):
                        insert, base = (gains[i] for i in rng.choice(len(gains), 2, replace=False))
                        yield Example(view, name, insert, base, lights, c2w, float(focal))


def gains_of(example: Example) -> dict[str, dict[str, float]]:
    """Return each oracle's PSNR by region."""
    target = shown(example.layers(ALL, example.base).sum(axis=0))
    uncovered = (1.0 - example.mask)[..., None]
    effect = target - shown(example.background().sum(axis=0))
    regions = Regions.of(example.mask, effect).masks
    found = {}
    for name, oracle in ORACLES.items():
        foreground, surroundings = oracle(example)
        squared = np.square(shown(foreground + uncovered * surroundings) - target).mean(axis=-1)
        found[name] = {r: psnr(float(squared[regions[r]].mean())) for r in SHOWN if regions[r].any()}
    return found


def main(options: Options) -> None:
    """Print a table for each split."""
    torch.set_num_threads(1)
    for split in options.splits:
        source = open_dataset(options.dataset, where=f"split = '{split}'")
        found: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
        for example in examples(source, options):
            for name, values in gains_of(example).items():
                for region, value in values.items():
                    found[name][region].append(value)
        before = {region: float(np.mean(found["composite"][region])) for region in SHOWN}
        count = len(found["composite"]["object"])
        print(f"\n{split}: {count} pictures of {len(source.indices)} scenes\n\n| | {' | '.join(SHOWN)} |")
        print("|---|" + "---:|" * len(SHOWN))
        for name, scores in found.items():
            means = {region: float(np.mean(scores[region])) for region in SHOWN}
            cells = [f"{means[r]:.2f}" if name == "composite" else f"{means[r] - before[r]:+.2f}" for r in SHOWN]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
