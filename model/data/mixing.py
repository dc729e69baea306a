"""The tuple of a packed view under two lightings, in torch: mixed, tone-mapped, display-encoded."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from multilight.datagen.storage.packed import SAME, TILE, PackedView
from multilight.model.data.augment import CameraResponse, respond
from multilight.scenes.arrays import Float32, Int64, Mask
from multilight.scenes.colour import srgb_encode


@dataclass(frozen=True)
class Pictures:
    """Display-encoded composite, background and target in [0, 1], (3, H, W), and coverage, (1, H, W); float32.

    `glow` (1, H, W) is the fraction of the object's light in the composite that is its own, times coverage.
    """

    composite: Tensor
    background: Tensor
    target: Tensor
    mask: Tensor
    glow: Tensor


UNPAINTED = np.ones(3, np.float32)
SHOULDER, FADE = 0.6, 0.15  # as in `lights.display.tonemap.tone_curve`
STEPS = 1 << 14  # of the square root of radiance, in the table of display values


def mix_tuple(
    view: PackedView,
    name: str,
    *,
    insert: Float32,
    base: Float32,
    camera: CameraResponse,
    own: Mask,
    paint: Float32 = UNPAINTED,
) -> Pictures:
    """Mix the tuple of object `name`; `insert` and `base` are (L, 3) linear gains.

    As `datagen.tuples.compose` does, but the background is worked out only in tiles where it differs from the target,
    the composite only in those where the object covers something. The object's light is multiplied by `paint` (3,)
    under either lighting; what its surroundings reflect of it is not. `own` (L,) are the lights that it has itself.
    """
    number, layers = view.objects.index(name), _Layers(view)
    insert, base = insert * camera.gain, base * camera.gain
    target, coverage = layers.mixed(base), view.coverage[number]
    changed = np.flatnonzero((view.without[number][base.any(axis=1)] != SAME).any(axis=0))
    covered = np.flatnonzero(coverage)
    behind = layers.mixed_tiles(view.without[number], base, changed)
    alpha = torch.from_numpy(view.alpha[coverage[covered]]).float().unsqueeze(1)
    pasted = target[torch.from_numpy(covered)]
    _, here, there = np.intersect1d(covered, changed, assume_unique=True, return_indices=True)
    pasted[torch.from_numpy(here)] = behind[torch.from_numpy(there)]
    foreground = layers.mixed_tiles(view.foreground[number], insert * paint, covered)
    pasted.mul_(1.0 - alpha).add_(foreground)
    if (paint != 1.0).any():
        repainted = layers.mixed_tiles(view.foreground[number], base * (paint - 1.0), covered)
        target.index_add_(0, torch.from_numpy(covered), repainted)

    shown, parts = develop(target, camera), develop(torch.cat((behind, pasted)), camera)
    background = shown.index_copy(0, torch.from_numpy(changed), parts[: len(changed)])
    composite = background.index_copy(0, torch.from_numpy(covered), parts[len(changed) :])
    nothing = torch.zeros_like(shown[:, :1])
    mask = nothing.index_copy(0, torch.from_numpy(covered), alpha)
    glow = nothing
    if (insert[own] > 0.0).any():
        glowing = layers.mixed_tiles(view.foreground[number], insert * own[:, None] * paint, covered)
        glow = nothing.index_copy(0, torch.from_numpy(covered), alpha * fraction(glowing, foreground))
    return Pictures(*(_joined(tiles, view.z_depth.shape) for tiles in (composite, background, shown, mask, glow)))


def fraction(part: Tensor, whole: Tensor) -> Tensor:
    """Return the fraction of the light (..., 3, h, w) that is a part of it: (..., 1, h, w) in [0, 1]."""
    part, whole = (light.sum(dim=-3, keepdim=True) for light in (part, whole))
    return (part / whole.clamp(min=1e-6)).clamp(0.0, 1.0)


def develop(radiance: Tensor, camera: CameraResponse) -> Tensor:
    """Turn linear radiance (..., 3, h, w) into display values in [0, 1]: tone, sRGB and response curve.

    The curves are `lights.display.tonemap.tone_curve`, without branches (at the shoulder it is the identity), and
    `srgb_encode`, from a table: within 5e-5, a hundredth of an 8-bit step. What is not a number stays none.
    `radiance` is overwritten.
    """
    rgb = radiance.clamp_min_(0.0)
    peak = rgb.amax(dim=-3, keepdim=True).clamp_min_(SHOULDER)
    room = 1.0 - SHOULDER
    new_peak = 1.0 - room**2 / (peak + (room - SHOULDER))
    kept = 1.0 / (FADE * (peak - new_peak) + 1.0)
    rgb.mul_(new_peak / peak * kept).add_(new_peak * (1.0 - kept))
    # Even steps of the root are nearly even steps of the display value.
    places = rgb.sqrt_().mul_(STEPS).add_(1.5).to(torch.int32).clamp_min_(0)
    return respond(encoded().index_select(0, places.view(-1)).view_as(rgb), camera).clamp_(0.0, 1.0)


@cache
def encoded() -> Tensor:
    """Return what `develop` looks up: NaN, then `srgb_encode` of (i / STEPS)² for i = 0 … STEPS, float32."""
    with torch.inference_mode(False):  # kept, whoever is the first to ask
        roots = np.arange(STEPS + 1) / STEPS
        return torch.from_numpy(np.concatenate([[np.nan], srgb_encode(roots**2)]).astype(np.float32))


class _Layers:
    """A view's layers as tensors that share its memory."""

    def __init__(self, view: PackedView) -> None:
        self._all, self._pool = torch.from_numpy(view.all), torch.from_numpy(view.tiles)

    def mixed(self, gains: Float32) -> Tensor:
        """Mix `all`: (T, 3, 16, 16)."""
        total, layer = torch.zeros(self._all.shape[1:]), torch.empty(self._all.shape[1:])
        for light in np.flatnonzero(gains.any(axis=1)):
            total.addcmul_(layer.copy_(self._all[light]), torch.from_numpy(gains[light]).view(3, 1, 1))
        return total

    def mixed_tiles(self, numbers: NDArray[np.int32], gains: Float32, tiles: Int64) -> Tensor:
        """Mix some tiles of the variant whose table is `numbers` (L, T): (len(tiles), 3, 16, 16)."""
        total = torch.zeros(len(tiles), 3, TILE, TILE)
        for light in np.flatnonzero(gains.any(axis=1)):
            own = numbers[light, tiles]
            layer = self._all[light].index_select(0, torch.from_numpy(tiles))
            kept = np.flatnonzero(own != SAME)
            layer.index_copy_(0, torch.from_numpy(kept), self._pool.index_select(0, torch.from_numpy(own[kept])))
            total.addcmul_(layer.float(), torch.from_numpy(gains[light]).view(3, 1, 1))
        return total


def _joined(tiles: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Put tiles (T, C, 16, 16) together: (C, H, W)."""
    height, width = shape
    grid = tiles.view(-1, -(-width // TILE), *tiles.shape[1:]).permute(2, 0, 3, 1, 4)
    return grid.reshape(len(grid), TILE * grid.shape[1], -1)[:, :height, :width]
