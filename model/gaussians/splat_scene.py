"""A captured scene as Gaussians of fixed geometry: colours carried there from views, and rendered back.

What a Gaussian adds to a pixel never changes, so rendering is a sparse matrix product, and so is carrying colours from
views to Gaussians (the transposed matrix, normalised). `scenes.gaussians.splatting` works the matrix out, once a scene.

Shape letters: V views, H W pixels, N Gaussians, S map cells a side (N = S * S).
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, vstack
from torch import Tensor

from multilight.model.configs.stage3d import Order
from multilight.scenes.arrays import Int64
from multilight.scenes.gaussians.curves import box_cells, morton_index
from multilight.scenes.gaussians.from_views import Gaussians, SceneGaussians, gaussians_from_views
from multilight.scenes.gaussians.splatting import blending_weights
from multilight.scenes.spec import Camera

UNSEEN = 1e-3
"""Weight, summed over pixels, below which a Gaussian counts as unseen."""


class _Product(torch.autograd.Function):
    """Multiply by a constant sparse matrix; the gradient is the product with its transpose."""

    @staticmethod
    def forward(ctx: Any, matrix: Tensor, transposed: Tensor, x: Tensor) -> Tensor:
        ctx.transposed = transposed
        return matrix @ x

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, None, Tensor]:
        return None, None, ctx.transposed @ gradient.contiguous()


@dataclass(frozen=True)
class SplatScene:
    """Gaussians seen by V views of H x W pixels.

    matrix (V * H * W, N) and its transpose (N, V * H * W), sparse float32: what each Gaussian adds to each pixel;
    cells (N,) int64 the Gaussians' places on the map, row-major; sources (N,) int64 the pixel, over all views, that
    each came from; `gaussians` in the order of all these.
    """

    views: int
    height: int
    width: int
    matrix: Tensor = field(repr=False)
    transposed: Tensor = field(repr=False)
    cells: Tensor = field(repr=False)
    sources: Tensor = field(repr=False)
    gaussians: SceneGaussians = field(repr=False)

    def render(self, colors: Tensor) -> Tensor:
        """Render colours (N, C) to all views, over black: (V, C, H, W)."""
        flat = _Product.apply(self.matrix, self.transposed, colors)
        return flat.reshape(self.views, self.height, self.width, -1).permute(0, 3, 1, 2)

    def gather(self, images: Tensor) -> Tensor:
        """Take each Gaussian's colour from the one pixel it came from: (V, C, H, W) → (N, C)."""
        return _flat(images)[self.sources]

    def carry(self, images: Tensor) -> Tensor:
        """Average the colours of all pixels, of all views, that show a Gaussian: (V, C, H, W) → (N, C).

        One that no view shows takes the colour of the pixel it came from.
        """
        values = _flat(images)
        sums = _Product.apply(self.transposed, self.matrix, _with_ones(values))
        weight = sums[:, -1:]
        return torch.where(weight > UNSEEN, sums[:, :-1] / weight.clamp(min=UNSEEN), values[self.sources])

    def smooth(self, images: Tensor) -> Tensor:
        """Show each view at the resolution of its Gaussians: carried there from this view alone, and rendered.

        (V, C, H, W) → (V, C, H, W), divided by the coverage.
        """
        values = _with_ones(_flat(images)).unflatten(0, (self.views, -1))  # (V, P, C + 1)
        each = torch.arange(self.views, device=values.device)
        blocks = values.new_zeros(*values.shape[:2], self.views, values.shape[2])
        blocks[each, :, each] = values
        sums = (self.transposed @ blocks.reshape(len(self.matrix), -1)).unflatten(1, (self.views, -1))  # (N, V, C + 1)
        carried = sums[..., :-1] / sums[..., -1:].clamp(min=UNSEEN)
        both = torch.cat((carried, (sums[..., -1:] > UNSEEN).to(values.dtype)), dim=-1)
        rendered = (self.matrix @ both.flatten(1)).unflatten(1, (self.views, -1)).unflatten(0, (self.views, -1))
        own = rendered[each, :, each]  # (V, P, C + 1)
        shown = own[..., :-1] / own[..., -1:].clamp(min=UNSEEN)
        return shown.reshape(self.views, self.height, self.width, -1).permute(0, 3, 1, 2)

    def covered(self) -> Tensor:
        """Return the fraction of each pixel that Gaussians cover, (V, 1, H, W)."""
        return self.render(torch.ones(self.matrix.shape[1], 1, device=self.matrix.device))

    def to_map(self, colors: Tensor) -> Tensor:
        """Fold colours (N, C) onto the map: (1, C, S, S)."""
        side = self.gaussians.side
        folded = torch.empty_like(colors).index_copy(0, self.cells, colors)
        return folded.reshape(1, side, side, -1).permute(0, 3, 1, 2)

    def from_map(self, folded: Tensor) -> Tensor:
        """Undo `to_map`: (1, C, S, S) → (N, C)."""
        return folded[0].permute(1, 2, 0).reshape(len(self.cells), -1)[self.cells]

    def to(self, device: torch.device) -> "SplatScene":
        """Move the tensors to a device."""
        names = ("matrix", "transposed", "cells", "sources")
        return replace(self, **{name: getattr(self, name).to(device) for name in names})


