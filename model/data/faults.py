"""What users' inputs have wrong, simulated from the true layers: depth missing or guessed, objects misplaced."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from multilight.datagen.storage.object_variants import ALL, Variant
from multilight.datagen.storage.packed import PackedView
from multilight.model.configs.stage2d import Fault
from multilight.model.data.augment import CameraResponse
from multilight.model.data.mixing import Pictures, develop, fraction
from multilight.model.networks.shading import blur
from multilight.scenes.arrays import Float32, Mask

HOLES = 0.2
"""Fraction of a picture in which a sensor finds no depth."""
SHIFT = 0.5
"""Largest offset of affine-wrong depth: down of the nearest depth, up of the farthest."""
NOISE = (0.005, 0.05)
"""Standard deviation of noise, relative to the depth."""
BENT = 0.1
"""Relative error of guessed depth that changes slowly over the picture."""
SOFT = 0.02
"""Standard deviation of the blur of guessed depth, in picture sides: outlines are what such models miss."""
STEP, SCALED = (0.01, 0.04), 0.15
"""How far an object is misplaced, in picture sides, and the largest logarithm of the scale of one that is scaled."""
NEAREST = 1e-3


@dataclass(frozen=True)
class Placement:
    """Where an object is pasted: moved by (right, down) picture sides, scaled about the lowest point that is seen."""

    right: float = 0.0
    down: float = 0.0
    scale: float = 1.0


def draw_placement(rng: np.random.Generator, fault: Fault | None) -> Placement | None:
    """Draw how an object stands wrongly; None where it does not."""
    if fault == "misplaced":
        angle, length = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*STEP)
        return Placement(float(length * np.cos(angle)), float(length * np.sin(angle)))
    if fault == "scaled":
        return Placement(scale=float(np.exp(rng.uniform(-SCALED, SCALED))))
    return None


def wrong_depth(depth: Tensor, fault: Fault, rng: np.random.Generator) -> Tensor:
    """Return relative depth, (1, S, S) in [0, 1] and 1 where nothing is, as a source with that fault gives it.

    `no depth`: nothing is known; `depth with holes`: a fifth is not; `affine depth`: up to an unknown offset;
    `noisy depth`; `guessed depth`: as of a model that sees one picture, which errs slowly over the picture in the
    inverse depth and blurs outlines. Other faults leave it as it is.
    """
    if fault == "no depth":
        return torch.ones_like(depth)
    if fault == "depth with holes":
        noise = _smooth(rng, depth.shape[-1], 8)
        return torch.where(noise < noise.flatten().quantile(HOLES), torch.ones_like(depth), depth)
    known = depth < 1.0
    if not known.any() or fault not in ("affine depth", "noisy depth", "guessed depth"):
        return depth
    near, far = float(depth[known].min()), float(depth[known].max())
    if fault == "affine depth":
        wrong = depth + float(rng.uniform(-SHIFT * near, SHIFT * far))
    elif fault == "noisy depth":
        amount = float(np.exp(rng.uniform(*np.log(NOISE))))
        wrong = depth * torch.exp(amount * torch.from_numpy(rng.standard_normal(depth.shape).astype(np.float32)))
    else:
        sigma, inverse = SOFT * depth.shape[-1], 1.0 / depth.clamp(min=NEAREST)
        inverse = (blur(inverse[None], sigma) / blur(torch.ones_like(inverse)[None], sigma))[0]
        wrong = 1.0 / (inverse * torch.exp(BENT * _smooth(rng, depth.shape[-1], 4)))
    wrong = wrong.clamp(min=NEAREST)
    return torch.where(known, wrong / (wrong[known].max() * 1.0001), depth)


def _smooth(rng: np.random.Generator, side: int, cells: int) -> Tensor:
    """Draw noise of about unit variance that changes over `cells` a side: (1, side, side)."""
    coarse = torch.from_numpy(rng.standard_normal((1, 1, cells, cells)).astype(np.float32))
    return functional.interpolate(coarse, size=(side, side), mode="bicubic", align_corners=True)[0]


def misplaced_tuple(
    view: PackedView, name: str, place: Placement, *, insert: Float32, base: Float32, camera: CameraResponse, own: Mask
) -> Pictures:
    """Mix the tuple of an object that is pasted elsewhere, as `mixing.mix_tuple` does of one in its place.

    The object and its coverage are moved, under either lighting; shadows and reflections stay where the object truly
    casts them, and where it truly stands and is not pasted the background is seen. `insert` and `base` are (L, 3).
    """

    def mixed(variant: str, gains: Float32) -> Tensor:  # (3, H, W) linear
        return torch.from_numpy(np.einsum("lhwc,lc->chw", view.variant(variant).astype(np.float32), gains))

    insert, base = insert * camera.gain, base * camera.gain
    coverage = torch.from_numpy(view.object_coverage(name).astype(np.float32))[None]
    whole, behind = mixed(ALL, base), mixed(Variant.without(name), base)
    came, true = (mixed(Variant.foreground(name), gains) for gains in (insert, base))
    around = whole - true + coverage * behind
    glow = coverage * fraction(mixed(Variant.foreground(name), insert * own[:, None]), came)
    moved = _moved(torch.cat((coverage, glow, came, true)), coverage, place)
    alpha, glow, came, true = moved.split((1, 1, 3, 3))
    composite, target = (paste + ground * (1.0 - alpha) for paste, ground in ((came, behind), (true, around)))
    return Pictures(develop(composite, camera), develop(behind, camera), develop(target, camera), alpha, glow)


def _moved(layers: Tensor, coverage: Tensor, place: Placement) -> Tensor:
    """Move premultiplied layers (C, H, W); nothing comes from beyond the border."""
    height, width = coverage.shape[-2:]
    rows, columns = (coverage[0] > 0.0).nonzero(as_tuple=True)
    if not len(rows):
        return layers
    lowest = int(rows.argmax())
    x, y = float(columns[lowest]) + 0.5, float(rows[lowest]) + 0.5  # what stays in its place when scaled
    side = min(height, width)
    across = (torch.arange(width) + 0.5 - x - place.right * side) / place.scale + x
    down = (torch.arange(height) + 0.5 - y - place.down * side) / place.scale + y
    grid = torch.stack(torch.meshgrid(2 * across / width - 1, 2 * down / height - 1, indexing="xy"), dim=-1)
    return functional.grid_sample(layers[None], grid[None], align_corners=False)[0]
