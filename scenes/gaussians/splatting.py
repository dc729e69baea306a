"""Splatting with fixed geometry: a picture is a sparse matrix times the Gaussians' colours.

Where Gaussians neither move nor change shape, what each adds to each pixel is worked out once: a view is then
`weights @ colors`, linear in the colours, at the price of reading the matrix.

Source: Zwicker et al., "EWA Splatting" (2002), as in Kerbl et al., "3D Gaussian Splatting" (2023): projection of the
covariance by the Jacobian at the centre, a low-pass of 0.3 pixels, opacity capped at 0.99, front to back.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.cameras.pinhole import project
from multilight.scenes.gaussians.from_views import Gaussians
from multilight.scenes.spec import Camera

LOW_PASS = 0.3
"""Variance [pixels²] added to every footprint."""
CAP = 0.99
"""The most that one Gaussian covers."""
FAINTEST = 1 / 255
"""Alpha below which a Gaussian is left out of a pixel."""
CLOSED = 1e-4
"""Transmittance below which what lies behind is left out."""
NEAR = 0.01
"""Metres before the pinhole within which nothing is drawn."""


@dataclass(frozen=True)
class Footprints:
    """Gaussians as a view sees them, front to back: centres (M, 2) pixels, inverse covariances (M, 3) (xx, xy, yy).

    `numbers` (M,) are their places among all; `radii` (M, 2) half sides in pixels of the box that alpha reaches
    `FAINTEST` in; `opacities` (M,).
    """

    numbers: Int64
    centres: Float64
    inverses: Float64
    radii: Float64
    opacities: Float64


def blending_weights(camera: Camera, gaussians: Gaussians) -> csr_matrix:
    """Return what each of N Gaussians adds to each of H x W pixels, row-major: sparse (H * W, N) float32.

    Rows sum to the covered fraction of a pixel, in [0, 1].
    """
    numbers, pixels, weights = blended_pairs(camera, gaussians)
    return csr_matrix(
        (weights.astype(np.float32), (pixels, numbers)), shape=(camera.height * camera.width, len(gaussians))
    )


def blended_pairs(camera: Camera, gaussians: Gaussians) -> tuple[Int64, Int64, Float64]:
    """List what pixels are blended from, pixel by pixel, front to back: Gaussians, flat pixels, weights, (P,) each."""
    seen = footprints(camera, gaussians)
    ranks, pixels, alphas = _pairs(camera, seen)
    order = np.argsort(pixels, kind="stable")  # front to back within each pixel, as the ranks are
    ranks, pixels, alphas = ranks[order], pixels[order], alphas[order]
    through = _transmittance(pixels, alphas)
    kept = through > CLOSED
    return seen.numbers[ranks[kept]], pixels[kept], (alphas * through)[kept]


def footprints(camera: Camera, gaussians: Gaussians) -> Footprints:
    """Project the Gaussians that lie before the camera, and sort them front to back."""
    means = gaussians.means.astype(np.float64)
    centres, depths = project(camera, means)
    ahead = np.flatnonzero((depths > NEAR) & (gaussians.opacities > FAINTEST))
    ahead = ahead[np.argsort(depths[ahead], kind="stable")]
    centres, depths = centres[ahead], depths[ahead]
    covariances = _projected(camera, gaussians, ahead, centres, depths)
    xx, xy, yy = covariances.T
    determinant = np.maximum(xx * yy - xy**2, 1e-12)
    opacities = gaussians.opacities[ahead].astype(np.float64)
    reach = np.sqrt(2.0 * np.log(opacities / FAINTEST))
    radii = reach[:, None] * np.sqrt(np.stack([xx, yy], axis=-1))
    size = np.array([camera.width, camera.height])
    inside = np.all((centres + radii > 0) & (centres - radii < size), axis=-1)
    inverses = np.stack([yy, -xy, xx], axis=-1) / determinant[:, None]
    return Footprints(ahead[inside], centres[inside], inverses[inside], radii[inside], opacities[inside])


def _projected(camera: Camera, gaussians: Gaussians, chosen: Int64, centres: Float64, depths: Float64) -> Float64:
    """Return the covariances (M, 3) (xx, xy, yy) in pixels², low-pass included."""
    axes = Rotation.from_quat(np.roll(gaussians.quats[chosen], -1, axis=-1).astype(np.float64)).as_matrix()
    # Camera axes as pixels run: x to the right, y down, z ahead.
    camera_from_world = np.diag([1.0, -1.0, -1.0]) @ camera.pose()[:3, :3].T
    spread = camera_from_world @ axes * gaussians.scales[chosen].astype(np.float64)[:, None, :]
    # As in the published renderer, the slope is held at 1.3 times the picture's edge: far outside it would explode.
    slopes = (centres - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    limit = 1.3 * 0.5 * np.array([camera.width / camera.fx, camera.height / camera.fy])
    slopes = np.clip(slopes, -limit, limit)
    u = (spread[:, 0] - slopes[:, :1] * spread[:, 2]) * (camera.fx / depths)[:, None]
    v = (spread[:, 1] - slopes[:, 1:] * spread[:, 2]) * (camera.fy / depths)[:, None]
    products = np.stack([np.sum(a * b, axis=-1) for a, b in ((u, u), (u, v), (v, v))], axis=-1)
    return products + np.array([LOW_PASS, 0.0, LOW_PASS])


def _pairs(camera: Camera, seen: Footprints) -> tuple[Int64, Int64, Float64]:
    """List every (footprint, pixel) whose alpha counts, footprint by footprint: ranks, flat pixels, alphas."""
    size = np.array([camera.width, camera.height])
    low = np.clip(np.ceil(seen.centres - seen.radii - 0.5), 0, size).astype(np.int64)
    high = np.clip(np.floor(seen.centres + seen.radii - 0.5) + 1, 0, size).astype(np.int64)
    sides = np.maximum(high - low, 0)
    counts = sides[:, 0] * sides[:, 1]
    ranks = np.repeat(np.arange(len(counts)), counts)
    places = np.arange(len(ranks)) - np.repeat(np.cumsum(counts) - counts, counts)
    rows, columns = np.divmod(places, sides[ranks, 0])
    x, y = low[ranks, 0] + columns, low[ranks, 1] + rows
    dx, dy = x + 0.5 - seen.centres[ranks, 0], y + 0.5 - seen.centres[ranks, 1]
    xx, xy, yy = seen.inverses[ranks].T
    alphas = seen.opacities[ranks] * np.exp(-0.5 * (xx * dx**2 + 2.0 * xy * dx * dy + yy * dy**2))
    alphas = np.minimum(alphas, CAP)
    kept = alphas >= FAINTEST
    return ranks[kept], (y * camera.width + x)[kept], alphas[kept]


def _transmittance(pixels: Int64, alphas: Float64) -> Float64:
    """Return what reaches each entry through those before it in the same pixel; entries sorted by pixel."""
    logs = np.log1p(-alphas)
    before = np.cumsum(logs) - logs
    first = np.flatnonzero(np.diff(pixels, prepend=-1))
    lengths = np.diff(np.append(first, len(pixels)))
    return np.exp(before - np.repeat(before[first], lengths))
