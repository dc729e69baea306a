"""The tuple of a packed view under two lightings, in torch: mixed, tone-mapped, display-encoded."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from datagen.layers import Float32
from datagen.packed import SAME, TILE, PackedView
from model.augment import Camera, respond


@dataclass(frozen=True)
class Pictures:
    """Display-encoded composite, background and target in [0, 1], (3, H, W), and coverage, (1, H, W); float32."""

    composite: Tensor
    background: Tensor
    target: Tensor
    mask: Tensor


SHOULDER, FADE = 0.6, 0.15  # as in `lights.tonemap.tone_curve`
KNEE = 0.0031308  # sRGB is linear below (IEC 61966-2-1)


def mix_tuple(view: PackedView, name: str, *, insert: Float32, base: Float32, camera: Camera) -> Pictures:
    """Mix the tuple of object `name`; `insert` and `base` are (L, 3) linear gains.

    As `datagen.compose` does, but the background is worked out only in tiles where it differs from the target, the
    composite only in those where the object covers something.
    """
    number, lights = view.objects.index(name), _Layers(view)
    insert, base = insert * camera.gain, base * camera.gain
    target, coverage = lights.mixed(base), view.coverage[number]
    changed = np.flatnonzero((view.without[number][base.any(axis=1)] != SAME).any(axis=0))
    covered = np.flatnonzero(coverage)
    behind = lights.mixed_tiles(view.without[number], base, changed)
    alpha = torch.from_numpy(view.alpha[coverage[covered]]).float().unsqueeze(1)
    pasted = lights.pick(target, covered)
    _, here, there = np.intersect1d(covered, changed, assume_unique=True, return_indices=True)
    pasted[torch.from_numpy(here)] = behind[torch.from_numpy(there)]
    pasted.mul_(1.0 - alpha).add_(lights.mixed_tiles(view.foreground[number], insert, covered))

    shown = develop(target, camera)
    background = lights.put(shown.clone(), changed, develop(behind, camera))
    composite = lights.put(background.clone(), covered, develop(pasted, camera))
    mask = lights.put(torch.zeros(1, *shown.shape[1:]), covered, alpha)
    height, width = view.z_depth.shape
    return Pictures(*(picture[:, :height, :width] for picture in (composite, background, shown, mask)))


def develop(radiance: Tensor, camera: Camera) -> Tensor:
    """Turn linear radiance (..., 3, h, w) into display values in [0, 1], in place: tone, sRGB and response curve.

    The curves are `lights.tonemap.tone_curve` and `srgb_encode`, without branches: at the shoulder the first is the
    identity, and below the knee what is missing to it is added to the value there.
    """
    rgb = radiance.clamp_min_(0.0)
    peak = rgb.amax(dim=-3, keepdim=True).clamp_min_(SHOULDER)
    room = 1.0 - SHOULDER
    new_peak = 1.0 - room**2 / (peak + (room - SHOULDER))
    kept = 1.0 / (FADE * (peak - new_peak) + 1.0)
    rgb.mul_(new_peak / peak * kept).add_(new_peak * (1.0 - kept))
    below = rgb.clamp_max(KNEE).sub_(KNEE).mul_(12.92)
    # log and exp are vectorized in torch, pow is not: half the time.
    rgb.clamp_min_(KNEE).log_().mul_(1 / 2.4).add_(math.log(1.055)).exp_().sub_(0.055).add_(below)
    return respond(rgb, camera).clamp_(0.0, 1.0)


class _Layers:
    """A view's layers as tensors that share its memory."""

    def __init__(self, view: PackedView) -> None:
        self._all, self._pool = torch.from_numpy(view.all), torch.from_numpy(view.tiles)
        self._columns = self._all.shape[-1] // TILE

    def mixed(self, gains: Float32) -> Tensor:
        """Mix `all`: (3, Y, X)."""
        total, layer = torch.zeros(self._all.shape[1:]), torch.empty(self._all.shape[1:])
        for light in np.flatnonzero(gains.any(axis=1)):
            total.addcmul_(layer.copy_(self._all[light]), torch.from_numpy(gains[light]).view(3, 1, 1))
        return total

    def mixed_tiles(self, numbers: NDArray[np.int32], gains: Float32, tiles: NDArray[np.int64]) -> Tensor:
        """Mix some tiles of the variant whose table is `numbers` (L, T): (len(tiles), 3, 16, 16)."""
        total = torch.zeros(len(tiles), 3, TILE, TILE)
        for light in np.flatnonzero(gains.any(axis=1)):
            own = numbers[light, tiles]
            layer = self.pick(self._all[light], tiles)
            kept = np.flatnonzero(own != SAME)
            layer[torch.from_numpy(kept)] = self._pool.index_select(0, torch.from_numpy(own[kept]))
            total.addcmul_(layer.float(), torch.from_numpy(gains[light]).view(3, 1, 1))
        return total

    def pick(self, picture: Tensor, tiles: NDArray[np.int64]) -> Tensor:
        """Copy some tiles of (C, Y, X): (len(tiles), C, 16, 16)."""
        return self._grid(picture)[self._places(tiles)]

    def put(self, picture: Tensor, tiles: NDArray[np.int64], values: Tensor) -> Tensor:
        """Replace some tiles of (C, Y, X) in place."""
        self._grid(picture)[self._places(tiles)] = values
        return picture

    def _grid(self, picture: Tensor) -> Tensor:
        return picture.view(picture.shape[0], -1, TILE, self._columns, TILE).permute(1, 3, 0, 2, 4)

    def _places(self, tiles: NDArray[np.int64]) -> tuple[Tensor, Tensor]:
        rows, columns = np.divmod(tiles, self._columns)
        return torch.from_numpy(rows), torch.from_numpy(columns)
