"""The pictures that a user wants harmonized; imports no torch."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Files:
    """One's own pictures, all of one size; depth is measured, or estimated by a model, or guessed."""

    composite: Path
    """Picture with the object pasted in."""
    background: Path
    """The same picture without the object."""
    mask: Path
    """Where the object is: white on black."""
    depth: Path | None = None
    """Depth of the composite in any unit, far is large, 0 where unknown: PNG or TIFF of one channel, .exr, or .npy."""
    depth_model: Path | None = None
    """Instead: ONNX model that estimates it (Depth Anything V2's layout)."""
