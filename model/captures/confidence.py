"""How surely the Gaussians show each pixel's own surface, and what to do about the pixels where they do not.

Discs that stand for many pixels leave a few holes, through which what lies behind shows, and are ragged at outlines.
There the change that the 3D stage makes is taken from around, on the same side of the object's outline.
"""

import numpy as np
import torch
from scipy.ndimage import gaussian_filter

from multilight.model.gaussians.splat_scene import SplatScene
from multilight.model.networks.compositing3d import FLOOR
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import srgb_decode, srgb_encode
from multilight.scenes.spec import Camera

RIGHT, WRONG = 0.01, 0.03
"""Relative error of the depth that Gaussians show, up to which confidence is one, and from which on it is zero."""
AROUND = 2.0
"""Standard deviation [pixels] of the neighbourhood that stands in."""
LEAST = 1e-3
"""Confidence in the neighbourhood below which a pixel stays as the 2D stage left it."""


def depth_confidence(scene: SplatScene, cameras: tuple[Camera, ...], z_depths: Float32) -> Float32:
    """Return how surely each pixel shows the surface that its depth says, (V, H, W) in [0, 1].

    Gaussians blend to a mean point; its depth along the axis is held against z_depths (V, H, W).
    """
    device = scene.matrix.device
    means = torch.from_numpy(scene.gaussians.gaussians.means).to(device)
    with torch.inference_mode():
        shown = scene.render(torch.cat((means, torch.ones_like(means[:, :1])), dim=1)).cpu().numpy()  # (V, 4, H, W)
    points = shown[:, :3] / np.maximum(shown[:, 3:], 1e-3)
    found = []
    for camera, point, z in zip(cameras, points, z_depths, strict=True):
        pose = camera.pose()
        seen = -np.einsum("chw,c->hw", point - pose[:3, 3][:, None, None], pose[:3, 2])
        error = np.abs(seen / np.where(z > 0, z, 1.0) - 1.0)
        found.append(np.where(z > 0, np.clip((WRONG - error) / (WRONG - RIGHT), 0.0, 1.0), 0.0))
    return np.stack(found).astype(np.float32)


def repaired(single: Float32, views: Float32, confidence: Float32, coverage: Float32) -> Float32:
    """Return views (V, H, W, 3), display-encoded, whose unsure pixels change `single` as those around them do."""
    before = srgb_decode(single) + FLOOR
    gains = (srgb_decode(views) + FLOOR) / before
    result = np.array(views)
    for number, (gain, sure, cover) in enumerate(zip(gains, confidence, coverage, strict=True)):
        filled = np.ones_like(gain)
        for region in (cover > 0.5, cover <= 0.5):
            weight = sure * region
            near = gaussian_filter(weight, AROUND)
            sums = gaussian_filter(gain * weight[..., None], (AROUND, AROUND, 0))
            there = (region & (near > LEAST))[..., None]
            filled = np.where(there, sums / np.maximum(near, LEAST)[..., None], filled)
        mixed = sure[..., None] * gain + (1.0 - sure[..., None]) * filled
        result[number] = srgb_encode(before[number] * mixed - FLOOR)
    return result
