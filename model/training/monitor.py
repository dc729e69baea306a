"""What one sees of a training: the validation's figure, sample pictures, the log."""

from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

from multilight.datagen.files.outputs import written
from multilight.model.evaluation.metrics import EFFECT, MOST_PSNR
from multilight.model.training.batches import Batch

SHOWN = 6  # rows of a sheet of sample pictures


def regional_psnr(image: Tensor, target: Tensor, mask: Tensor, effect: Tensor) -> Tensor:
    """Return each picture's PSNR [dB] on the object and where it changes the picture visibly: (B,).

    Pictures (B, 3, H, W), mask (B, 1, H, W); the region is `object and effect` of `model.evaluation.metrics`.
    """
    region = (mask > 0.5) | (effect.abs().amax(dim=1, keepdim=True) > EFFECT)
    squared = ((image - target) ** 2).mean(dim=1, keepdim=True) * region
    mean = squared.flatten(1).sum(1) / region.flatten(1).sum(1).clamp(min=1)
    return (-10.0 * mean.clamp(min=1e-12).log10()).clamp(max=MOST_PSNR)


def sample_sheet(batch: Batch, image: Tensor) -> Tensor:
    """Show background, composite, `image`, target and four times its error, a row a sample: (3, R*S, 5*S)."""
    error = (4.0 * (image - batch.target).abs()).clamp(max=1.0)
    rows = torch.cat((batch.background, batch.composite, image, batch.target, error), dim=3)[:SHOWN]
    return torch.cat(list(rows), dim=1).cpu()


class Log:
    """A training's log: lines on standard output, TensorBoard files and PNG sheets in the folder."""

    def __init__(self, folder: Path, *, quiet: bool = False) -> None:
        from torch.utils.tensorboard import SummaryWriter

        self.folder, self.quiet = folder, quiet
        self._board = None if quiet else SummaryWriter(str(folder / "tensorboard"))

    def line(self, text: str) -> None:
        """Print a line (of the first process only)."""
        if not self.quiet:
            print(text, flush=True)

    def scalars(self, values: dict[str, float], step: int) -> None:
        """Record numbers by name."""
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(name, value, step)

    def sheet(self, picture: Tensor, step: int) -> None:
        """Write a sheet (3, H, W) in [0, 1] as `samples/000123.png` and show it in TensorBoard."""
        if self._board is None:
            return
        values = (picture.clamp(0, 1) * 255).round().byte()
        path = self.folder / "samples" / f"{step:06d}.png"
        with written(path) as work:
            Image.fromarray(values.permute(1, 2, 0).numpy()).save(work)
        self._board.add_image("samples", values, step)

    def close(self) -> None:
        """Write out what is still in memory."""
        if self._board is not None:
            self._board.close()
