"""The 2D stage: a composite whose object is lit wrongly, in; the picture relit and with its shadows, out.

A backbone reads the picture: a convolutional pyramid, or attention in windows, as published. The head guesses the
lights of the picture, shades the object and casts its shadow by them, and predicts gains and offsets in linear light
besides, one set for the object and one for its surroundings, so that texture and outlines come from the input and an
untrained network changes nothing. Other heads are there to be compared with.

Shape letters: B pictures, H W pixels, C channels, h w features.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.networks import light_head
from multilight.model.networks.attention import Backbone
from multilight.model.networks.input_features import largest_near, linear_to_srgb, relief, soft_mask, srgb_to_linear
from multilight.model.networks.light_head import Guess, LightHead
from multilight.model.networks.pyramid import Pyramid

LARGEST_LOG_GAIN = 4.0
STATISTICS_SIDE = 64  # pixels a side at which a picture's statistics are taken
NEAR = 15  # of them: the object's neighbourhood is what a square of that side reaches
DARK = 0.02  # linear light added before logarithms are taken
STATISTICS = 25
LEAST_LOG_GAIN, LEAST_OFFSET = 0.02, 0.002  # outside the object, less is no shadow or glow, but uncertainty
LEAST_WEIGHT = 1e-3  # of a cell that holds nothing of what its maps are of
GAIN_HEADS = ("light", "gain")
GAIN_CHANNELS = 12  # log-gain and offset in RGB, for the object and for its surroundings


def statistics(composite: Tensor, background: Tensor, mask: Tensor) -> Tensor:
    """Describe how the object and its surroundings are lit: (B, 25), whatever the size of the pictures.

    Means and standard deviations of the logarithm of linear RGB: of the object in the composite; of the background
    round it, behind it and everywhere; and the logarithm of the object's fraction of the picture.
    """
    composite, background, mask = (
        functional.adaptive_avg_pool2d(x, STATISTICS_SIDE)
        for x in (srgb_to_linear(composite), srgb_to_linear(background), mask)
    )
    found = [mask.mean((2, 3)).clamp(min=1e-4).log()]
    surely = (mask > 0.0).to(mask.dtype)
    around = largest_near(surely, NEAR) - surely
    for image, weight in ((composite, mask), (background, around), (background, mask), (background, mask * 0 + 1)):
        logs, total = (image + DARK).log(), weight.sum((2, 3), keepdim=True) + 1e-3
        mean = (logs * weight).sum((2, 3), keepdim=True) / total
        spread = ((logs - mean) ** 2 * weight).sum((2, 3), keepdim=True) / total
        found += [mean.flatten(1), (spread + 1e-6).sqrt().flatten(1)]
    return torch.cat(found, dim=1)


class Compositing2D(nn.Module):
    """Composite, background and depth to the harmonized picture, at any size."""

    size = 128
    """Longest side in pixels at which it looks at pictures in use: that at which its training ended."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.config = config
        inputs = 10 if config.cues else 7
        self.backbone = Pyramid(inputs) if config.body == "pyramid" else Backbone(config, inputs)
        channels = {"gain": GAIN_CHANNELS, "light": GAIN_CHANNELS + light_head.CHANNELS}
        self.head = nn.Conv2d(
            self.backbone.features, channels.get(config.head, 3 * self.backbone.scale**2), 3, padding=1
        )
        ends = list(self.head.parameters())
        if config.head == "light":
            self.light = LightHead(STATISTICS + 2 * self.backbone.deepest)
        if config.head == "gain":  # what is to be changed all over the object alike, which is learnt first
            known, width = STATISTICS + self.backbone.features, 128
            last = nn.Linear(width, GAIN_CHANNELS // 2)
            self.overall = nn.Sequential(nn.Linear(known, width), nn.GELU(), nn.Linear(width, width), nn.GELU(), last)
            ends += last.parameters()
        if config.head != "direct":  # an untrained network returns the composite
            for parameter in ends:
                nn.init.zeros_(parameter)
        for parameter in self.parameters():  # as the activations lie, so that nothing is reordered
            if parameter.ndim == 4:
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(
        self,
        composite: Tensor,
        background: Tensor,
        depth: Tensor,
        mask: Tensor | None = None,
        *,
        told: bool = False,
        numbers: Tensor | None = None,
    ) -> Tensor | tuple[Tensor, Guess | None]:
        """Harmonize: (B, 3, H, W) display-encoded twice, (B, 1, H, W) depth in [0, 1] → (B, 3, H, W).

        `mask` (B, 1, H, W) in [0, 1], where given, replaces the estimated one. The result is display-encoded and, in
        training, not clipped. With `told` the guess comes along that it follows from, None of a head that makes none.
        `numbers`, where given, are those of a guess that was made before.
        """
        composite, background, depth = self.shown(composite, background, depth, mask)
        if mask is None:
            mask = soft_mask(composite, background)
        maps, guess = self.predict(composite, background, depth, mask, numbers=numbers)
        if self.config.head in GAIN_HEADS:
            image = apply_gains(maps, composite, background, mask)
        else:
            image = maps + composite if self.config.head == "residual" else maps.sigmoid()
        image = image if self.training else image.clamp(0.0, 1.0)
        return (image, guess) if told else image

    def shown(
        self, composite: Tensor, background: Tensor, depth: Tensor, mask: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the inputs with what the network is blind to replaced: the background by the composite, depth by 1.

        Raises `UserError` where a network that is blind to the background would have to find the mask with its help.
        """
        if "background" in self.config.blind:
            if mask is None:
                raise UserError("a network that is blind to the background needs the object's mask")
            background = composite
        if "depth" in self.config.blind:
            depth = torch.ones_like(depth)
        return composite, background, depth

    def predict(
        self,
        composite: Tensor,
        background: Tensor,
        depth: Tensor,
        mask: Tensor,
        *,
        numbers: Tensor | None = None,
        fine: tuple[Tensor, Tensor] | None = None,
    ) -> tuple[Tensor, Guess | None]:
        """Return what the head predicts, gain maps at `scale` or full-resolution (B, 3, H, W), and the guess.

        `numbers`, where given, are those of a guess that was made before; on `fine`, depth and mask of more pixels
        (B, 1, h, w), lights shade and cast shadows instead, and gain maps are of their size.
        """
        h, w = composite.shape[-2:]
        cues = (mask, relief(depth)) if self.config.cues else ()
        x = torch.cat((composite, background, depth, *cues), dim=1)
        multiple, scale = self.backbone.multiple, self.backbone.scale
        x = functional.pad(x, (0, -w % multiple, 0, -h % multiple), mode="replicate")
        features, deepest = self.backbone(x.contiguous(memory_format=torch.channels_last))
        maps = self.head(features)
        if self.config.head not in GAIN_HEADS:
            return functional.pixel_shuffle(maps, scale)[..., :h, :w].float(), None
        rows, columns = -(-h // scale), -(-w // scale)
        maps, features = maps[..., :rows, :columns], features[..., :rows, :columns]
        seen, guess = statistics(composite, background, mask), None
        if self.config.head == "light":
            inside = functional.adaptive_avg_pool2d(mask, (rows, columns))
            near = functional.interpolate(depth, size=(rows, columns), mode="nearest-exact")
            if numbers is None:
                known = torch.cat((seen, deepest.mean((2, 3)), mean_inside(deepest, mask)), dim=1).float()
                came, lit = (
                    functional.adaptive_avg_pool2d(srgb_to_linear(p), (rows, columns)) for p in (composite, background)
                )
                numbers = self.light.numbers(known, came, lit, near, inside)
            if fine is not None:
                near, inside = fine
                maps = functional.interpolate(maps, size=near.shape[-2:], mode="bilinear", align_corners=False)
            maps, guess = self.light(numbers, maps.float(), near, inside)
        inner, outer = maps.chunk(2, dim=1)
        if self.config.head == "gain":
            inner = inner + self.overall(torch.cat((seen, mean_inside(features, mask)), dim=1))[..., None, None]
        if not self.training:  # where it would have no gradient
            outer = without_least(outer)
        return torch.cat((inner, outer), dim=1).float(), guess

    @torch.no_grad()
    def calibrate(self, shadows: float, glow: float) -> None:
        """Multiply the logarithms of shadows that the lights cast, and add to the logit of the object's own glow."""
        for parameter in (self.light.last.weight, self.light.last.bias):
            parameter[-3:] *= shadows
        assert self.head.bias is not None
        self.head.bias[-1] += glow


def mean_inside(features: Tensor, mask: Tensor) -> Tensor:
    """Average features (B, C, h, w) over the object, `mask` (B, 1, H, W) of any size: (B, C)."""
    rows, columns = features.shape[-2:]
    inside = functional.adaptive_avg_pool2d(mask, (rows, columns))
    return (features * inside).sum((2, 3)) / (inside.sum((2, 3)) + 1e-3)


def without_least(outer: Tensor) -> Tensor:
    """Draw log-gains and offsets of the surroundings (B, 6, h, w) towards none by the least that counts."""
    log_gain, offset = outer.chunk(2, dim=1)
    return torch.cat((functional.softshrink(log_gain, LEAST_LOG_GAIN), functional.softshrink(offset, LEAST_OFFSET)), 1)


def apply_gains(maps: Tensor, composite: Tensor, background: Tensor, mask: Tensor) -> Tensor:
    """Apply gain maps of any resolution: maps (B, 12, h, w), pictures (B, 3, H, W), mask (B, 1, H, W).

    The composite is foreground + (1 - mask) * background ("over", Porter and Duff 1984); each part, in linear light,
    gets its own gain and offset, and they are put together again: outlines stay as sharp as the mask.
    """
    rows, columns = maps.shape[-2:]
    inside = functional.adaptive_avg_pool2d(mask, (rows, columns))
    log_inside, add_inside, log_outside, add_outside = (
        part
        for half, share in zip(maps.chunk(2, dim=1), (inside, 1.0 - inside), strict=True)
        for part in enlarged(half, share, composite.shape[-2:]).chunk(2, dim=1)
    )
    gain_inside, gain_outside = (g.clamp(-LARGEST_LOG_GAIN, LARGEST_LOG_GAIN).exp() for g in (log_inside, log_outside))
    surroundings = (1.0 - mask) * srgb_to_linear(background)
    foreground = srgb_to_linear(composite) - surroundings
    lit = gain_inside * foreground + mask * add_inside + gain_outside * surroundings + (1.0 - mask) * add_outside
    return linear_to_srgb(lit)


def enlarged(maps: Tensor, share: Tensor, size: torch.Size) -> Tensor:
    """Enlarge maps (B, C, h, w) of what has a `share` (B, 1, h, w) of each cell to `size`, by its own cells' values.

    What the maps hold beyond an outline counts the less, the smaller its share there: no light rim is left between an
    object and its shadow.
    """
    weight = share.square() + LEAST_WEIGHT
    maps, weight = (
        functional.interpolate(x, size=size, mode="bilinear", align_corners=False) for x in (maps * weight, weight)
    )
    return maps / weight
