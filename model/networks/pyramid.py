"""A convolutional pyramid: cheaper than attention at small sizes, where most of the training is spent."""

import itertools

from torch import Tensor, nn
from torch.nn import functional

GROUPS = 8


class Residual(nn.Module):
    """Two convolutions beside a shortcut; what the whole picture holds weighs the channels of what they add."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(GROUPS, width)
        self.first, self.second = nn.Conv2d(width, width, 3, padding=1), nn.Conv2d(width, width, 3, padding=1)
        self.gate = nn.Linear(width, width)
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, h, w) to (B, C, h, w)."""
        y = functional.gelu(self.first(self.norm(x)))
        gate = 2.0 * self.gate(y.mean((2, 3))).sigmoid()
        return x + gate[..., None, None] * self.second(y)


class Pyramid(nn.Module):
    """Any picture-like map to features: down by halves, residual blocks at the smallest sizes, and up again.

    (B, `channels`, H, W) → (B, `features`, H / 2, W / 2) and (B, `deepest`, H / 16, W / 16), H and W multiples of
    `multiple`.
    """

    multiple, scale = 16, 2

    def __init__(self, channels: int, widths: tuple[int, ...] = (24, 48, 96, 144), blocks: int = 3) -> None:
        super().__init__()
        self.features, self.deepest = widths[0], widths[-1]
        pairs = list(itertools.pairwise((channels, *widths)))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 3, stride=2, padding=1) for a, b in pairs)
        self.deep = nn.ModuleList(
            nn.Sequential(*(Residual(width) for _ in range(count)))
            for width, count in zip(widths, (0, 0, 1, blocks), strict=True)
        )
        ups = pairs[:0:-1]
        self.narrow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in ups)
        self.merge = nn.ModuleList(nn.Conv2d(a, a, 3, padding=1) for a, _ in ups)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Map (B, `channels`, H, W) to (B, `features`, H / 2, W / 2) and (B, `deepest`, H / 16, W / 16)."""
        levels = []
        for down, deep in zip(self.down, self.deep, strict=True):
            x = deep(functional.gelu(down(x)))
            levels.append(x)
        for narrow, merge, level in zip(self.narrow, self.merge, levels[-2::-1], strict=True):
            x = functional.interpolate(narrow(x), scale_factor=2, mode="bilinear") + level
            x = functional.gelu(merge(x)) + x
        return x, levels[-1]
