"""What training minimizes: squared error where it matters, plus a distance that sees structure."""

import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.model.configs.stage2d import LossConfig
from multilight.model.networks.light_head import Lights
from multilight.model.networks.shading import FOCAL
from multilight.model.training.batches import Batch
from multilight.model.training.vgg import VGG19Features, load_vgg19

FEATURE_WEIGHTS = (1 / 2.6, 1 / 4.8, 1 / 3.7, 1 / 5.6, 10 / 1.5)
"""Of conv1_2 … conv5_2 (Chen and Koltun 2017), as in the published training."""

EFFECT_SEEN = 0.02  # display-encoded effect at which a pixel counts half as changed
CONCENTRATION = 8.0  # of a guessed light's distribution: most within 30 degrees
SCALES, WINDOW = 3, 7
KNEE = 1e-3  # mean squared error (30 dB) at which the logarithmic loss turns from linear to logarithmic


class VGGDistance(nn.Module):
    """L1 between VGG19 features, and between the pictures, weighted as in the published training."""

    label = "vgg19"

    def __init__(self, features: VGG19Features) -> None:
        super().__init__()
        self.features = features

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Compare (B, 3, H, W) display-encoded pictures: (B,) distances."""
        with torch.no_grad():
            wanted = self.features(target)
        pairs = zip(FEATURE_WEIGHTS, self.features(image), wanted, strict=True)
        pixels = 255.0 * _per_picture((image - target).abs())
        total = sum((weight * _per_picture((a - b).abs()) for weight, a, b in pairs), start=pixels)
        return total / 255.0


class StructureDistance(nn.Module):
    """The stand-in where no VGG19 weights are given: gradients at three scales (L1), and 1 - SSIM.

    It rewards edges and local contrast, but knows nothing of what people notice: figures made with it are not those of
    the published loss, and are labelled `gradient+ssim`.
    """

    label = "gradient+ssim"

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        """Compare (B, 3, H, W) display-encoded pictures: (B,) distances."""
        total = 0.5 * (1.0 - ssim(image, target))
        for scale in range(SCALES):
            if scale:
                image, target = functional.avg_pool2d(image, 2), functional.avg_pool2d(target, 2)
            difference = image - target
            across = difference[..., :, 1:] - difference[..., :, :-1]
            down = difference[..., 1:, :] - difference[..., :-1, :]
            total = total + _per_picture(across.abs()) + _per_picture(down.abs())
        return total


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Return the mean structural similarity of (B, 3, H, W) pictures in [0, 1]: (B,).

    Wang et al. 2004, with a uniform window of `WINDOW` pixels (their equation 13, K1 = 0.01, K2 = 0.03) and no padding.
    """
    c1, c2 = 0.01**2, 0.03**2

    def mean(x: Tensor) -> Tensor:  # over squares, by rows and columns: four times faster than pooling
        for dim in (-1, -2):
            first, *others = (x.narrow(dim, i, x.shape[dim] - WINDOW + 1) for i in range(WINDOW))
            x = sum(others, start=first) / WINDOW
        return x

    mean_a, mean_b = mean(image), mean(target)
    var_a = mean(image * image) - mean_a**2
    var_b = mean(target * target) - mean_b**2
    covariance = mean(image * target) - mean_a * mean_b
    index = ((2 * mean_a * mean_b + c1) * (2 * covariance + c2)) / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    return _per_picture(index)


