"""The 3D stage without a map: a plain transformer over clusters of Gaussians; and what a Gaussian knows of itself.

What the map and its windows are compared with: every cluster of `MEMBERS` Gaussians is a token, all tokens attend to
all, and where a token lies in space is said by sines and cosines of its centre (Vaswani et al. 2017; as in NeRF,
Mildenhall et al. 2020). No curve and no map is involved: clusters are the leaves of a k-d tree over the scene.

Shape letters: N Gaussians, T tokens, M members of a token, C channels.
"""

import numpy as np
import torch
from torch import Tensor, nn

from multilight.model.configs.stage3d import SceneNetworkConfig
from multilight.model.gaussians.splat_scene import SplatScene

MEMBERS = 16
"""Gaussians a token."""
OCTAVES = 8
"""Frequencies of the encoding of a token's place: pi, 2 pi, 4 pi, ..., over the scene's longest side."""
FEATURES = 6
"""Channels of `point_features`."""


class PointTransformer(nn.Module):
    """Inharmonious and carried colours of the Gaussians to harmonized ones, by global attention between clusters.

    As many layers as the network on the map has blocks, half as wide again; the layers' inner width is chosen so that
    there are about `parameters` parameters.
    """

    def __init__(self, config: SceneNetworkConfig, parameters: int) -> None:
        super().__init__()
        self.config = config
        width, layers = config.width * 3 // 2 // config.heads * config.heads, config.groups * config.blocks
        self.embed = nn.Linear(MEMBERS * (6 + 3), width)  # colours and offset from the centre
        self.place = nn.Linear(6 * OCTAVES, width)
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, 3 * MEMBERS)
        for parameter in self.head.parameters():  # an untrained network returns the carried colours
            nn.init.zeros_(parameter)
        left = (parameters - sum(p.numel() for p in self.parameters())) / layers
        inner = max(1, round((left - (4 * width**2 + 9 * width)) / (2 * width + 1)))
        self.layers = nn.Sequential()
        for _ in range(layers):
            self.layers.append(
                nn.TransformerEncoderLayer(width, config.heads, inner, 0.0, "gelu", batch_first=True, norm_first=True)
            )

    def forward(self, composite: Tensor, carried: Tensor, means: Tensor) -> Tensor:
        """Harmonize colours (N, 3) twice, display-encoded, of Gaussians at `means` (N, 3) metres → (N, 3).

        N is `MEMBERS` times a power of two. In training the result is not clipped.
        """
        groups = clusters(means)  # (T, M)
        places = in_box(means)[groups]  # (T, M, 3)
        centres = places.mean(dim=1)
        offsets = (places - centres[:, None]) * len(groups) ** 0.5  # on a surface a token is about that much smaller
        members = torch.cat((composite[groups], carried[groups], offsets), dim=-1)
        x = self.embed(members.flatten(1)) + self.place(positional_encoding(centres))  # (T, C)
        change = self.head(self.norm(self.layers(x[None])[0])).reshape(-1, 3)
        image = carried.index_add(0, groups.flatten(), change)
        return image if self.training else image.clamp(0.0, 1.0)

    def colors(self, scene: SplatScene, composite: Tensor, carried: Tensor) -> Tensor:
        """Harmonize colours of the scene's Gaussians: (N, 3) twice, display-encoded → (N, 3)."""
        means = torch.from_numpy(scene.gaussians.gaussians.means).to(carried.device)
        found: Tensor = self(composite, carried, means)
        return found


def clusters(means: Tensor) -> Tensor:
    """Group points that lie together, `MEMBERS` at a time: (N, 3) → their numbers (N / MEMBERS, MEMBERS) int64.

    A balanced k-d tree: every group is halved at the median of its longest side until it is small enough.
    """
    groups = torch.arange(len(means), device=means.device)[None]
    while groups.shape[1] > MEMBERS:
        points = means[groups]  # (G, n, 3)
        longest = (points.amax(dim=1) - points.amin(dim=1)).argmax(dim=1)
        along = points.gather(2, longest[:, None, None].expand(-1, points.shape[1], 1))[..., 0]
        groups = groups.gather(1, along.argsort(dim=1, stable=True)).reshape(2 * len(groups), -1)
    return groups


def in_box(means: Tensor) -> Tensor:
    """Return places (N, 3) relative to the bounding box, in units of its longest side: in [0, 1]."""
    low = means.amin(dim=0)
    return (means - low) / (means.amax(dim=0) - low).max().clamp(min=1e-6)


def positional_encoding(places: Tensor) -> Tensor:
    """Encode places (T, 3) in [0, 1] as sines and cosines: (T, 6 * OCTAVES)."""
    frequencies = torch.pi * 2.0 ** torch.arange(OCTAVES, device=places.device)
    angles = (places[..., None] * frequencies).flatten(1)
    return torch.cat((angles.sin(), angles.cos()), dim=1)


def point_features(scene: SplatScene) -> Tensor:
    """Return what each Gaussian knows of itself, (N, 6): its place in the box, in [-1, 1], and its unit normal."""
    found = scene.gaussians.gaussians
    w, x, y, z = found.quats.T
    normals = np.stack((2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)), axis=-1)
    places = 2.0 * in_box(torch.from_numpy(found.means)) - 1.0
    return torch.cat((places, torch.from_numpy(normals)), dim=1).to(scene.cells.device)
