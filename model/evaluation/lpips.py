"""LPIPS without torchvision: the backbone from a file that the user has, the linear heads from torchmetrics."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torchmetrics
from torch import Tensor, nn

from multilight.datagen.errors import UserError
from multilight.scenes.arrays import Float32

_VGG16 = ((0, 2), (5, 7), (10, 12, 14), (17, 19, 21), (24, 26, 28))
_ALEX = ((0,), (3,), (6,), (8,), (10,))
"""Numbers of the convolutions in torchvision's `features`, by the stage after whose last one LPIPS looks."""
_PADDED = {"padding": 1}
_ALEX_OPTIONS = {0: {"stride": 4, "padding": 2}, 3: {"padding": 2}}
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


@dataclass(frozen=True)
class Lpips:
    """Learned perceptual distance (R. Zhang et al., The Unreasonable Effectiveness of Deep Features, 2018, v0.1).

    `net` is vgg or alex, `weights` the backbone's (torchvision's names), `heads` the linear weights of five stages.
    """

    net: str
    weights: dict[str, Tensor]
    heads: tuple[Tensor, ...]

    @classmethod
    def load(cls, path: Path) -> "Lpips":
        """Read a torchvision state dict of VGG16 or AlexNet (a .pth file); raises `UserError` for anything else."""
        try:
            weights = torch.load(path, map_location="cpu", weights_only=True)
        except Exception as error:  # pickles fail in many ways
            raise UserError(f"{path} cannot be read as weights that torch saved: {type(error).__name__}") from None
        shape = tuple(weights["features.0.weight"].shape) if "features.0.weight" in weights else ()
        net = {(64, 3, 3, 3): "vgg", (64, 3, 11, 11): "alex"}.get(shape, "")
        wanted = [f"features.{n}.{part}" for stage in _stages(net) for n in stage for part in ("weight", "bias")]
        if not net or any(name not in weights for name in wanted):
            raise UserError(f"{path} holds neither torchvision's vgg16 nor its alexnet; give the state dict of either")
        return cls(net, {name: weights[name].float() for name in wanted}, _heads(net))

    @torch.inference_mode()
    def difference_map(self, picture: Float32, truth: Float32) -> Float32:
        """Return the distance at each pixel, (H, W): the sum over stages, each scaled up bilinearly.

        Pictures (H, W, 3) in [0, 1]. The mean over the picture is LPIPS up to the scaling.
        """
        pair = torch.from_numpy(np.stack([picture, truth]).transpose(0, 3, 1, 2)) * 2.0 - 1.0
        shift, scale = (torch.tensor(values)[None, :, None, None] for values in (_SHIFT, _SCALE))
        total = torch.zeros(1, 1, *picture.shape[:2])
        for features, head in zip(self._features((pair - shift) / scale), self.heads, strict=True):
            unit = features / torch.sqrt(1e-8 + features.square().sum(dim=1, keepdim=True))
            distance = nn.functional.conv2d((unit[:1] - unit[1:]).square(), head)
            total += nn.functional.interpolate(distance, picture.shape[:2], mode="bilinear", align_corners=False)
        return total[0, 0].numpy()

    def _features(self, x: Tensor) -> list[Tensor]:
        found = []
        for number, stage in enumerate(_stages(self.net)):
            if self.net == "vgg" and number > 0:
                x = nn.functional.max_pool2d(x, 2)
            elif self.net == "alex" and number in (1, 2):
                x = nn.functional.max_pool2d(x, 3, stride=2)
            for n in stage:
                options = _ALEX_OPTIONS.get(n, _PADDED) if self.net == "alex" else _PADDED
                weight, bias = (self.weights[f"features.{n}.{part}"] for part in ("weight", "bias"))
                x = nn.functional.relu(nn.functional.conv2d(x, weight, bias, **options))
            found.append(x)
        return found


def _stages(net: str) -> tuple[tuple[int, ...], ...]:
    return {"vgg": _VGG16, "alex": _ALEX}.get(net, ())


def _heads(net: str) -> tuple[Tensor, ...]:
    path = Path(torchmetrics.__file__).parent / "functional" / "image" / "lpips_models" / f"{net}.pth"
    heads = torch.load(path, map_location="cpu", weights_only=True)
    return tuple(heads[f"lin{number}.model.1.weight"] for number in range(5))
