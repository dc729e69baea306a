"""How close a picture is to the truth, by region: PSNR, SSIM, FLIP, and LPIPS where weights are given.

Pictures are (H, W, 3) float32, display-encoded sRGB in [0, 1]. A metric is a map over the picture, averaged over each
region; PSNR comes from the mean of the squared error there.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import flip_evaluator
import numpy as np
import torch
from torchmetrics.functional.image import structural_similarity_index_measure

from multilight.datagen.errors import UserError
from multilight.model.evaluation.lpips import Lpips
from multilight.scenes.arrays import Float32, Mask

EFFECT = 0.02
"""Least |effect| in any channel, as displayed, that counts as a shadow, reflection or glow: five grey levels of 255."""
MOST_PSNR = 60.0
"""PSNR is cut here, so that a region which a method leaves untouched has a mean: 8-bit rounding alone is 58.9 dB."""
REGIONS = ("image", "object", "effect", "object and effect", "elsewhere")
METRICS = ("PSNR", "SSIM", "FLIP", "LPIPS")
HIGHER_IS_BETTER = {"PSNR": True, "SSIM": True, "FLIP": False, "LPIPS": False}

Scores = dict[str, dict[str, float]]
"""Region → metric → value; a region without a pixel is missing."""


@dataclass(frozen=True)
class Regions:
    """Where to look: boolean (H, W) masks by the names in `REGIONS`."""

    masks: Mapping[str, Mask]

    @classmethod
    def of(cls, mask: Float32, effect: Float32) -> "Regions":
        """Divide a picture by the object's `mask` (H, W) in [0, 1] and the signed `effect` (H, W, 3) as displayed.

        `object` is where the mask is above one half, `effect` where the object changes the picture visibly beyond it.
        """
        inside = mask > 0.5
        changed = (np.abs(effect).max(axis=-1) > EFFECT) & ~inside
        both = inside | changed
        return cls(dict(zip(REGIONS, (np.ones_like(inside), inside, changed, both, ~both), strict=True)))

    def within(self, valid: Mask) -> "Regions":
        """Keep only the pixels where the truth is known."""
        return Regions({name: region & valid for name, region in self.masks.items()})


def measure(picture: Float32, truth: Float32, regions: Regions, lpips: Lpips | None = None) -> Scores:
    """Compare a picture with the truth in every region; raises `UserError` for other shapes or values that are not
    finite.
    """
    if picture.shape != truth.shape:
        raise UserError(f"the picture has shape {picture.shape}, the truth {truth.shape}: make them of equal size")
    if not (np.isfinite(picture).all() and np.isfinite(truth).all()):
        raise UserError("a picture holds NaN or infinite values; look for them in the model's weights or the inputs")
    squared = np.square(picture.astype(np.float64) - truth).mean(axis=-1)
    maps = {"SSIM": ssim_map(picture, truth), "FLIP": flip_map(picture, truth)}
    if lpips is not None:
        maps["LPIPS"] = lpips.difference_map(picture, truth)
    scores: Scores = {}
    for name, region in regions.masks.items():
        if region.any():
            means = {metric: float(values[region].mean(dtype=np.float64)) for metric, values in maps.items()}
            scores[name] = {"PSNR": psnr(float(squared[region].mean()))} | means
    return scores


def psnr(mean_squared_error: float) -> float:
    """Return the peak signal-to-noise ratio [dB] for values in [0, 1], at most `MOST_PSNR`."""
    return min(MOST_PSNR, -10.0 * float(np.log10(max(mean_squared_error, 1e-12))))


def ssim_map(picture: Float32, truth: Float32) -> Float32:
    """Return the structural similarity of each pixel's surroundings, (H, W), mean over channels.

    Z. Wang et al., Image Quality Assessment: From Error Visibility to Structural Similarity, 2004; Gaussian window of
    sigma 1.5 pixels, the picture mirrored at its border.
    """
    a, b = (torch.from_numpy(np.array(image.transpose(2, 0, 1)))[None] for image in (picture, truth))
    found = structural_similarity_index_measure(a, b, data_range=1.0, return_full_image=True)
    full = found[1] if isinstance(found, tuple) else found
    return full[0].mean(dim=0).numpy()


def flip_map(picture: Float32, truth: Float32) -> Float32:
    """Return the visible difference of each pixel when both pictures are flipped back and forth, (H, W) in [0, 1].

    P. Andersson et al., FLIP: A Difference Evaluator for Alternating Images, 2020; at 67 pixels a degree.
    """
    return _flip(picture, truth, magma=False).reshape(*picture.shape[:2], -1)[..., 0]


def flip_picture(picture: Float32, truth: Float32) -> Float32:
    """Return `flip_map` as a picture (H, W, 3), dark where nothing differs."""
    return _flip(picture, truth, magma=True)


def _flip(picture: Float32, truth: Float32, *, magma: bool) -> Float32:
    a, b = (np.ascontiguousarray(np.clip(image, 0.0, 1.0), np.float32) for image in (truth, picture))
    error, _, _ = flip_evaluator.evaluate(a, b, "LDR", inputsRGB=True, applyMagma=magma, computeMeanError=False)
    return np.asarray(error, np.float32)


def mean_scores(every: list[Scores]) -> Scores:
    """Average each region's values over pictures; a picture without the region does not count there."""
    means: Scores = {}
    for region in REGIONS:
        found = [scores[region] for scores in every if region in scores]
        if found:
            means[region] = {metric: float(np.mean([values[metric] for values in found])) for metric in found[0]}
    return means