def splat_scene(
    cameras: Sequence[Camera], z_depths: NDArray[np.floating], *, side: int, order: Order = "hilbert"
) -> SplatScene:
    """Put side * side Gaussians on what V views see, and work out the matrix.

    z_depths (V, H, W) metres, 0 where nothing. `order` is that of the Gaussians on the map.
    Raises `ValueError` where nothing is seen, or `side` is not a power of two.
    """
    laid = gaussians_from_views(cameras, z_depths, np.zeros(z_depths.shape, np.int64), [], side=side)
    matrix, transposed = _matrices(cameras, laid.gaussians)
    height, width = z_depths.shape[1:]
    cells = laid.cells @ [side, 1]
    if (first := map_order(laid.gaussians.means, order)) is not None:
        cells = cells[np.argsort(first)]
    return SplatScene(
        views=len(cameras),
        height=height,
        width=width,
        matrix=matrix,
        transposed=transposed,
        cells=torch.from_numpy(cells),
        sources=torch.from_numpy(laid.sources.astype(np.int64) @ [height * width, 1]),
        gaussians=laid,
    )


def reshaped(scene: SplatScene, cameras: Sequence[Camera], gaussians: Gaussians) -> SplatScene:
    """Give a scene's Gaussians, in their order, other shapes and opacities; their places on the map stay."""
    matrix, transposed = (each.to(scene.matrix.device) for each in _matrices(cameras, gaussians))
    return replace(scene, matrix=matrix, transposed=transposed, gaussians=replace(scene.gaussians, gaussians=gaussians))


def map_order(means: NDArray[np.floating], order: Order) -> Int64 | None:
    """Return which Gaussian comes first on the map, which next, (N,); None for the Hilbert curve, as they lie.

    Z-order is Morton's curve over the same cells; an arbitrary order is a fixed random one.
    """
    match order:
        case "hilbert":
            return None
        case "morton":
            return np.argsort(morton_index(box_cells(means, 10), 10), kind="stable")
        case "arbitrary":
            return np.random.default_rng(0).permutation(len(means))


def _matrices(cameras: Sequence[Camera], gaussians: Gaussians) -> tuple[Tensor, Tensor]:
    """Return what each Gaussian adds to each pixel of all views, and the transpose."""
    matrix = vstack([blending_weights(camera, gaussians) for camera in cameras], format="csr")
    return _sparse(matrix), _sparse(matrix.T.tocsr())


def _flat(images: Tensor) -> Tensor:
    return images.permute(0, 2, 3, 1).reshape(-1, images.shape[1])


def _with_ones(values: Tensor) -> Tensor:
    return torch.cat((values, torch.ones_like(values[:, :1])), dim=1)


def _sparse(matrix: csr_matrix) -> Tensor:
    matrix.sort_indices()
    with warnings.catch_warnings():  # torch calls its CSR tensors a beta; their product is all that is used
        warnings.simplefilter("ignore")
        return torch.sparse_csr_tensor(
            torch.from_numpy(matrix.indptr.astype(np.int32)),
            torch.from_numpy(matrix.indices.astype(np.int32)),
            torch.from_numpy(matrix.data.astype(np.float32)),
            size=matrix.shape,
        )
