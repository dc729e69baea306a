"""Classical harmonization against closed forms and an independent colour library."""

import colour
import numpy as np
import pytest

from multilight.model.evaluation.baselines import (
    BASELINES,
    colour_transfer,
    lab_from_srgb,
    match_histograms,
    poisson_blend,
    raw_composite,
    srgb_from_lab,
)


@pytest.fixture
def pictures() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A composite, its background and the mask of a block of noise, with one half-covered column."""
    rng = np.random.default_rng(0)
    background = rng.uniform(0.1, 0.6, (40, 48, 3)).astype(np.float32)
    mask = np.zeros((40, 48), np.float32)
    mask[10:30, 12:32] = 1.0
    mask[10:30, 32] = 0.5
    object_ = rng.uniform(0.5, 0.9, (40, 48, 3)).astype(np.float32) * np.array([1.0, 0.8, 0.6], np.float32)
    composite = mask[..., None] * object_ + (1 - mask[..., None]) * background
    return composite, background, mask


def test_lab_agrees_with_colour_science() -> None:
    srgb = np.random.default_rng(1).uniform(0, 1, (200, 3))
    with colour.utilities.suppress_warnings(colour_usage_warnings=True):
        theirs = colour.XYZ_to_Lab(colour.sRGB_to_XYZ(srgb))
    np.testing.assert_allclose(lab_from_srgb(srgb), theirs, atol=0.05)
    np.testing.assert_allclose(srgb_from_lab(lab_from_srgb(srgb)), srgb, atol=1e-6)


def test_grey_has_no_hue() -> None:
    lab = lab_from_srgb(np.full((1, 3), 0.5))
    np.testing.assert_allclose(lab[0, 1:], 0.0, atol=1e-4)


@pytest.mark.parametrize("name", list(BASELINES))
def test_only_the_object_changes(name: str, pictures: tuple[np.ndarray, ...]) -> None:
    composite, background, mask = pictures
    result = BASELINES[name](composite, background, mask)
    assert result.dtype == np.float32
    assert result.shape == composite.shape
    assert result.min() >= 0.0
    assert result.max() <= 1.0
    np.testing.assert_array_equal(result[mask == 0], background[mask == 0])
    changed = not np.array_equal(result[mask == 1], composite[mask == 1])
    assert changed == (name != "raw composite")


@pytest.mark.parametrize("name", list(BASELINES))
@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_nothing_to_learn_from_leaves_the_composite(name: str, fill: float, pictures: tuple[np.ndarray, ...]) -> None:
    composite, background, _ = pictures
    mask = np.full(composite.shape[:2], fill, np.float32)
    np.testing.assert_allclose(BASELINES[name](composite, background, mask), composite)


def test_raw_composite_is_the_composite(pictures: tuple[np.ndarray, ...]) -> None:
    np.testing.assert_array_equal(raw_composite(*pictures), pictures[0])


def test_colour_transfer_takes_over_mean_and_spread(pictures: tuple[np.ndarray, ...]) -> None:
    composite, background, mask = pictures
    block = mask > 0.5
    lab = lab_from_srgb(colour_transfer(composite, background, mask)[block])
    around = lab_from_srgb(background[mask == 0])
    before = lab_from_srgb(composite[block])
    assert abs(before.mean(axis=0) - around.mean(axis=0)).max() > 15
    np.testing.assert_allclose(lab.mean(axis=0), around.mean(axis=0), atol=1.5)  # a few colours leave sRGB
    np.testing.assert_allclose(lab.std(axis=0), around.std(axis=0), rtol=0.15)


def test_histogram_takes_over_every_quantile(pictures: tuple[np.ndarray, ...]) -> None:
    composite, background, mask = pictures
    result = match_histograms(composite, background, mask)
    levels = np.linspace(0.01, 0.99, 25)
    for channel in range(3):
        mine = np.quantile(result[mask == 1, channel], levels)
        wanted = np.quantile(background[mask == 0, channel], levels)
        np.testing.assert_allclose(mine, wanted, atol=0.01)
    order = np.argsort(composite[mask == 1, 0])
    assert (np.diff(result[mask == 1, 0][order]) >= 0).all(), "brighter stays brighter"


def test_poisson_of_a_flat_object_is_harmonic() -> None:
    """A flat object has no gradient, so a linear background (a harmonic function) goes on through it."""
    y, x = np.mgrid[0:24, 0:32]
    background = np.stack([0.2 + 0.01 * x, 0.1 + 0.02 * y, 0.3 + 0.005 * x + 0.01 * y], axis=-1).astype(np.float32)
    mask = ((x - 15) ** 2 + (y - 12) ** 2 < 49).astype(np.float32)
    composite = np.where(mask[..., None] > 0, np.float32(0.9), background)
    np.testing.assert_allclose(poisson_blend(composite, background, mask), background, atol=1e-5)


def test_poisson_keeps_what_is_inside_up_to_a_constant() -> None:
    """Before a flat background, a pattern that is even at the outline only moves to the background's level."""
    y, x = np.mgrid[0:32, 0:32]
    radius = np.hypot(x - 16, y - 16)
    pattern = (0.2 * np.clip(1 - radius / 6, 0, None)).astype(np.float32)
    mask = (radius < 10).astype(np.float32)
    background = np.full((32, 32, 3), 0.3, np.float32)
    composite = np.where(mask[..., None] > 0, 0.7 + pattern[..., None], background)
    result = poisson_blend(composite, background, mask)
    np.testing.assert_allclose(result[mask > 0], (0.3 + pattern[..., None].repeat(3, axis=-1))[mask > 0], atol=1e-5)


def test_poisson_reaches_the_border_of_the_picture() -> None:
    background = np.full((12, 12, 3), 0.4, np.float32)
    mask = np.zeros((12, 12), np.float32)
    mask[:5, :6] = 1.0
    composite = np.where(mask[..., None] > 0, np.float32(0.8), background)
    np.testing.assert_allclose(poisson_blend(composite, background, mask), 0.4, atol=1e-6)
