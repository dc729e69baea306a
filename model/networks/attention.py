"""The published backbone: a convolutional stem, groups of shifted-window attention blocks, a long skip.

After the 2D stage of MV-CoLight (2025), whose blocks are those of Liu et al. 2021 with a local branch. Beyond it:
tokens of several pixels, and a summary of the whole picture in every window.

Shape letters: B pictures, H W pixels, C channels, h w tokens a side, n windows, N tokens a window, P pooled tokens,
A heads.
"""

import functools
import itertools

import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.model.configs.stage2d import NetworkConfig


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
