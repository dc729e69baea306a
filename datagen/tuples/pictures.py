"""What is stored of a view, and differences, as 8-bit pictures for the eye."""

import colorsys

import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32, UInt8
from multilight.scenes.colour import srgb_encode

GOLDEN = 0.618034
"""Hues that are this fraction of a turn apart never come close to each other soon."""


def depth_range(z_depth: Float32) -> tuple[float, float]:
    """Return the depths [m] between which `depth_picture` runs from bright to dark; 0, 0 where there is nothing."""
    seen = z_depth > 0
    if not seen.any():
        return 0.0, 0.0
    near, far = np.percentile(z_depth[seen], [1, 95])
    return float(near), float(far)


def depth_picture(z_depth: Float32) -> UInt8:
    """Show planar depth as grey, near bright, (H, W, 3) uint8; pixels without geometry are black."""
    near, far = depth_range(z_depth)
    grey = np.clip(1.0 - 0.85 * (z_depth - near) / max(far - near, 1e-6), 0.1, 1.0) * (z_depth > 0)
    return np.repeat((grey * 255).astype(np.uint8)[..., None], 3, axis=2)


def effect_picture(effect: Float32) -> UInt8:
    """Show an exposed, signed difference about middle grey, (H, W, 3) uint8: shadows dark, glow bright."""
    scaled = np.tanh(effect * 1.5) * 0.5 + 0.5
    return (scaled * 255).round().astype(np.uint8)


def normal_picture(normals: Float32) -> UInt8:
    """Show unit normals n (H, W, 3) as 0.5 + 0.5 n; grey where there is nothing."""
    return (np.clip(0.5 + 0.5 * normals, 0, 1) * 255).round().astype(np.uint8)


def albedo_picture(albedo: Float32) -> UInt8:
    """Show linear base colour (H, W, 3), sRGB-encoded."""
    return (srgb_encode(np.clip(albedo, 0, 1)) * 255).round().astype(np.uint8)


def mask_picture(share: Float32) -> UInt8:
    """Show shares (H, W) in [0, 1] from black to white."""
    return np.repeat((share * 255).round().astype(np.uint8)[..., None], 3, axis=2)


def ids_picture(ids: NDArray[np.unsignedinteger]) -> UInt8:
    """Show each body (H, W) in a colour of its own, the same in every view; black where there is nothing."""
    colours = [(0.0, 0.0, 0.0)]
    colours += [
        colorsys.hsv_to_rgb(n * GOLDEN % 1, (0.9, 0.5)[n % 2], (1.0, 0.7)[n // 2 % 2])
        for n in range(1, ids.max(initial=0) + 1)
    ]
    return (np.array(colours)[ids] * 255).round().astype(np.uint8)
