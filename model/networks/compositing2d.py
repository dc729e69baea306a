"""The 2D stage: a composite whose object is lit wrongly, in; the picture relit and with its shadows, out.

After the 2D stage of MV-CoLight (2025): a convolutional stem, groups of shifted-window attention blocks (Liu et al.
2021) with a local branch, a long skip. Beyond it: tokens of several pixels, a summary of the whole picture in every
window, and a head that predicts gains and offsets in linear light, one set for the object and one for its
surroundings, so that texture and outlines come from the input and an untrained network changes nothing.

Shape letters: B pictures, H W pixels, C channels, h w tokens a side, n windows, N tokens a window, P pooled tokens,
A heads.
"""

import functools
import itertools

import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.networks import light_head
from multilight.model.networks.input_features import largest_near, linear_to_srgb, relief, soft_mask, srgb_to_linear
from multilight.model.networks.light_head import Guess, LightHead
from multilight.model.networks.pyramid import Pyramid

LARGEST_LOG_GAIN = 4.0
STATISTICS_SIDE = 64  # pixels a side at which a picture's statistics are taken
NEAR = 15  # of them: the object's neighbourhood is what a square of that side reaches
DARK = 0.02  # linear light added before logarithms are taken
STATISTICS = 25
LEAST_LOG_GAIN, LEAST_OFFSET = 0.02, 0.002  # outside the object, less is no shadow or glow, but uncertainty
GAIN_HEADS = ("light", "gain")
GAIN_CHANNELS = 12  # log-gain and offset in RGB, for the object and for its surroundings


