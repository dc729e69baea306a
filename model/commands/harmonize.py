"""`multilight harmonize`: relight a pasted object in one's own picture, and give it its shadows."""

from dataclasses import dataclass
from pathlib import Path

from multilight.model.inference.files import Files


@dataclass(frozen=True, kw_only=True)
class Harmonize(Files):
    """Harmonize one picture into which an object was pasted, of any size."""

    out: Path
    """Picture to write."""
    weights: Path = Path("slim")
    """Weights of the model: a file, or ready-made ones by name."""
    device: str = "auto"
    """Device of the model: auto, cpu, or cuda."""

    def run(self) -> int:
        """Harmonize and return the exit code."""
        from multilight.datagen.commands.output import print_written, progress
        from multilight.model.configs.ready_made import check_device, weights_config
        from multilight.model.configs.stage2d import NetworkConfig
        from multilight.model.inference.pictures import check_picture, write_picture
        from multilight.model.inference.read import read_files

        check_picture(self.out)
        check_device(self.device)
        weights_config(self.weights, NetworkConfig)
        pictures = read_files(self)
        with progress("pictures", "harmonizing"):
            from multilight.model.inference.harmonize import network_harmonizer

            picture = network_harmonizer(self.weights, self.device)(*pictures)
        write_picture(self.out, picture)
        print_written(self.out, f"{picture.shape[1]} x {picture.shape[0]} pixels, harmonized")
        return 0
