"""What an object leaves in backgrounds from which it was removed, beside scenes rendered without it from the start.

1. Ghosts: of the object's contrast, how much is left in blocks of 8x8 pixels inside its silhouette, in any layer,
   against converged renders. Layers with a block in which more than half is left are named, of either kind: what never
   had the object tells how many noise alone makes.
2. Inside silhouettes and in a ring round them: error, error of colour and gradient energy against converged renders, as
   ratios of the background from which the object was removed to the one that never had it. At 1 nothing tells.
3. A small convolutional network is trained to find silhouettes in backgrounds, once in either kind, and tested on
   scenes that it has not seen (area under the ROC curve). What it finds in backgrounds that never had the object is
   where objects use to stand.

    python -m benchmarks.traces --preset mixed --scenes 24
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
import tyro
from scipy.ndimage import binary_dilation
from scipy.stats import rankdata
from torch import nn

from multilight.datagen.backends.choose import open_backend, resolve_renderer
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.production.denoise import denoise_all, denoise_without
from multilight.datagen.production.scene import contact_faults, sample_scene
from multilight.datagen.production.view import shown_in
from multilight.datagen.storage.layers import LayerStack
from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec

SIDE = 8
LEAST = 60  # pixels of a silhouette that is looked at
CONTRAST = 0.2  # of the local radiance: blocks in which the object differs less tell nothing


@dataclass
class Options:
    """What to measure."""

    preset: Preset = "mixed"
    seed: int = 55
    scenes: int = 12
    size: int = 128
    renderer: str = "auto"
    spp: int = 16
    converged_spp: int = 512
    """Samples of the converged renders (0: none, only the network)."""
    steps: int = 300
    """Steps of the network's training (0: none)."""


@dataclass(frozen=True)
class Background:
    """One layer of a background: the object was `removed`, or `never` there; `converged`, and `present` with it."""

    scene: int
    name: str
    silhouette: Mask
    removed: Float32
    never: Float32
    converged: Float32
    present: Float32


def backgrounds(options: Options, backend: Backend, library: AssetLibrary) -> Iterator[Background]:
    """Render the first view of each scene with and without each object."""
    values = {"seed": options.seed, "scenes": options.scenes, "width": options.size, "height": options.size, "views": 1}
    config = load_config(None, values, options.preset)
    for index in range(options.scenes):
        for attempt in range(3):
            scene, rig = sample_scene(config, library, Streams(options.seed, index, attempt))
            if not contact_faults(scene, library):
                break
        else:
            continue

        def render(variant: str, spp: int = options.spp, scene: SceneSpec = scene, rig: LightRig = rig) -> LayerStack:
            return backend.render(RenderJob(scene, rig, RenderSettings(spp=spp), 0, variant))

        everything = render(ALL)
        clean = denoise_all(everything)
        for name in scene.insertable:
            without, foreground = (render(of(name)) for of in (Variant.without, Variant.foreground))
            assert foreground.coverage is not None
            silhouette = foreground.coverage > 0
            if silhouette.sum() < LEAST:
                continue
            shown = shown_in(everything, without, foreground)
            removed = denoise_without(without, everything, clean, shown).layers
            bodies = tuple(body for body in scene.bodies if body.name != name)
            lights = tuple(x for x in rig.lights if not (isinstance(x, EmissiveLight) and x.body == name))
            emptied = scene.model_copy(update={"bodies": bodies})
            never = denoise_all(render(ALL, scene=emptied, rig=LightRig(lights=lights)))
            # Without converged renders nothing is compared with them.
            truth, present = (
                render(variant, options.converged_spp).radiance if options.converged_spp else everything.radiance
                for variant in (Variant.without(name), ALL)
            )
            for light, alone in zip(lights, never, strict=True):
                at, title = rig.names.index(light.name), f"scene {index}, {name}, {light.name}"
                yield Background(index, title, silhouette, removed[at], alone, truth[at], present[at])
        print(f"scene {index} ({scene.kind}) rendered", flush=True)


def fractions_left(layer: Background, picture: Float32) -> Iterator[float]:
    """Yield how much of the object's contrast a picture holds, by blocks inside the silhouette."""
    for top in range(0, layer.silhouette.shape[0], SIDE):
        for left in range(0, layer.silhouette.shape[1], SIDE):
            at = np.s_[top : top + SIDE, left : left + SIDE]
            mask = layer.silhouette[at]
            if mask.sum() < SIDE * SIDE // 4:
                continue
            true = layer.converged[at][mask].mean(axis=0)
            off, contrast = picture[at][mask].mean(axis=0) - true, layer.present[at][mask].mean(axis=0) - true
            if np.abs(contrast).max() > CONTRAST * (true.mean() + 0.02 * layer.converged.mean()):
                yield float(off @ contrast / (contrast @ contrast))


def _local(true: Float32) -> Float32:
    return true.mean(axis=-1, keepdims=True) + 0.05 * true.mean()


def _error(picture: Float32, true: Float32, where: Mask) -> float:
    return float(np.sqrt(np.mean(np.square((picture - true) / _local(true))[where])))


def _colour_error(picture: Float32, true: Float32, where: Mask) -> float:
    chromaticities = [image / (image.sum(axis=-1, keepdims=True) + 0.05 * true.mean()) for image in (picture, true)]
    return float(np.abs(chromaticities[0] - chromaticities[1])[where].mean())


