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

from multilight.model.configs.stage3d import SceneNetworkConfig
from multilight.model.gaussians.splat_scene import SplatScene
from multilight.model.networks.attention import Backbone
from multilight.model.networks.input_features import linear_to_srgb, srgb_to_linear
from multilight.model.networks.points3d import FEATURES, PointTransformer, point_features
from multilight.scenes.arrays import Float32

FLOOR = 0.02  # linear light added to both sides of a ratio: below it, detail is noise
LARGEST_RATIO = 3.0
UNTOUCHED, TOUCHED = 0.5 / 255.0, 2.0 / 255.0
"""Display-encoded change by the 2D stage that is none, and that is one: in between, a fraction is."""


class Compositing3D(nn.Module):
    """Inharmonious and carried colours on the map to harmonized ones; any side that is a power of two."""

    def __init__(self, config: SceneNetworkConfig) -> None:
        super().__init__()
        self.config = config
        self.backbone = Backbone(config, channels=6 + (FEATURES if config.layout == "map+points" else 0))
        self.head = nn.Conv2d(self.backbone.features, 3 * self.backbone.scale**2, 3, padding=1)
        for parameter in self.head.parameters():  # an untrained network returns the carried colours
            nn.init.zeros_(parameter)

    def forward(self, composite: Tensor, carried: Tensor, points: Tensor | None = None) -> Tensor:
        """Harmonize: two maps (1, 3, S, S), display-encoded → (1, 3, S, S); in training, not clipped.

        `points` (1, 6, S, S) are the Gaussians' features, for a network of that layout.
        """
        side, multiple = composite.shape[-1], self.backbone.multiple
        maps = (composite, carried) if points is None else (composite, carried, points)
        x = functional.pad(torch.cat(maps, dim=1), (0, -side % multiple, 0, -side % multiple))
        change = functional.pixel_shuffle(self.head(self.backbone(x)[0]), self.backbone.scale)[..., :side, :side]
        image = carried + change.float()
        return image if self.training else image.clamp(0.0, 1.0)

    def colors(self, scene: SplatScene, composite: Tensor, carried: Tensor) -> Tensor:
        """Harmonize colours of the scene's Gaussians: (N, 3) twice, display-encoded → (N, 3)."""
        maps = [scene.to_map(composite), scene.to_map(carried)]
        if self.config.layout == "map+points":
            maps.append(scene.to_map(point_features(scene)))
        return scene.from_map(self(*maps))


SceneNetwork = Compositing3D | PointTransformer


def scene_network(config: SceneNetworkConfig) -> SceneNetwork:
    """Make the network of the 3D stage; without a map, one of as many parameters as there would be with it."""
    if config.layout != "points":
        return Compositing3D(config)
    with torch.device("meta"):
        parameters = sum(p.numel() for p in Compositing3D(config).parameters())
    return PointTransformer(config, parameters)


def harmonize_scene(
    network: SceneNetwork, scene: SplatScene, composites: Tensor, harmonized: Tensor, backgrounds: Tensor
) -> tuple[Tensor, Tensor]:
    """Make V views consistent: display-encoded composites, 2D results and backgrounds (V, 3, H, W) each.

    Returns the Gaussians' colours (N, 3) and the views (V, 3, H, W), display-encoded. Where no view was changed, the
    views' own pixels stay.
    """
    carry = scene.carry if network.config.carry == "average" else scene.gather
    colors = network.colors(scene, carry(composites), carry(harmonized))
    changed = touched(scene, harmonized, backgrounds)
    return colors, torch.lerp(harmonized, detailed(scene, colors, harmonized), changed)


@torch.inference_mode()
def harmonize_views(
    network: SceneNetwork, scene: SplatScene, composites: Float32, harmonized: Float32, backgrounds: Float32
) -> tuple[Float32, Float32]:
    """Do as `harmonize_scene` with arrays (V, H, W, 3): colours (N, 3), and views (V, H, W, 3) in [0, 1]."""
    every = (composites, harmonized, backgrounds)
    given = (torch.from_numpy(views).permute(0, 3, 1, 2).to(scene.matrix.device) for views in every)
    colors, views = harmonize_scene(network, scene, *given)
    return colors.cpu().numpy(), views.clamp(0.0, 1.0).permute(0, 2, 3, 1).cpu().numpy()


def touched(scene: SplatScene, harmonized: Tensor, backgrounds: Tensor) -> Tensor:
    """Return how much of each pixel shows the object, or what any view's 2D stage changed, (V, 1, H, W) in [0, 1]."""
    with torch.no_grad():
        change = (harmonized - backgrounds).abs().amax(dim=1, keepdim=True)
        changed = ((change - UNTOUCHED) / (TOUCHED - UNTOUCHED)).clamp(0.0, 1.0)
        shown = scene.render((4.0 * scene.carry(changed)).clamp(max=1.0))
        return torch.maximum(shown, changed).clamp(0.0, 1.0)


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
