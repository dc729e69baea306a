"""The 3D stage: one consistent relighting of all views, on the Gaussians of the scene.

After the 3D stage of MV-CoLight (2025): the Gaussians' inharmonious colours and the colours that the 2D stage gives
them lie on a map, folded from the order of a 3D Hilbert curve, and the network of the 2D stage, on six channels,
predicts their harmonized colours. Beyond it: 2D colours are averaged over all views that show a Gaussian, the network
predicts what to change about that average, and a view keeps the detail that its own pixels have (`detailed`).

Shape letters: V views, H W pixels, N Gaussians, S map cells a side.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from model.compositing2d import Backbone, linear_to_srgb, srgb_to_linear
from model.config import NetworkConfig
from model.splat import SplatScene

FLOOR = 0.02  # linear light added to both sides of a ratio: below it, detail is noise
LARGEST_RATIO = 3.0


class Compositing3D(nn.Module):
    """Inharmonious and carried colours on the map to harmonized ones; any side that is a power of two."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = Backbone(config, channels=6)
        self.head = nn.Conv2d(self.backbone.features, 3 * self.backbone.scale**2, 3, padding=1)
        for parameter in self.head.parameters():  # an untrained network returns the carried colours
            nn.init.zeros_(parameter)

    def forward(self, composite: Tensor, carried: Tensor) -> Tensor:
        """Harmonize: two maps (1, 3, S, S), display-encoded → (1, 3, S, S); in training, not clipped."""
        side, multiple = composite.shape[-1], self.backbone.multiple
        x = functional.pad(torch.cat((composite, carried), dim=1), (0, -side % multiple, 0, -side % multiple))
        change = functional.pixel_shuffle(self.head(self.backbone(x)), self.backbone.scale)[..., :side, :side]
        image = carried + change.float()
        return image if self.training else image.clamp(0.0, 1.0)


def harmonize_scene(
    network: Compositing3D, scene: SplatScene, composites: Tensor, harmonized: Tensor
) -> tuple[Tensor, Tensor]:
    """Make V views consistent: display-encoded composites and 2D results (V, 3, H, W) each.

    Returns the Gaussians' colours (N, 3) and the views (V, 3, H, W), display-encoded.
    """
    maps = (scene.to_map(scene.carry(images)) for images in (composites, harmonized))
    colors = scene.from_map(network(*maps))
    return colors, detailed(scene, colors, harmonized)


def detailed(scene: SplatScene, colors: Tensor, harmonized: Tensor) -> Tensor:
    """Render colours (N, 3) to the views, with the detail of `harmonized` (V, 3, H, W), all display-encoded.

    Ratio images in linear light (after Shashua and Riklin-Raviv 2001): a view is multiplied by what its Gaussians show
    over what they would show, had they been coloured by this view alone. Where no Gaussian is, it stays.
    """
    pixels = srgb_to_linear(harmonized)
    with torch.no_grad():
        covered = scene.covered()
        own = scene.smooth(pixels)
    shown = scene.render(srgb_to_linear(colors)) / covered.clamp(min=1e-3)
    ratio = ((shown.clamp(min=0.0) + FLOOR) / (own + FLOOR)).clamp(1.0 / LARGEST_RATIO, LARGEST_RATIO)
    return linear_to_srgb(pixels * torch.lerp(torch.ones_like(ratio), ratio, covered.clamp(0.0, 1.0)))
