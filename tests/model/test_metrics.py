"""Metrics against closed forms, torchmetrics and the FLIP evaluator's own mean."""

from pathlib import Path
from typing import Literal

import flip_evaluator
import numpy as np
import pytest
import torch
import torchmetrics.functional.image.lpips as reference_lpips
from torch import nn
from torchmetrics.functional.image import peak_signal_noise_ratio, structural_similarity_index_measure

from multilight.datagen.errors import UserError
from multilight.model.evaluation.lpips import Lpips
from multilight.model.evaluation.metrics import MOST_PSNR, Regions, flip_map, mean_scores, measure, psnr, ssim_map


@pytest.fixture
def pair() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 0.8, (48, 64, 3)).astype(np.float32)
    return np.clip(truth + rng.normal(0, 0.05, truth.shape), 0, 1).astype(np.float32), truth


@pytest.fixture
def regions() -> Regions:
    mask = np.zeros((48, 64), np.float32)
    mask[10:20, 10:20] = 1.0
    mask[20, 10:20] = 0.5
    effect = np.zeros((48, 64, 3), np.float32)
    effect[8:30, 10:20, 1] = -0.1
    effect[40:, :, 2] = 0.019
    return Regions.of(mask, effect)


def test_regions_divide_the_picture(regions: Regions) -> None:
    masks = regions.masks
    assert masks["object"].sum() == 100
    assert masks["effect"].sum() == 120
    assert not (masks["object"] & masks["effect"]).any()
    np.testing.assert_array_equal(masks["object and effect"], masks["object"] | masks["effect"])
    np.testing.assert_array_equal(masks["elsewhere"], ~masks["object and effect"])
    assert masks["image"].all()


def test_psnr_of_known_errors(regions: Regions) -> None:
    truth = np.full((48, 64, 3), 0.5, np.float32)
    picture = truth.copy()
    picture[regions.masks["object"]] += 0.1
    scores = measure(picture, truth, regions)
    assert scores["object"]["PSNR"] == pytest.approx(20.0, abs=1e-4)
    assert scores["effect"]["PSNR"] == MOST_PSNR
    share = 100 / (48 * 64)
    assert scores["image"]["PSNR"] == pytest.approx(20.0 - 10 * np.log10(share), abs=1e-4)
    assert scores["object and effect"]["PSNR"] == pytest.approx(20.0 - 10 * np.log10(100 / 220), abs=1e-4)


def test_whole_image_agrees_with_the_usual_definitions(pair: tuple[np.ndarray, np.ndarray], regions: Regions) -> None:
    picture, truth = pair
    scores = measure(picture, truth, regions)["image"]
    a, b = (torch.from_numpy(x.transpose(2, 0, 1).copy())[None] for x in pair)
    assert scores["PSNR"] == pytest.approx(float(peak_signal_noise_ratio(a, b, data_range=1.0)), abs=1e-3)
    ssim = structural_similarity_index_measure(a, b, data_range=1.0)
    assert isinstance(ssim, torch.Tensor)
    assert scores["SSIM"] == pytest.approx(float(ssim), abs=1e-5)
    _, mean, _ = flip_evaluator.evaluate(truth, picture, "LDR", inputsRGB=True)
    assert scores["FLIP"] == pytest.approx(mean, abs=1e-5)


def test_equal_pictures_are_perfect(pair: tuple[np.ndarray, np.ndarray], regions: Regions) -> None:
    scores = measure(pair[1], pair[1], regions)
    for values in scores.values():
        assert values["PSNR"] == MOST_PSNR
        assert values["SSIM"] == pytest.approx(1.0, abs=1e-5)
        assert values["FLIP"] == pytest.approx(0.0, abs=1e-6)


def test_ssim_of_two_flat_pictures() -> None:
    """Without structure only the luminance term is left: (2ab + c) / (a² + b² + c), c = 0.01²."""
    a, b = (np.full((32, 32, 3), value, np.float32) for value in (0.4, 0.6))
    np.testing.assert_allclose(ssim_map(a, b), (2 * 0.24 + 1e-4) / (0.16 + 0.36 + 1e-4), atol=1e-3)


