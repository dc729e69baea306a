"""What a backend returns: per-light linear layers and geometry buffers of one view."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32


@dataclass(frozen=True)
class GeometryBuffers:
    """What the ray through each pixel's centre hits first, H x W.

    z_depth float32, metres along the optical axis, 0 where there is nothing; normal_world (H, W, 3) float32 unit
    (shading normal, on the camera's side), 0 where nothing; albedo (H, W, 3) float32 linear base colour;
    roughness, metallic float32 in [0, 1]; instance_id uint16, the body's position in the scene plus one,
    0 where there is nothing. `environment` float32 in [0, 1] is the fraction of the pixel's area that sees no geometry.
    """

    z_depth: Float32
    normal_world: Float32
    albedo: Float32
    roughness: Float32
    metallic: Float32
    instance_id: NDArray[np.uint16]
    environment: Float32


@dataclass(frozen=True)
class LayerStack:
    """One rendered variant of one view.

    radiance (L, H, W, 3) float32 linear Rec.709, one layer a light in the rig's order; combined (H, W, 3) float32,
    the renderer's own picture with all lights on. `geometry` comes with variant `all`. `coverage` (H, W) float32
    in [0, 1] comes with variant `foreground_<object>`: the fraction of the pixel's area it covers; the radiance is
    then the object's alone, premultiplied by it. `shown` (H, W) float32 in [0, 1] comes with variant
    `without_<object>` of a renderer that knows it: the fraction of the pixel's samples that would show the object if it
    were there, straight, in a mirror or through glass. guide_albedo, guide_normal (H, W, 3) float32: smooth guides
    for the denoiser.
    """

    lights: tuple[str, ...]
    radiance: Float32
    combined: Float32
    geometry: GeometryBuffers | None = None
    coverage: Float32 | None = None
    shown: Float32 | None = None
    guide_albedo: Float32 | None = None
    guide_normal: Float32 | None = None
