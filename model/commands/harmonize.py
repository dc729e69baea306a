"""`multilight harmonize`: relight a pasted object in one's own picture, and give it its shadows."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(kw_only=True)
class Harmonize:
    """Harmonize one picture into which an object was pasted, of any size."""

    composite: Path
    """Picture with the object pasted in."""
    background: Path
    """The same picture without the object."""
    mask: Path
    """Where the object is: white on black."""
    out: Path
    """Picture to write."""
    depth: Path | None = None
    """Depth of the composite in any unit, 0 where unknown: PNG or TIFF of one channel, or .npy."""
    depth_model: Path | None = None
    """Instead: ONNX model that estimates it (Depth Anything V2's layout)."""
    weights: Path | None = None
    """Weights of the model (default: the ready-made ones)."""
    device: str = "auto"
    """Device of the model: auto, cpu, or cuda."""

    def run(self) -> int:
        """Harmonize and return the exit code."""
        from multilight.model.inference.harmonize import DEFAULT_WEIGHTS, Files, harmonize_files

        files = Files(self.composite, self.background, self.mask, self.depth, self.depth_model)
        harmonize_files(files, self.weights or DEFAULT_WEIGHTS, self.out, self.device)
        print(f"harmonized: {self.out}")
        return 0
