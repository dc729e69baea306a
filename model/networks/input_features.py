"""What can be read off the inputs before any learning: linear light, where the object is, how surfaces lean."""

import torch
from torch import Tensor
from torch.nn import functional

SEEN = 0.01  # display-encoded difference, some 8-bit steps, above which a pixel surely belongs to the object
HOLE = 5  # pixels a side of the closing that fills holes of the soft mask
RELIEF = 64.0  # scale of the log-depth slope (a pixel of 1/64 relative depth is half of full slope)


def srgb_to_linear(encoded: Tensor) -> Tensor:
    """Decode display values in [0, 1] (IEC 61966-2-1); any shape, any float type."""
    x = encoded.clamp(0.0, 1.0)
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Tensor) -> Tensor:
    """Encode linear values (IEC 61966-2-1); not clipped above 1, below 0 the line goes on, so gradients flow."""
    x = linear.clamp(min=0.0031308)
    return torch.where(linear <= 0.0031308, 12.92 * linear, 1.055 * x ** (1 / 2.4) - 0.055)


def soft_mask(composite: Tensor, background: Tensor) -> Tensor:
    """Estimate where the object is from what differs: (B, 3, H, W) display-encoded twice → (B, 1, H, W) in [0, 1].

    Holes, where the object happens to look like the background, are closed; on the rim, the coverage is the difference
    relative to the largest next to it, which is right where both colours are smooth.
    """
    difference = (composite - background).abs().amax(dim=1, keepdim=True)
    surely = (difference / SEEN).clamp(max=1.0)
    closed = -largest_near(-largest_near(surely, HOLE), HOLE)
    inside = -largest_near(-closed, 3)
    coverage = difference / largest_near(difference, 3).clamp(min=SEEN)
    return torch.where(inside >= 1.0, closed, closed * coverage)


def largest_near(x: Tensor, size: int) -> Tensor:
    """Return the largest value in the `size` x `size` pixels round each, (B, 1, H, W), row by row, then column."""
    rows = functional.max_pool2d(x, (1, size), 1, (0, size // 2))
    return functional.max_pool2d(rows, (size, 1), 1, (size // 2, 0))


def relief(depth: Tensor) -> Tensor:
    """Return the slope of the log depth, a stand-in for normals: (B, 1, H, W) → (B, 2, H, W) in (-1, 1)."""
    log_depth = depth.clamp(min=1e-3).log()
    dx = functional.pad(log_depth[..., :, 1:] - log_depth[..., :, :-1], (0, 1, 0, 0))
    dy = functional.pad(log_depth[..., 1:, :] - log_depth[..., :-1, :], (0, 0, 0, 1))
    slope = RELIEF * torch.cat((dx, dy), dim=1)
    return slope / (1.0 + slope.abs())
