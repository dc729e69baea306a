"""Residuals: closed forms of what is missing, none in what noise explains, and small or faint faults found in noise."""

import numpy as np
import pytest

from multilight.datagen.verification import residuals
from multilight.datagen.verification.residuals import FAINT, GREY, noise_variance


def residual(stored: np.ndarray, rendered: np.ndarray, where: np.ndarray) -> float:
    return residuals.residual(stored, rendered, where)[0]


EVERYWHERE = np.ones((96, 128), bool)


def flat(*colour: float) -> np.ndarray:
    return np.broadcast_to(np.array(colour, np.float32), (96, 128, 3)).copy()


def dotted(picture: np.ndarray, rate: float, seed: int = 0) -> np.ndarray:
    """The picture as rendered by few paths: bright dots, `rate` of the pixels, that keep its mean."""
    rng = np.random.default_rng(seed)
    hits = (rng.random(picture.shape[:2]) < rate) / rate * rng.gamma(2.0, 0.5, picture.shape[:2])
    return (picture * hits[..., None]).astype(np.float32)


def test_without_noise_it_is_the_difference_over_the_local_radiance() -> None:
    rendered, stored = flat(0.5, 0.4, 0.3), flat(0.5, 0.4, 0.4)
    assert residual(rendered, rendered, EVERYWHERE) == 0
    assert residual(stored, rendered, EVERYWHERE) == pytest.approx(0.1 / (0.3 + (GREY + FAINT) * 0.4), rel=1e-4)


def test_only_pixels_that_count_do() -> None:
    rendered, stored = flat(0.5, 0.4, 0.3), flat(0.5, 0.4, 0.3)
    square = np.zeros_like(EVERYWHERE)
    square[30:50, 38:58] = True
    stored[square] = 1.0
    assert residual(stored, rendered, ~square) == 0
    assert residual(stored, rendered, square) > 1
    assert residual(stored, rendered, np.zeros_like(square)) == 0


@pytest.mark.parametrize("rate", [1.0, 0.1, 0.01, 0.005])
def test_noise_alone_is_no_residual(rate: float) -> None:
    """Also that of rare dots, of which many blocks have none."""
    picture = flat(0.5, 0.4, 0.3) * np.linspace(0.2, 2.0, 128, dtype=np.float32)[None, :, None]
    worst = max(residual(picture, dotted(picture, rate, seed), EVERYWHERE) for seed in range(20))
    assert worst < 0.3


@pytest.mark.parametrize(("rate", "side"), [(1.0, 8), (0.3, 16), (0.1, 32)])
def test_a_ghost_is_found_in_noise(rate: float, side: int) -> None:
    """Of another hue and equal in the mean over the channels."""
    picture, ghost = flat(0.1, 0.222, 0.608), flat(0.1, 0.222, 0.608)
    ghost[32 : 32 + side, 64 : 64 + side] = 0.75, 0.08, 0.1
    found = [residual(ghost, dotted(picture, rate, seed), EVERYWHERE) for seed in range(10)]
    assert min(found) > 0.1


@pytest.mark.parametrize("shape", [(96, 128), (50, 75), (7, 5)])
def test_pictures_of_any_size(shape: tuple[int, int]) -> None:
    rendered = np.ones((*shape, 3), np.float32)
    assert residual(rendered, rendered, np.ones(shape, bool)) == 0
    assert residual(1.5 * rendered, rendered, np.ones(shape, bool)) == pytest.approx(0.5 / 1.12, rel=1e-3)


def test_noise_is_estimated_from_one_picture() -> None:
    rng = np.random.default_rng(0)
    smooth = np.linspace(1.0, 2.0, 200, dtype=np.float32)[:, None, None] * np.ones((1, 150, 3), np.float32)
    noisy = smooth + rng.normal(0.0, 0.3, (200, 150, 1)).astype(np.float32)
    assert np.sqrt(noise_variance(noisy).mean()) == pytest.approx(0.3, rel=0.02)
    assert np.sqrt(noise_variance(smooth).mean()) < 0.01
