"""Gaussians refined on pictures of their scene: gradient descent through the splatting of `scenes.gaussians.splatting`.

Which Gaussians meet which pixels, and in what order, is listed by NumPy and renewed now and then; what each covers and
what passes it is torch's. Centres stay: they lie on the true depth, moving them was worth 0.1 to 0.2 dB on views not
refined on. So a Gaussian keeps its place on the curve, its cell and the pixel that it came from.

After Kerbl et al., "3D Gaussian Splatting" (2023): one view an iteration, Adam, L1, the logarithms of the scales, the
logits of the opacities, and the rates of all but the colours; none is split, added or removed.
Shape letters: V views, H W pixels, N Gaussians, M of them seen, P pairs of one with a pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from multilight.model.gaussians.splat_scene import SplatScene, reshaped
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.cameras.pinhole import opencv_from_opengl
from multilight.scenes.gaussians.from_views import Gaussians
from multilight.scenes.gaussians.splatting import CAP, LOW_PASS, blended_pairs
from multilight.scenes.spec import Camera

RATES = {"quats": 1e-3, "logs": 5e-3, "logits": 5e-2, "colors": 1e-3}
"""Adam's rates. Colours start as the views' mean, so they need less than the published 2.5e-3."""
RENEW = 50
"""Iterations after which a view's list of pairs is made anew."""
LOGIT_MARGIN = 1e-6  # the logit of 1 is infinite
SMALLEST = 1e-7  # metres; the logarithm of 0 is infinite


@dataclass(frozen=True)
class Parameters:
    """Gaussians as numbers without bounds: means (N, 3), quats (N, 4) wxyz of any length, logarithms of the scales
    (N, 3), logits of the opacities (N,), colors (N, 3).
    """

    means: Tensor
    quats: Tensor
    logs: Tensor
    logits: Tensor
    colors: Tensor

    @classmethod
    def of(cls, gaussians: Gaussians, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> Self:
        """Take Gaussians' numbers; opacities are held within 1e-6 of 0 and 1."""
        means, quats, scales, opacities, colors = (
            torch.tensor(each, dtype=torch.float64)
            for each in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors)
        )
        made = (means, quats, scales.clamp(min=SMALLEST).log(), torch.logit(opacities, eps=LOGIT_MARGIN), colors)
        return cls(*(each.to(device, dtype) for each in made))

    def gaussians(self) -> Gaussians:
        """Return the Gaussians, float32."""
        return Gaussians(
            means=_numpy(self.means),
            quats=_numpy(functional.normalize(self.quats, dim=1)),
            scales=_numpy(self.logs.exp()),
            opacities=_numpy(self.logits.sigmoid()),
            colors=_numpy(self.colors),
        )


@dataclass(frozen=True)
class Pairs:
    """What a view is blended from, pixel by pixel, front to back.

    numbers (M,) the Gaussians seen; places (P,) which of those; pixels (P,) flat; first (P,) the place in this list of
    the same pixel's foremost.
    """

    numbers: Tensor = field(repr=False)
    places: Tensor = field(repr=False)
    pixels: Tensor = field(repr=False)
    first: Tensor = field(repr=False)

    @classmethod
    def of(cls, camera: Camera, gaussians: Gaussians, device: torch.device | str = "cpu") -> Self:
        """List the pairs whose weight counts."""
        found, pixels, _ = blended_pairs(camera, gaussians)
        numbers, places = np.unique(found, return_inverse=True)
        starts = np.flatnonzero(np.diff(pixels, prepend=-1))
        first = np.repeat(starts, np.diff(np.append(starts, len(pixels))))
        return cls(*(torch.from_numpy(each.astype(np.int64)).to(device) for each in (numbers, places, pixels, first)))


