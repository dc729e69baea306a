"""`multilight harmonize`: relight a pasted object in one's own picture, and give it its shadows."""

from dataclasses import dataclass
from pathlib import Path

from multilight.model.inference.files import Files


@dataclass(frozen=True, kw_only=True)
class Harmonize(Files):
    """Harmonize one picture into which an object was pasted, of any size."""

    out: Path
    """Picture to write."""
    weights: Path | None = None
    """Weights of the model (default: the ready-made ones)."""
    device: str = "auto"
    """Device of the model: auto, cpu, or cuda."""

    def run(self) -> int:
        """Harmonize and return the exit code."""
        from multilight.model.inference.harmonize import DEFAULT_WEIGHTS, harmonize_files

        harmonize_files(self, self.weights or DEFAULT_WEIGHTS, self.out, self.device)
        print(f"harmonized: {self.out}")
        return 0