def _gradient_energy(picture: Float32, true: Float32, where: Mask) -> float:
    energy = sum(np.square(np.diff(picture, axis=axis, append=picture.take([-1], axis))) for axis in (0, 1))
    return float((energy / _local(true) ** 2)[where].mean())


MEASURES: dict[str, Callable[[Float32, Float32, Mask], float]] = {
    "error": _error,
    "error of colour": _colour_error,
    "gradient energy": _gradient_energy,
}


def compare(layers: list[Background]) -> None:
    """Print the ratios of what was removed from to what never had the object."""
    for kind in ("removed", "never"):
        left = [(max(found), x.name) for x in layers if (found := list(fractions_left(x, getattr(x, kind))))]
        ghosts = [f"{name} ({fraction:.2f})" for fraction, name in sorted(left, reverse=True) if fraction > 0.5]
        print(f"{kind}: layers with a block that is nearer to the object: {len(ghosts)} of {len(left)}", *ghosts)
    for place in ("inside silhouettes", "in a ring round them"):
        for name, measure in MEASURES.items():
            ratios = []
            for layer in layers:
                near, far = (binary_dilation(layer.silhouette, iterations=reach) for reach in (4, 14))
                where = layer.silhouette if place.startswith("inside") else far & ~near
                values = [measure(picture, layer.converged, where) for picture in (layer.removed, layer.never)]
                if min(values) > 0:
                    ratios.append(np.log(values[0] / values[1]))
            spread = np.std(ratios) / np.sqrt(len(ratios))
            print(f"{name} {place}: {np.exp(np.mean(ratios)):.3f} ± {spread:.3f} times that of what never had it")


class Finder(nn.Module):
    """A small network that looks at a layer, and at what its neighbourhood does not explain, for 23 pixels around."""

    def __init__(self, width: int = 24) -> None:
        super().__init__()
        parts: list[nn.Module] = [nn.Conv2d(6, width, 3, padding=1)]
        for reach in (1, 1, 2, 2, 4, 4):
            parts += [nn.GroupNorm(4, width), nn.ReLU(), nn.Conv2d(width, width, 3, padding=reach, dilation=reach)]
        self.layers = nn.Sequential(*parts, nn.ReLU(), nn.Conv2d(width, 1, 1))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Return logits of each pixel's being in a silhouette; `image` (N, 3, H, W) are logarithms of radiance."""
        fine = image - nn.functional.avg_pool2d(image, 5, 1, 2, count_include_pad=False)
        return self.layers(torch.cat([image - image.mean(dim=(2, 3), keepdim=True), 5 * fine], dim=1))


def found_by_network(layers: list[Background], kind: str, steps: int) -> tuple[float, float]:
    """Train on two thirds of the scenes; return the area under the curve on the others, and its standard error."""
    scenes = np.unique([layer.scene for layer in layers])
    kept = set(np.random.default_rng(0).permutation(scenes)[: max(1, len(scenes) // 3)].tolist())
    pictures = torch.stack([_logarithm(getattr(layer, kind)) for layer in layers])
    masks = torch.tensor(np.array([layer.silhouette for layer in layers]))[:, None].float()
    held_out = torch.tensor([layer.scene in kept for layer in layers])
    known, known_masks = pictures[~held_out], masks[~held_out]
    torch.manual_seed(0)
    network, wrong = Finder(), nn.BCEWithLogitsLoss(pos_weight=torch.tensor(10.0))
    optimizer = torch.optim.AdamW(network.parameters(), 2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    for _ in range(steps):
        chosen = torch.randint(len(known), (8,))
        loss = wrong(network(known[chosen]), known_masks[chosen])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    areas: dict[int, list[float]] = {scene: [] for scene in sorted(kept)}
    with torch.no_grad():
        for layer, picture in zip(layers, pictures, strict=True):
            if layer.scene in kept:
                areas[layer.scene].append(_area(network(picture[None])[0, 0].numpy(), layer.silhouette))
    of_scene = [np.mean(found) for found in areas.values()]
    return float(np.mean(of_scene)), float(np.std(of_scene) / np.sqrt(len(of_scene)))


def _logarithm(layer: Float32) -> torch.Tensor:
    mean = np.exp(np.log(layer.mean(axis=-1) + 1e-9).mean())
    return torch.from_numpy(np.log(layer / mean + 0.02)).permute(2, 0, 1)


def _area(scores: Float32, truth: Mask) -> float:
    """Area under the ROC curve, by the rank sum (Mann and Whitney 1947)."""
    ranks, positives = rankdata(scores).reshape(truth.shape), truth.sum()
    return float((ranks[truth].sum() - positives * (positives + 1) / 2) / (positives * (truth.size - positives)))


def main(options: Options) -> None:
    """Render, compare, train, print."""
    library = AssetLibrary()
    with open_backend(resolve_renderer(options.renderer), library) as backend:
        layers = list(backgrounds(options, backend, library))
    if options.converged_spp:
        compare(layers)
    if options.steps:
        for kind, title in (("removed", "from which it was removed"), ("never", "that never had it")):
            area, error = found_by_network(layers, kind, options.steps)
            print(f"a network finds its place in backgrounds {title}: {area:.3f} ± {error:.3f} under the curve")


if __name__ == "__main__":
    main(tyro.cli(Options))