def refined_scene(
    scene: SplatScene,
    cameras: Sequence[Camera],
    pictures: Float32,
    z_depths: Float32,
    *,
    steps: int,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> SplatScene:
    """Refine a scene's Gaussians on its views, and work out the matrix anew; cells and sources stay.

    pictures (V, H, W, 3) show what the Gaussians lie on, in [0, 1]; z_depths (V, H, W) [m], 0 where nothing is.
    """
    colors = scene.carry(torch.from_numpy(pictures).permute(0, 3, 1, 2).to(scene.matrix.device))
    start = replace(scene.gaussians.gaussians, colors=colors.cpu().numpy())
    made = refine(start, cameras, pictures, z_depths > 0, steps=steps, seed=seed, device=device)
    return reshaped(scene, cameras, made)


def refine(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    pictures: Float32,
    seen: Mask,
    *,
    steps: int,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> Gaussians:
    """Fit shapes, opacities and colours to V pictures by `steps` iterations; centres and order stay.

    pictures (V, H, W, 3) in [0, 1]; where `seen` (V, H, W) is False nothing should lie: there, coverage is held down.
    The same seed gives the same Gaussians, on a CPU bit by bit. Raises `ValueError` where shapes disagree.
    """
    size = (len(cameras), cameras[0].height, cameras[0].width)
    if pictures.shape != (*size, 3) or seen.shape != size:
        raise ValueError(f"cameras of {size}, pictures of shape {pictures.shape} and `seen` of shape {seen.shape}")
    truth = np.concatenate((pictures, np.ones_like(pictures[..., :1])), axis=-1) * seen[..., None]
    truths = torch.from_numpy(truth.astype(np.float32)).to(device)
    parameters = Parameters.of(gaussians, device)
    leaves = [{"params": [getattr(parameters, name).requires_grad_()], "lr": rate} for name, rate in RATES.items()]
    # Adam's own 1e-8 would drown the gradients of Gaussians of a pixel's size: their loss is a mean over all pixels.
    optimizer = torch.optim.Adam(leaves, eps=1e-15)
    listed: dict[int, tuple[int, Pairs]] = {}
    for step, view in enumerate(_visits(len(cameras), steps, seed)):
        if view not in listed or step - listed[view][0] >= RENEW:
            listed[view] = step, Pairs.of(cameras[view], parameters.gaussians(), device)
        loss = (render(cameras[view], parameters, listed[view][1]) - truths[view]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return parameters.gaussians()


def _visits(views: int, steps: int, seed: int) -> list[int]:
    """Say which view each iteration takes: all of them in every round, each round in an order of its own."""
    rng = np.random.default_rng(seed)
    rounds = [rng.permutation(views) for _ in range(-(-steps // views))]
    return np.concatenate([np.empty(0, np.int64), *rounds])[:steps].tolist()


def render(camera: Camera, parameters: Parameters, pairs: Pairs) -> Tensor:
    """Splat over black as `scenes.gaussians.splatting` does, differentiably: colours and coverage, (H, W, 4)."""
    centres, inverses = _footprints(camera, parameters, pairs.numbers)
    opacities = parameters.logits[pairs.numbers, None].sigmoid()
    x, y, xx, xy, yy, opacity = torch.cat((centres, inverses, opacities), dim=1)[pairs.places].unbind(1)
    dx = (pairs.pixels % camera.width).to(x.dtype) + 0.5 - x
    dy = (pairs.pixels // camera.width).to(y.dtype) + 0.5 - y
    alphas = (opacity * torch.exp(-0.5 * (xx * dx**2 + 2.0 * xy * dx * dy + yy * dy**2))).clamp(max=CAP)
    # Summed over all pixels: only double precision leaves the differences within one pixel whole.
    logs = torch.log1p(-alphas).double()
    before = logs.cumsum(0) - logs
    weights = alphas * torch.exp(before - before[pairs.first]).to(alphas.dtype)
    colors = torch.cat((parameters.colors, torch.ones_like(parameters.colors[:, :1])), dim=1)[pairs.numbers]
    flat = torch.zeros(camera.height * camera.width, 4, dtype=weights.dtype, device=weights.device)
    flat = flat.index_add(0, pairs.pixels, weights[:, None] * colors[pairs.places])
    return flat.reshape(camera.height, camera.width, 4)


def _footprints(camera: Camera, parameters: Parameters, numbers: Tensor) -> tuple[Tensor, Tensor]:
    """Project: centres (M, 2) in pixels and inverse covariances (M, 3) (xx, xy, yy), low-pass included."""
    # Camera axes as pixels run: x to the right, y down, z ahead.
    pose = opencv_from_opengl(camera.pose())
    axes, eye = parameters.means.new_tensor(pose[:3, :3]), parameters.means.new_tensor(pose[:3, 3])
    focal = parameters.means.new_tensor((camera.fx, camera.fy))
    principal = parameters.means.new_tensor((camera.cx, camera.cy))
    size = parameters.means.new_tensor((camera.width, camera.height))
    points = (parameters.means[numbers] - eye) @ axes
    depths = points[:, 2:]
    slopes = points[:, :2] / depths
    spread = axes.T @ _rotations(parameters.quats[numbers]) * parameters.logs[numbers].exp()[:, None, :]
    limit = 1.3 * 0.5 * size / focal
    held = slopes.clamp(-limit, limit)
    u, v = ((spread[:, :2] - held[:, :, None] * spread[:, 2:]) * (focal / depths)[:, :, None]).unbind(1)
    xx, xy, yy = ((a * b).sum(1) for a, b in ((u, u), (u, v), (v, v)))
    xx, yy = xx + LOW_PASS, yy + LOW_PASS
    determinant = (xx * yy - xy**2).clamp(min=1e-12)
    return slopes * focal + principal, torch.stack((yy, -xy, xx), dim=1) / determinant[:, None]


def _rotations(quats: Tensor) -> Tensor:
    """Convert quaternions (M, 4) wxyz of any length to rotation matrices (M, 3, 3)."""
    w, x, y, z = functional.normalize(quats, dim=1).unbind(1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)


def _numpy(values: Tensor) -> Float32:
    return np.asarray(values.detach().float().cpu().numpy())