def by_region(error: Tensor, mask: Tensor, effect: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Average an error (B, C, H, W) over the object, over its effect, and over the rest of each picture: (B,) thrice.

    A pixel belongs to the object by its `mask` (B, 1, H, W), and of the rest to the effect by x / (x + 0.02) where the
    effect (B, 3, H, W) has size x (shadow, reflection, glow). So small objects and faint shadows count like large ones.
    """
    size = effect.abs().amax(dim=1, keepdim=True)
    seen = size / (size + EFFECT_SEEN)
    error = error.mean(dim=1, keepdim=True)
    found, shadow, rest = (
        (error * weight).flatten(1).sum(1) / weight.flatten(1).sum(1).clamp(min=1.0)
        for weight in (mask, (1.0 - mask) * seen, (1.0 - mask) * (1.0 - seen))
    )
    return found, shadow, rest


class CompositingLoss(nn.Module):
    """The squared error, or the logarithms of those of the object and of its effect, plus a perceptual distance.

    The mean of a squared error is decided by the pictures that are lit most wrongly, and what is gained on them is
    lost on those that were nearly right; its logarithm counts every picture's relative gain, as PSNR does. Each region
    has its own: taken together, a shadow is lost in what is wrong with the object.

    `label` names the distance in logs and tables: `vgg19`, `gradient+ssim` (stand-in) or `none`.
    """

    def __init__(self, config: LossConfig) -> None:
        super().__init__()
        self.config = config
        self.distance: VGGDistance | StructureDistance | None = None
        if config.perceptual > 0:
            self.distance = VGGDistance(load_vgg19(config.vgg)) if config.vgg else StructureDistance()
        self.label = "none" if self.distance is None else self.distance.label

    def forward(self, image: Tensor, target: Tensor, mask: Tensor, effect: Tensor) -> dict[str, Tensor]:
        """Compare (B, 3, H, W) pictures: per picture (B,) `loss`, `pixels` and `perceptual`, and (B,) plain `mse`."""
        squared = (image - target) ** 2
        if self.config.pixels == "mse":
            pixels = _per_picture(squared)
        else:  # scaled to about the size of the error itself
            found, shadow, rest = by_region(squared, mask, effect)
            both = torch.stack((found, shadow)) + self.config.far * rest
            pixels = 5.0 * KNEE * torch.log1p(both / KNEE).sum(0)
        perceptual = torch.zeros_like(pixels) if self.distance is None else self.distance(image, target)
        return {
            "loss": pixels + self.config.perceptual * perceptual,
            "pixels": pixels,
            "perceptual": perceptual,
            "mse": _per_picture(squared.detach()),
        }


def _per_picture(x: Tensor) -> Tensor:
    return x.flatten(1).mean(dim=1)


def light_loss(lights: Lights, sample: Batch) -> Tensor:
    """Return how badly guessed lights explain where the sample's light comes from: (B,).

    Minus the mean logarithm of the likelihood of the true directions from the object to the lights, each weighted by
    its fraction of the light, under a mixture of von Mises-Fisher distributions about the guessed ones, weighted by
    their brightness (up to a constant). Environments have no direction and do not count.
    """
    towards = seen_by_plain_lens(sample.light_towards, sample.K, sample.composite.shape[-1])
    weight = sample.light_fraction * towards.square().sum(2).gt(0)
    brightness = lights.colours.mean(2).log().log_softmax(1)
    near = CONCENTRATION * (torch.einsum("bnc,bkc->bnk", towards, lights.directions) - 1.0)
    return -(weight * (brightness[:, None] + near).logsumexp(2)).sum(1)


def glow_loss(logit: Tensor, sample: Batch) -> Tensor:
    """Return how wrong guessed glow (B, 1, h, w), a logit, is on the object: (B,), the mean cross-entropy [nat]."""
    mask, glow = (
        functional.adaptive_avg_pool2d(x, (logit.shape[-2], logit.shape[-1])) for x in (sample.mask, sample.glow)
    )
    true = glow / mask.clamp(min=1e-3)
    wrong = functional.binary_cross_entropy_with_logits(logit.float(), true.clamp(0.0, 1.0), reduction="none")
    return (wrong * mask).flatten(1).sum(1) / mask.flatten(1).sum(1).clamp(min=1.0)


def seen_by_plain_lens(directions: Tensor, intrinsics: Tensor, side: int) -> Tensor:
    """Return unit directions (B, N, 3) of a camera with K (B, 3, 3) and square pictures as `shading` takes them to be.

    It knows no lenses; what a pixel at depth z shows lies elsewhere for it, by a linear map.
    """
    x, y, z = directions.unbind(2)
    focal_x, focal_y = (intrinsics[:, axis, axis, None] / side for axis in range(2))
    off_x, off_y = (intrinsics[:, axis, 2, None] / side - 0.5 for axis in range(2))
    mapped = torch.stack(((focal_x * x - off_x * z) / FOCAL, (focal_y * y + off_y * z) / FOCAL, z), dim=2)
    return functional.normalize(mapped, dim=2)