def test_flip_points_at_the_place_of_the_error() -> None:
    truth = np.full((64, 64, 3), 0.5, np.float32)
    picture = truth.copy()
    picture[16:32, 40:56] = (0.9, 0.1, 0.1)
    error = flip_map(picture, truth)
    assert error.shape == (64, 64)
    assert error[24, 48] > 0.5
    assert error[48, 16] < 0.01


def test_psnr_is_cut() -> None:
    assert psnr(0.0) == MOST_PSNR
    assert psnr(0.01) == pytest.approx(20.0)


def test_a_missing_region_does_not_count(regions: Regions) -> None:
    truth = np.full((48, 64, 3), 0.5, np.float32)
    empty = Regions.of(np.zeros((48, 64), np.float32), np.zeros((48, 64, 3), np.float32))
    scores = [measure(truth + 0.1, truth, regions), measure(truth, truth, empty)]
    assert set(scores[1]) == {"image", "elsewhere"}
    means = mean_scores(scores)
    assert means["object"]["PSNR"] == pytest.approx(20.0, abs=1e-3)
    assert means["image"]["PSNR"] == pytest.approx((20.0 + MOST_PSNR) / 2, abs=1e-3)


def test_only_valid_pixels_count(regions: Regions) -> None:
    valid = np.zeros((48, 64), bool)
    valid[12:14, 12:14] = True
    assert regions.within(valid).masks["image"].sum() == 4
    assert not regions.within(valid).masks["effect"].any()


@pytest.mark.parametrize("damage", ["size", "nan"])
def test_bad_pictures_are_told(damage: str, regions: Regions) -> None:
    truth = np.full((48, 64, 3), 0.5, np.float32)
    picture = truth[:-1] if damage == "size" else truth * np.float32("nan")
    with pytest.raises(UserError, match="equal size" if damage == "size" else "NaN"):
        measure(picture, truth, regions)


def _features(net: str) -> nn.Sequential:
    """Lay out torchvision's `features` with random weights."""
    torch.manual_seed(0)
    if net == "alexnet":
        return nn.Sequential(
            *(nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU()),
            *(nn.MaxPool2d(3, 2), nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(), nn.Conv2d(384, 256, 3, padding=1)),
            *(nn.ReLU(), nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(), nn.MaxPool2d(3, 2)),
        )
    layers: list[nn.Module] = []
    width = 3
    for stage in ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512)):
        for channels in stage:
            layers += [nn.Conv2d(width, channels, 3, padding=1), nn.ReLU()]
            width = channels
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers)


@pytest.mark.parametrize(("net", "short"), [("vgg16", "vgg"), ("alexnet", "alex")])
def test_lpips_agrees_with_torchmetrics(
    net: str,
    short: Literal["vgg", "alex"],
    pair: tuple[np.ndarray, np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The same random backbone in both; the heads are the published ones."""
    features = _features(net)
    path = tmp_path / f"{net}.pth"
    torch.save({f"features.{name}": value for name, value in features.state_dict().items()}, path)
    monkeypatch.setattr(reference_lpips, "_get_tv_model_features", lambda *_: features)
    theirs = reference_lpips._LPIPS(net=short, spatial=True)
    a, b = (torch.from_numpy(x.transpose(2, 0, 1).copy())[None] for x in pair)
    with torch.inference_mode():
        expected = theirs(a, b, normalize=True)[0, 0].numpy()
    mine = Lpips.load(path).difference_map(*pair)
    assert expected.max() > 0
    np.testing.assert_allclose(mine, expected, rtol=1e-3, atol=1e-7)


def test_other_weights_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.pth"
    torch.save({"features.0.weight": torch.zeros(64, 3, 3, 3)}, path)
    with pytest.raises(UserError, match="vgg16"):
        Lpips.load(path)
    with pytest.raises(UserError, match="cannot be read"):
        Lpips.load(tmp_path / "missing.pth")
