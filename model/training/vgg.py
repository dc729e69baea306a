"""The convolutional part of VGG19 (Simonyan and Zisserman 2015), with weights from a file the user has."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.datagen.errors import UserError

WIDTHS = ((64, 2), (128, 2), (256, 4), (512, 4), (512, 4))
"""Channels and number of the 3 x 3 convolutions between two poolings; conv5_2 is the last that is used."""

CONVOLUTIONS = 14
MATCONVNET_MEAN = (123.68, 116.779, 103.939)  # RGB, for pictures in [0, 255]
TORCHVISION_MEAN, TORCHVISION_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


class VGG19Features(nn.Module):
    """Features after the ReLU of conv1_2, conv2_2, conv3_2, conv4_2 and conv5_2, frozen.

    Poolings average, as is usual for losses (Gatys et al. 2016) and in the published training. `mean` and `std` bring
    display-encoded RGB in [0, 1] to what the weights were trained on.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, mean: tuple[float, ...], std: tuple[float, ...]) -> None:
        super().__init__()
        widths = [3, *itertools.chain.from_iterable([width] * count for width, count in WIDTHS)][: CONVOLUTIONS + 1]
        self.convolutions = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in itertools.pairwise(widths))
        self.register_buffer("mean", torch.tensor(mean).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor(std).view(1, 3, 1, 1))
        self.requires_grad_(False)

    def forward(self, image: Tensor) -> list[Tensor]:
        """Map (B, 3, H, W) in [0, 1] to five maps of 64, 128, 256, 512, 512 channels, each half as large."""
        x = (image - self.mean) / self.std
        kept = []
        convolutions = iter(self.convolutions)
        for block, (_, count) in enumerate(WIDTHS):
            x = functional.avg_pool2d(x, 2) if block else x
            for number, conv in enumerate(itertools.islice(convolutions, count)):
                x = conv(x).relu()
                if number == 1:
                    kept.append(x)
        return kept


def load_vgg19(path: Path) -> VGG19Features:
    """Read VGG19's weights: torchvision's state dictionary (.pth) or MatConvNet's `imagenet-vgg-verydeep-19.mat`.

    Nothing in the file is run. Raises `UserError` naming the file and what is wrong with it.
    """
    if not path.is_file():
        raise UserError(f"VGG19 weights {path} do not exist; leave `loss.vgg` out to train with the stand-in")
    try:
        pairs = _matconvnet(path) if path.suffix == ".mat" else _torchvision(path)
    except Exception as error:  # whatever a damaged or foreign file makes the readers raise
        raise UserError(f"VGG19 weights {path} cannot be read: {error!r}"[:400]) from error
    if path.suffix == ".mat":
        network = VGG19Features(tuple(v / 255 for v in MATCONVNET_MEAN), (1 / 255,) * 3)
    else:
        # Scaled so that features are about as large as MatConvNet's, which the loss' weights were made for.
        network = VGG19Features(TORCHVISION_MEAN, tuple(v / 57.6 for v in TORCHVISION_STD))
    for number, (conv, (weight, bias)) in enumerate(zip(network.convolutions, pairs, strict=True)):
        assert isinstance(conv, nn.Conv2d)
        if weight.shape != conv.weight.shape or bias.shape != conv.bias.shape:  # type: ignore[union-attr]
            raise UserError(
                f"VGG19 weights {path}: convolution {number} is {tuple(weight.shape)}, not {tuple(conv.weight.shape)}"
            )
        conv.weight.data.copy_(weight)
        conv.bias.data.copy_(bias)  # type: ignore[union-attr]
    return network.eval()


def _torchvision(path: Path) -> list[tuple[Tensor, Tensor]]:
    state: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    numbers = sorted(int(k.split(".")[1]) for k in state if k.startswith("features.") and k.endswith(".weight"))
    if len(numbers) < CONVOLUTIONS:
        raise ValueError(f"has {len(numbers)} convolutions named features.N.weight, VGG19 has 16")
    return [(state[f"features.{n}.weight"], state[f"features.{n}.bias"]) for n in numbers[:CONVOLUTIONS]]


def _matconvnet(path: Path) -> list[tuple[Tensor, Tensor]]:
    from scipy.io import loadmat

    layers: list[Any] = list(loadmat(path, struct_as_record=False, squeeze_me=True)["layers"])
    pairs: list[tuple[Tensor, Tensor]] = []
    for layer in layers:
        if getattr(layer, "type", "") == "conv" and len(pairs) < CONVOLUTIONS:
            weight, bias = layer.weights  # (kh, kw, in, out) and (out)
            pairs.append(
                (torch.from_numpy(np.ascontiguousarray(weight.transpose(3, 2, 0, 1))), torch.from_numpy(bias.ravel()))
            )
    if len(pairs) < CONVOLUTIONS:
        raise ValueError(f"has {len(pairs)} convolutions, VGG19 has 16")
    return pairs
