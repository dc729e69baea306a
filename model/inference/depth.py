"""The depth that networks see, from measured depth, from an ONNX model of the user's, or guessed."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from multilight.datagen.errors import UserError
from multilight.model.inference.pictures import resized
from multilight.scenes.arrays import Float32

if TYPE_CHECKING:
    import onnxruntime


PATCH = 14
"""Side of the patches of Depth Anything V2's backbone (DINOv2): its input is a multiple of it."""
SHORT_SIDE = 518
"""Shorter side at which Depth Anything V2 works."""
FARTHEST = 0.02
"""Relative inverse depths below this fraction of the largest count as infinitely far."""
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_SPREAD = np.array([0.229, 0.224, 0.225], np.float32)


def depth_from_metres(z_depth: Float32) -> Float32:
    """Scale z_depth (H, W), 0 where nothing or unknown, to what networks see: at most 1, and 1 where it was 0."""
    return np.where(z_depth > 0, z_depth / max(float(z_depth.max()), 1e-6), 1.0).astype(np.float32)


def depth_from_inverse(inverse: Float32) -> Float32:
    """Turn relative inverse depth (H, W; larger is nearer, any scale) into what networks see: 1 at the far end."""
    largest = float(inverse.max())
    if not largest > 0:
        raise UserError(f"the depth model found no depth: its largest inverse depth is {largest:g}")
    far = max(float(np.percentile(inverse, 1.0)), FARTHEST * largest)
    return (far / np.maximum(inverse, far)).astype(np.float32)


def guessed_depth(height: int, width: int) -> Float32:
    """Return the depth of level ground seen at a slant, (H, W): 1 at the top, one half at the bottom.

    On a plane the inverse depth is linear in the picture.
    """
    inverse = 1.0 + (np.arange(height, dtype=np.float32) + 0.5) / height
    return np.broadcast_to((1.0 / inverse)[:, None], (height, width)).astype(np.float32)


@dataclass(frozen=True)
class DepthModel:
    """A monocular depth model in ONNX with the layout of Depth Anything V2 (L. Yang et al., 2024).

    Input 1 x 3 x H x W, sRGB with ImageNet's mean and spread taken out, H and W fixed or multiples of 14; output
    relative inverse depth, 1 x H x W or 1 x 1 x H x W.
    """

    path: Path
    session: "onnxruntime.InferenceSession" = field(repr=False)

    @classmethod
    def load(cls, path: Path) -> "DepthModel":
        """Open a model; raises `UserError` where the file is missing, no ONNX model, or of another layout.

        onnxruntime is imported here: training and evaluation do without it.
        """
        try:
            import onnxruntime
        except ModuleNotFoundError:
            raise UserError("depth models need onnxruntime: pip install 'multilight[captures]'") from None
        if not path.is_file():
            raise UserError(f"depth model {path} does not exist")
        try:
            session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime has an exception class for each of its codes
            reason = str(error).splitlines()[0].rpartition(" : ")[2]
            raise UserError(f"depth model {path} cannot be opened: {reason}") from None
        shapes = [put.shape for put in session.get_inputs()]
        if len(shapes) != 1 or len(shapes[0]) != 4 or shapes[0][1] not in (3, "3"):
            raise UserError(f"depth model {path} has inputs of shape {shapes}; expected one of 1 x 3 x H x W")
        return cls(path, session)

    def estimate(self, picture: Float32) -> Float32:
        """Estimate the depth of a picture (H, W, 3) in [0, 1] as networks see it: (H, W) float32 in [0, 1]."""
        put = self.session.get_inputs()[0]
        small = (resized(picture, self._size(picture.shape[:2], put.shape)) - _MEAN) / _SPREAD
        try:
            found = self.session.run(None, {put.name: np.ascontiguousarray(small.transpose(2, 0, 1)[None])})[0]
        except Exception as error:  # see above
            reason = str(error).splitlines()[0]
            raise UserError(f"depth model {self.path} failed on an input of {small.shape[:2]}: {reason}") from None
        inverse = np.asarray(found, np.float32).squeeze()
        if inverse.ndim != 2 or not np.isfinite(inverse).all():
            raise UserError(f"depth model {self.path} gave an output of shape {np.shape(found)}, or one with NaN")
        return depth_from_inverse(resized(inverse, (picture.shape[0], picture.shape[1])))

    def _size(self, size: tuple[int, ...], shape: list[int | str]) -> tuple[int, int]:
        """Return the (height, width) to work at: the model's own where fixed, else multiples of 14 near 518."""
        scale = SHORT_SIDE / min(size)
        free = [max(1, round(length * scale / PATCH)) * PATCH for length in size]
        height, width = (fixed if isinstance(fixed, int) else own for fixed, own in zip(shape[2:], free, strict=True))
        return height, width