def shift_mask(rows: int, columns: int, window: int, device: torch.device) -> Tensor:
    """Return which tokens of a shifted window may see each other: (n, N, N) bool, h w in tokens."""

    def bands(length: int) -> Tensor:
        place = torch.arange(length, device=device)
        return (place >= length - window).int() + (place >= length - window // 2).int()

    region = 3 * bands(rows)[:, None] + bands(columns)[None, :]
    ids = windows_of(region[None, :, :, None], window)[0, :, :, 0]  # (n, N)
    return ids[:, :, None] == ids[:, None, :]


def windows_of(x: Tensor, window: int) -> Tensor:
    """Cut (B, h, w, C) into windows: (B, n, N, C)."""
    b, h, w, c = x.shape
    x = x.reshape(b, h // window, window, w // window, window, c).transpose(2, 3)
    return x.reshape(b, -1, window * window, c)


def from_windows(x: Tensor, rows: int, columns: int, window: int) -> Tensor:
    """Undo `windows_of`: (B, n, N, C) → (B, h, w, C)."""
    b, _, _, c = x.shape
    x = x.reshape(b, rows // window, columns // window, window, window, c).transpose(2, 3)
    return x.reshape(b, rows, columns, c)


@functools.cache
def relative_places(window: int) -> Tensor:
    """Return the row of the bias table for each pair of tokens: (N, N) int64."""
    with torch.inference_mode(False):  # kept, so a training may use what an inference was the first to ask for
        y, x = torch.meshgrid(torch.arange(window), torch.arange(window), indexing="ij")
        dy, dx = (v.flatten()[:, None] - v.flatten()[None, :] + window - 1 for v in (y, x))
        return (2 * window - 1) * dy + dx


class WindowAttention(nn.Module):
    """Attention inside windows, with a learnt bias for each offset, and to the picture's pooled tokens."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.window, self.heads, self.pooled = config.window, config.heads, config.pooled
        self.to_qkv = nn.Linear(config.width, 3 * config.width)
        self.out = nn.Linear(config.width, config.width)
        self.bias = nn.Parameter(0.02 * torch.randn((2 * config.window - 1) ** 2, config.heads))

    def forward(self, x: Tensor, allowed: Tensor | None) -> Tensor:
        """Attend: x (B, h, w, C); allowed (n, N, N) bool for shifted windows → (B, h, w, C)."""
        b, h, w, c = x.shape
        shift = self.window // 2 if allowed is not None else 0
        qkv = self.to_qkv(x)
        summary = self._summary(qkv)  # (B, P, 2C) keys and values of the pooled tokens
        if shift:
            qkv = qkv.roll((-shift, -shift), (1, 2))
        qkv = windows_of(qkv, self.window)  # (B, n, N, 3C)
        windows = qkv.shape[1]
        q, k, v = qkv.flatten(0, 1).chunk(3, dim=-1)  # (Bn, N, C)
        if summary is not None:
            shared_k, shared_v = summary.repeat_interleave(windows, 0).chunk(2, dim=-1)
            k, v = torch.cat((k, shared_k), 1), torch.cat((v, shared_v), 1)  # (Bn, N + P, C)
        q, k, v = (t.unflatten(-1, (self.heads, -1)).transpose(1, 2) for t in (q, k, v))  # (Bn, A, N.., C/A)
        x = functional.scaled_dot_product_attention(q, k, v, attn_mask=self._mask(b, k.shape[2], allowed).to(q.dtype))
        x = from_windows(x.transpose(1, 2).reshape(b, windows, -1, c), h, w, self.window)
        return self.out(x.roll((shift, shift), (1, 2)) if shift else x)

    def _summary(self, qkv: Tensor) -> Tensor | None:
        if not self.pooled:
            return None
        keys_values = qkv[..., qkv.shape[-1] // 3 :].permute(0, 3, 1, 2)
        return functional.adaptive_avg_pool2d(keys_values, self.pooled).flatten(2).transpose(1, 2)

    def _mask(self, pictures: int, keys: int, allowed: Tensor | None) -> Tensor:
        """Return what is added to the logits: (1 or Bn, A, N, keys)."""
        table = self.bias[relative_places(self.window).to(self.bias.device)]  # (N, N, A)
        bias = table.permute(2, 0, 1)[None]
        if allowed is not None:
            bias = bias.masked_fill(~allowed[:, None], -1e4).repeat(pictures, 1, 1, 1)
        return functional.pad(bias, (0, keys - bias.shape[-1]))


class LocalContext(nn.Module):
    """The block's local branch: a narrow 3 x 3 convolution, weighted channel by channel by what the picture holds."""

    def __init__(self, width: int) -> None:
        super().__init__()
        narrow = width // 8
        self.local = nn.Sequential(
            nn.Conv2d(width, narrow, 1), nn.Conv2d(narrow, narrow, 3, padding=1), nn.Conv2d(narrow, width, 1)
        )
        self.gate = nn.Sequential(
            nn.Linear(width, narrow, bias=False), nn.ReLU(), nn.Linear(narrow, width, bias=False), nn.Sigmoid()
        )

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, h, w, C) to (B, h, w, C)."""
        x = functional.leaky_relu(self.local(x.permute(0, 3, 1, 2)), 0.2).permute(0, 2, 3, 1)
        return x * self.gate(x.mean(dim=(1, 2), keepdim=True))


class Block(nn.Module):
    """Attention, perceptron and local branch, each beside a shortcut."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        width = config.width
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = WindowAttention(config)
        self.perceptron = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(), nn.Linear(4 * width, width))
        self.local = LocalContext(width)

    def forward(self, x: Tensor, allowed: Tensor | None) -> Tensor:
        """Map (B, h, w, C) to (B, h, w, C)."""
        normed = self.norm1(x)
        x = x + self.attention(normed, allowed)
        return x + self.perceptron(self.norm2(x)) + self.local(normed)


class Group(nn.Module):
    """Blocks with plain and shifted windows alternately, then a dilated convolution, all beside a shortcut."""

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(Block(config) for _ in range(config.blocks))
        self.dilated = nn.Conv2d(config.width, config.width, 3, padding=2, dilation=2)

    def forward(self, x: Tensor, allowed: Tensor) -> Tensor:
        """Map (B, h, w, C) to (B, h, w, C)."""
        y = x
        for number, block in enumerate(self.blocks):
            y = block(y, allowed if number % 2 else None)
        return x + self.dilated(y.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)


class Backbone(nn.Module):
    """Any picture-like map to features: stem, attention groups, long skip, and back up to half resolution.

    (B, `channels`, H, W) → (B, `features`, H / `scale`, W / `scale`) and (B, `deepest`, H / `stride`, W / `stride`), H
    and W multiples of `multiple`. `scale` is 1 at stride 1, else 2.
    """

    def __init__(self, config: NetworkConfig, channels: int) -> None:
        super().__init__()
        self.window, self.stride = config.window, config.stride
        self.multiple = config.stride * config.window
        self.scale = 1 if config.stride == 1 else 2
        width = config.width
        if config.stride == 1:
            widths = [channels, width, width, width]
        else:  # halved in width for each doubling of the resolution
            halvings = config.stride.bit_length() - 1
            widths = [channels, *(width >> (halvings - 1 - i) for i in range(halvings))]
        self.features, self.deepest = widths[1], width
        step = 1 if config.stride == 1 else 2
        self.stem = nn.ModuleList(
            nn.Conv2d(a, b, 3, stride=step, padding=1, padding_mode="reflect" if step == 1 else "zeros")
            for a, b in itertools.pairwise(widths)
        )
        self.norm_in, self.norm_out = nn.LayerNorm(width), nn.LayerNorm(width)
        self.groups = nn.ModuleList(Group(config) for _ in range(config.groups))
        self.after = nn.Conv2d(width, width, 3, padding=1)
        self.skip = nn.Conv2d(width, width, 3, padding=1)
        ups = [] if config.stride == 1 else list(zip(widths[:1:-1], widths[-2:0:-1], strict=True))
        self.narrow = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in ups)
        self.merge = nn.ModuleList(nn.Conv2d(b, b, 3, padding=1) for _, b in ups)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, `channels`, H, W) to the finest features and the deepest."""
        levels = []
        for conv in self.stem:
            x = conv(x)
            if self.stride > 1:
                x = functional.gelu(x)
                levels.append(x)
        tokens = self.norm_in(x.permute(0, 2, 3, 1))  # (B, h, w, C)
        allowed = shift_mask(tokens.shape[1], tokens.shape[2], self.window, x.device)
        for group in self.groups:
            tokens = group(tokens, allowed)
        x = deepest = self.after(self.norm_out(tokens).permute(0, 3, 1, 2) + x) + self.skip(x)
        for narrow, merge, level in zip(self.narrow, self.merge, levels[-2::-1], strict=True):
            x = functional.interpolate(narrow(x), scale_factor=2, mode="bilinear") + level
            x = functional.gelu(merge(x)) + x
        return x, deepest


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
        self, composite: Tensor, background: Tensor, depth: Tensor, mask: Tensor | None = None, *, told: bool = False
    ) -> Tensor | tuple[Tensor, Guess | None]:
        """Harmonize: (B, 3, H, W) display-encoded twice, (B, 1, H, W) depth in [0, 1] → (B, 3, H, W).

        `mask` (B, 1, H, W) in [0, 1], where given, replaces the estimated one. The result is display-encoded and, in
        training, not clipped. With `told` the guess comes along that it follows from, None of a head that makes none.
        """
        composite, background, depth = self.shown(composite, background, depth, mask)
        if mask is None:
            mask = soft_mask(composite, background)
        maps, guess = self.predict(composite, background, depth, mask)
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
        self, composite: Tensor, background: Tensor, depth: Tensor, mask: Tensor
    ) -> tuple[Tensor, Guess | None]:
        """Return what the head predicts, gain maps at `scale` or full-resolution (B, 3, H, W), and the guess."""
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
            small = [
                functional.adaptive_avg_pool2d(srgb_to_linear(p), (rows, columns)) for p in (composite, background)
            ]
            inside = functional.adaptive_avg_pool2d(mask, (rows, columns))
            near = functional.interpolate(depth, size=(rows, columns), mode="nearest-exact")
            known = torch.cat((seen, deepest.mean((2, 3)), mean_inside(deepest, mask)), dim=1)
            maps, guess = self.light(known.float(), maps.float(), *small, near, inside)
        inner, outer = maps.chunk(2, dim=1)
        if self.config.head == "gain":
            inner = inner + self.overall(torch.cat((seen, mean_inside(features, mask)), dim=1))[..., None, None]
        if not self.training:  # where it would have no gradient
            outer = without_least(outer)
        return torch.cat((inner, outer), dim=1).float(), guess


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
    maps = functional.interpolate(maps, size=composite.shape[-2:], mode="bilinear", align_corners=False)
    log_inside, add_inside, log_outside, add_outside = maps.chunk(4, dim=1)
    gain_inside, gain_outside = (g.clamp(-LARGEST_LOG_GAIN, LARGEST_LOG_GAIN).exp() for g in (log_inside, log_outside))
    surroundings = (1.0 - mask) * srgb_to_linear(background)
    foreground = srgb_to_linear(composite) - surroundings
    lit = gain_inside * foreground + mask * add_inside + gain_outside * surroundings + (1.0 - mask) * add_outside
    return linear_to_srgb(lit)
