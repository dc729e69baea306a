"""Losses against closed forms and independent implementations; VGG19 weights in both file formats."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import savemat
from torch import Tensor, nn
from torch.nn import functional
from torchmetrics.functional.image import structural_similarity_index_measure

from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import LossConfig
from multilight.model.training.losses import CompositingLoss, StructureDistance, by_region, glow_loss, ssim
from multilight.model.training.vgg import VGG19Features, load_vgg19
from tests.model.test_training import a_batch

LAYERS = (64, 64, "pool", 128, 128, "pool", 256, 256, 256, 256, "pool", 512, 512, 512, 512, "pool", 512, 512, 512, 512)


def rand(*shape: int, seed: int = 0) -> Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def weights() -> list[tuple[Tensor, Tensor]]:
    """Sixteen convolutions of VGG19 with random weights that keep the signal's size."""
    rng, channels, result = torch.Generator().manual_seed(0), 3, []
    for width in LAYERS:
        if isinstance(width, int):
            kernel = torch.randn(width, channels, 3, 3, generator=rng) * (2 / (9 * channels)) ** 0.5
            result.append((kernel, 0.1 * torch.randn(width, generator=rng)))
            channels = width
    return result


def write_torchvision(path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    """As torchvision.models.vgg19().state_dict(): convolutions, ReLUs and poolings are numbered together."""
    number, state, pairs = 0, {"classifier.0.bias": torch.zeros(4)}, iter(weights)
    for width in LAYERS:
        if isinstance(width, int):
            state[f"features.{number}.weight"], state[f"features.{number}.bias"] = next(pairs)
        number += 2 if isinstance(width, int) else 1
    torch.save(state, path)


def write_matconvnet(path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    """As imagenet-vgg-verydeep-19.mat: a cell array of structs, kernels (height, width, in, out)."""
    layers, pairs = [], iter(weights)
    for width in LAYERS:
        if isinstance(width, int):
            kernel, bias = next(pairs)
            cell = np.empty((1, 2), object)
            cell[0, 0], cell[0, 1] = kernel.permute(2, 3, 1, 0).numpy(), bias.numpy()[None]
            layers += [{"type": "conv", "name": "c", "weights": cell}, {"type": "relu", "name": "r"}]
        else:
            layers.append({"type": "pool", "name": "p"})
    cells = np.empty((1, len(layers)), object)
    cells[0] = layers
    savemat(path, {"layers": cells})


def plain_features(image: Tensor, weights: list[tuple[Tensor, Tensor]]) -> list[Tensor]:
    """VGG19 layer by layer, the second feature of every block kept."""
    kept, pairs, place = [], iter(weights), 0
    for width in LAYERS[:18]:
        if isinstance(width, int):
            kernel, bias = next(pairs)
            image = nn.functional.conv2d(image, kernel, bias, padding=1).relu()
            place += 1
            if place == 2:
                kept.append(image)
        else:
            image, place = nn.functional.avg_pool2d(image, 2), 0
    return kept


def test_vgg19_from_torchvision(tmp_path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    write_torchvision(tmp_path / "vgg19.pth", weights)
    image = rand(1, 3, 32, 48)
    mean, std = (torch.tensor(v).view(1, 3, 1, 1) for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    expected = plain_features(57.6 * (image - mean) / std, weights)
    for found, wanted in zip(load_vgg19(tmp_path / "vgg19.pth")(image), expected, strict=True):
        assert torch.allclose(found, wanted, rtol=1e-4, atol=1e-3)


def test_vgg19_from_matconvnet(tmp_path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    write_matconvnet(tmp_path / "vgg.mat", weights)
    image = rand(1, 3, 32, 48)
    mean = torch.tensor([123.68, 116.779, 103.939]).view(1, 3, 1, 1)
    expected = plain_features(255 * image - mean, weights)
    for found, wanted in zip(load_vgg19(tmp_path / "vgg.mat")(image), expected, strict=True):
        assert torch.allclose(found, wanted, rtol=1e-4, atol=1e-2)


def test_published_loss_in_numbers(tmp_path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    write_matconvnet(tmp_path / "vgg.mat", weights)
    loss = CompositingLoss(LossConfig(pixels="mse", vgg=tmp_path / "vgg.mat"))
    assert loss.label == "vgg19"
    image, target = rand(2, 3, 32, 32), rand(2, 3, 32, 32, seed=1)
    mean = torch.tensor([123.68, 116.779, 103.939]).view(1, 3, 1, 1)
    a, b = (plain_features(255 * x - mean, weights) for x in (image, target))
    distances = [(x - y).abs().mean() for x, y in zip(a, b, strict=True)]
    terms = torch.stack(
        [
            255 * (image - target).abs().mean(),
            *(d / s for d, s in zip(distances, (2.6, 4.8, 3.7, 5.6, 0.15), strict=True)),
        ]
    )
    found = loss(image, target, torch.ones(2, 1, 32, 32), torch.zeros(2, 3, 32, 32))
    assert torch.allclose(found["perceptual"].mean(), terms.sum() / 255, rtol=1e-4)
    assert torch.allclose(found["loss"].mean(), ((image - target) ** 2).mean() + 0.05 * terms.sum() / 255, rtol=1e-4)


class Surprise:
    """What must not run when a file is read."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return eval, ("1/0",)


def test_damaged_weights_are_named(tmp_path: Path, weights: list[tuple[Tensor, Tensor]]) -> None:
    path = tmp_path / "weights.pth"
    with pytest.raises(UserError, match=r"weights\.pth do not exist"):
        load_vgg19(path)
    torch.save({"evil": Surprise()}, path)
    with pytest.raises(UserError, match=r"weights\.pth cannot be read"):
        load_vgg19(path)
    write_torchvision(path, [(w[..., :1], b) for w, b in weights])
    with pytest.raises(UserError, match="convolution 0 is"):
        load_vgg19(path)
    torch.save({"features.0.weight": torch.zeros(1)}, path)
    with pytest.raises(UserError, match="1 convolutions"):
        load_vgg19(path)


def test_ssim_agrees_with_torchmetrics() -> None:
    a = rand(2, 3, 40, 52)
    b = (a + 0.2 * rand(2, 3, 40, 52, seed=3)).clamp(0, 1)
    # A Gaussian of large sigma, cut to 7 pixels, is the uniform window; torchmetrics divides by n, as we do.
    wanted = structural_similarity_index_measure(
        a, b, gaussian_kernel=False, kernel_size=7, data_range=1.0, reduction="none"
    )
    assert isinstance(wanted, Tensor)
    assert torch.allclose(ssim(a, b), wanted, atol=2e-3)
    assert torch.allclose(ssim(a, a), torch.ones(2))


def test_stand_in_is_zero_for_equal_pictures_and_sees_a_lost_edge() -> None:
    distance = StructureDistance()
    target = torch.zeros(1, 3, 32, 32)
    target[..., 16:] = 1.0
    blurred = nn.functional.avg_pool2d(target, 9, 1, 4, count_include_pad=False)
    assert distance(target, target).abs().max() < 1e-6
    assert distance(blurred, target) > 5 * distance(0.98 * target, target)


def test_errors_are_averaged_over_the_object_its_effect_and_the_rest() -> None:
    mask, effect, error = torch.zeros(2, 1, 8, 8), torch.zeros(2, 3, 8, 8), torch.ones(2, 3, 8, 8)
    mask[:, :, :2] = 1
    error[:, :, :2] = 3.0
    effect[:, :, 1] = 0.3  # where the object is, no effect counts
    effect[0, 1, 4] = -0.02  # a shadow in the first picture only; as seen as not
    error[0, :, 4] = 7.0
    found, shadow, rest = by_region(error, mask, effect)
    assert torch.allclose(found, torch.tensor([3.0, 3.0]))
    assert torch.allclose(shadow, torch.tensor([7.0, 0.0]))
    assert torch.allclose(rest, torch.tensor([(40 + 4 * 7) / 44, 1.0]))


def test_a_shadow_counts_however_wrong_the_object_is() -> None:
    loss = CompositingLoss(LossConfig(perceptual=0))
    mask, effect = torch.zeros(1, 1, 16, 16), torch.zeros(1, 3, 16, 16)
    mask[:, :, :4], effect[:, :, 8:] = 1, -0.5
    gained = []
    for wrong in (0.0, 0.4):
        without = loss(wrong * mask.expand(1, 3, -1, -1) - effect, 0 * effect, mask, effect)["pixels"]
        gained.append(without - loss(wrong * mask.expand(1, 3, -1, -1), 0 * effect, mask, effect)["pixels"])
    assert gained[1] > 0.5 * gained[0]


def test_glow_is_judged_on_the_object_alone() -> None:
    batch = a_batch(2)
    batch.glow[1] = batch.mask[1]
    sure = torch.full((2, 1, 16, 16), 20.0)
    torch.testing.assert_close(glow_loss(sure, batch), torch.tensor([20.0, 0.0]), atol=1e-4, rtol=0)
    torch.testing.assert_close(glow_loss(0 * sure, batch), torch.full((2,), math.log(2)))
    outside = torch.where(functional.avg_pool2d(batch.mask, 2) > 0, -20.0, 20.0)
    torch.testing.assert_close(glow_loss(outside, batch), torch.tensor([0.0, 20.0]), atol=1e-4, rtol=0)


def test_a_small_object_counts_like_a_large_one() -> None:
    loss = CompositingLoss(LossConfig(perceptual=0))
    target = torch.zeros(2, 3, 32, 32)
    image, mask = target.clone(), torch.zeros(2, 1, 32, 32)
    mask[0, :, :2, :2], mask[1, :, :20, :20] = 1, 1
    image = image + 0.3 * mask
    small, large = loss(image, target, mask, image - target)["pixels"]
    assert torch.allclose(small, large)


def test_loss_without_effect_is_squared_error_and_labelled() -> None:
    loss = CompositingLoss(LossConfig(pixels="mse", perceptual=0))
    image, target = rand(3, 3, 16, 16), rand(3, 3, 16, 16, seed=1)
    found = loss(image, target, torch.zeros(3, 1, 16, 16), torch.zeros(3, 3, 16, 16))
    assert loss.label == "none"
    assert torch.allclose(found["loss"], ((image - target) ** 2).mean(dim=(1, 2, 3)))
    assert CompositingLoss(LossConfig()).label == "gradient+ssim"


def test_vgg_is_frozen() -> None:
    features = VGG19Features((0.0,) * 3, (1.0,) * 3)
    assert not any(p.requires_grad for p in features.parameters())
    image = rand(1, 3, 32, 32).requires_grad_()
    sum(f.mean() for f in features(image)).backward()
    assert image.grad is not None
    assert image.grad.abs().sum() > 0


def test_logarithmic_loss_follows_psnr() -> None:
    """Ten times the error costs the same number of dB, whatever the picture, beyond the knee."""
    loss = CompositingLoss(LossConfig(perceptual=0, pixels="log"))
    target = torch.zeros(4, 3, 16, 16)
    image = torch.tensor([1e-6, 1e-2, 1e-1, 1.0]).sqrt().view(4, 1, 1, 1).expand_as(target)
    values = loss(image, target, torch.ones(4, 1, 16, 16), torch.zeros_like(target))["loss"]
    assert values[0] == pytest.approx(5e-6, rel=1e-2)
    assert values[3] - values[2] == pytest.approx(0.005 * np.log(10), rel=0.02)
