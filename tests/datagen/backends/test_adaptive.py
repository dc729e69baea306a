"""Mitsuba backend: random numbers, who gets how many samples, and what they add up to."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.scenes.assets.library import AssetLibrary
from tests.datagen.backends.contract_scenes import RIG, job

if choose_variant().variant is None:
    pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}", allow_module_level=True)

import drjit as dr
import mitsuba as mi

from multilight.datagen.backends.mitsuba import MitsubaBackend, adaptive, sampling
from multilight.datagen.backends.mitsuba.adaptive import (
    FIRST,
    MOST,
    Blocks,
    Pilot,
    blocks_of,
    first_blocks,
    further_blocks,
)
from multilight.datagen.backends.mitsuba.film import Film
from multilight.datagen.backends.mitsuba.sampling import Sampler, stream_of


def test_points_are_those_of_sobol() -> None:
    """Before they are scrambled: against SciPy's, which takes the same points in the order of a Gray code."""
    number = np.arange(256, dtype=np.uint32)
    second = np.array(dr.brev(sampling._second(mi.UInt32(number)))) / 2.0**32
    first = np.array(dr.brev(mi.UInt32(number))) / 2.0**32
    expected = qmc.Sobol(2, scramble=False).random(256)
    np.testing.assert_array_equal(np.stack([first, second], axis=1), expected[_place_in_gray_code(number)])


def _place_in_gray_code(number: np.ndarray) -> np.ndarray:
    place = number.copy()
    for shift in (1, 2, 4, 8, 16):
        place ^= place >> shift
    return place


@pytest.mark.parametrize("first", [0, 16, 48])
def test_any_block_of_samples_is_well_distributed(first: int) -> None:
    """Sixteen samples from a multiple of sixteen on: one in each of 16 boxes of area 1/16, whatever their shape."""
    pixels, count = 500, 16
    lane = dr.arange(mi.UInt32, pixels * count)
    sampler = Sampler(stream_of(lane // count, mi.UInt32(7)), lane % count + first)
    points = np.array(sampler.next_2d(17, 3)).reshape(2, pixels, count)
    for bits in range(5):
        boxes = (points[0] * 2**bits).astype(int) * 2 ** (4 - bits) + (points[1] * 2 ** (4 - bits)).astype(int)
        np.testing.assert_array_equal(np.sort(boxes, axis=1), np.broadcast_to(np.arange(16), boxes.shape))


def test_drawing_numbers_changes_no_argument() -> None:
    order = mi.UInt32([1, 2, 3])
    sampling._owen(order, mi.UInt32(5))
    sampling._second(order)
    np.testing.assert_array_equal(np.array(order), [1, 2, 3])


def test_film_adds_up_each_pixels_blocks() -> None:
    """Also those of several calls, of which one gives some pixels nothing."""
    rng = np.random.default_rng(0)
    film, total, samples = Film(3, 4), np.zeros((12, 3)), np.zeros(12)
    for size, counts in ((2, np.full(12, 4)), (2, rng.integers(0, 4, 12)), (5, rng.integers(0, 3, 12))):
        blocks = blocks_of(counts, size)
        values = rng.random((3, len(blocks) * size)).astype(np.float32)
        film.add(blocks, iter([([(("all", ""), 3)], mi.Float(values.ravel()))]))
        pixel = np.repeat(blocks.pixel, size)
        np.add.at(total, pixel, values.T)
        samples += np.bincount(pixel, minlength=12)
    np.testing.assert_allclose(film.mean(("all", ""))[0], (total / samples[:, None]).reshape(3, 4, 3), rtol=1e-6)


def pilot(grey: np.ndarray, guides: np.ndarray) -> Pilot:
    """What blocks (L, H, W, FIRST) of layers that have no hue tell."""
    colours = np.repeat(grey[..., None], 3, axis=-1)
    variance = colours.var(axis=3, ddof=1).sum(axis=(0, -1))
    return Pilot(colours.mean(axis=3).sum(axis=(0, -1)), variance, guides.astype(np.float32))


def shared_out(
    grey: np.ndarray, guides: np.ndarray, spp: int, cost: float | np.ndarray = 1.0, *others: Pilot
) -> np.ndarray:
    """Share out the rest of `spp` samples; returns each pixel's samples, (H, W)."""
    height, width, _ = guides.shape
    first = first_blocks(height * width, spp)
    costs = np.broadcast_to(np.float32(cost), (height, width))
    further = further_blocks(first, [pilot(grey, guides), *others], costs, spp)
    _is_followed(first, further)
    counts = np.bincount(first.pixel, minlength=height * width) + np.bincount(further.pixel, minlength=height * width)
    return counts.reshape(height, width) * first.size


def _is_followed(first: Blocks, further: Blocks) -> None:
    """No sample is taken twice, and none is left out: the later blocks of a pixel follow its first ones."""
    for pixel in (0, int(first.pixel[-1])):
        starts = np.concatenate([blocks.first[blocks.pixel == pixel] for blocks in (first, further)])
        np.testing.assert_array_equal(starts, np.arange(len(starts)) * first.size)


@pytest.mark.parametrize("spp", [8, 16, 24, 100])
def test_samples_go_where_it_is_noisy(spp: int) -> None:
    rng = np.random.default_rng(1)
    noise = np.where(np.arange(64) < 32, 0.02, 0.2)[:, None]
    grey = 1 + noise * rng.standard_normal((2, 48, 64, FIRST)).astype(np.float32)
    samples = shared_out(grey, np.zeros((48, 64, 6)), spp)
    assert 0.95 * spp < samples.mean() <= spp
    assert samples.min() >= first_blocks(1, spp).size * FIRST
    assert samples.max() <= (MOST + 1) * spp
    assert samples[:, 36:].mean() > 1.5 * samples[:, :28].mean()


def test_samples_go_where_a_denoiser_finds_little_that_looks_alike() -> None:
    rng = np.random.default_rng(2)
    grey = 1 + 0.1 * rng.standard_normal((1, 48, 64, FIRST))
    guides = np.zeros((48, 64, 6))
    guides[:, 32:, :3] = rng.random((48, 32, 3))
    samples = shared_out(grey, guides, 32)
    assert samples[:, 36:].mean() > 1.3 * samples[:, :28].mean()


def test_samples_go_where_a_background_is_noisy_that_an_object_hides() -> None:
    """What lies behind a smooth object is seen in the variant without it, and is to be no noisier there."""
    rng = np.random.default_rng(6)
    noise = 0.1 * rng.standard_normal((1, 48, 64, FIRST))
    object_, guides = np.zeros((48, 64), bool), np.zeros((48, 64, 6))
    object_[10:38, 20:44] = True
    texture = np.concatenate([rng.random((48, 64, 3)), guides[..., 3:]], axis=-1)
    everything = 1 + noise * ~object_[..., None]
    hidden = np.where(object_[..., None], 0, texture)
    behind = pilot(1 + noise, texture)
    inner, outer = np.s_[14:34, 24:40], np.s_[:, :16]
    alone = shared_out(everything, hidden, 32)
    assert alone[inner].mean() < 0.7 * alone[outer].mean()
    samples = shared_out(everything, hidden, 32, 1.0, behind)
    assert samples[inner].mean() == pytest.approx(samples[outer].mean(), rel=0.05)


def test_film_tells_the_variance_of_blocks_in_every_channel() -> None:
    """Noise of hue alone counts: the channels' variances are added, not taken of their mean."""
    rng = np.random.default_rng(7)
    sums = rng.random((3, 12, FIRST)).astype(np.float32)
    sums[2] = 3 - sums[0] - sums[1]
    film, key = Film(3, 4), ("all", "")
    film.add(blocks_of(np.full(12, FIRST), 1), [([(key, 3)], mi.Float(sums.ravel()))], squares=[key])
    mean, variance = film.variance(key, FIRST)
    np.testing.assert_allclose(mean, np.full((3, 4), 3.0), rtol=1e-5)
    np.testing.assert_allclose(variance.ravel(), sums.var(axis=-1, ddof=1).sum(axis=0), rtol=1e-4)


def test_costly_pixels_get_fewer_samples_and_all_cost_what_was_asked_for() -> None:
    grey = 1 + 0.1 * np.random.default_rng(4).standard_normal((1, 48, 64, FIRST))
    cost = np.where(np.arange(64) < 32, 1.0, 4.0) * np.ones((48, 1))
    samples = shared_out(grey, np.zeros((48, 64, 6)), 64, cost)
    assert 1.7 < samples[:, :28].mean() / samples[:, 36:].mean() < 2.1  # the root of four; a pixel gets at least half
    assert (samples * cost).sum() == pytest.approx(64 * cost.sum(), rel=0.03)


def test_a_pixels_own_noise_brings_it_no_samples() -> None:
    """Else its mean would be biased: rare bright paths would bring more samples, which water them down."""
    grey = np.ones((1, 16, 16, FIRST))
    grey += 0.1 * np.random.default_rng(3).standard_normal(grey.shape)
    brighter = grey.copy()
    brighter[0, 8, 8, 0] += 1
    need, changed = (adaptive._noise(pilot(g, np.zeros((16, 16, 6)))) * g.mean() for g in (grey, brighter))
    assert changed[8, 8] < need[8, 8]  # the picture is brighter there, so that its noise is seen less
    assert changed[8, 7] > 1.2 * need[8, 7]  # but its neighbours get more


def test_what_is_not_a_number_stops_nothing() -> None:
    grey = np.ones((1, 16, 16, FIRST))
    grey[0, 3, 3, 0] = np.nan
    assert shared_out(grey, np.zeros((16, 16, 6)), 16).mean() == 16


def test_few_samples_are_not_shared_out() -> None:
    blocks = first_blocks(5, 7)
    assert (blocks.size, len(blocks)) == (7, 5)


@pytest.fixture(scope="module")
def backend() -> Iterator[MitsubaBackend]:
    with open_backend("mitsuba", AssetLibrary(packs=("builtin",))) as opened:
        assert isinstance(opened, MitsubaBackend)
        yield opened


def test_as_many_samples_show_less_noise(backend: MitsubaBackend, monkeypatch: pytest.MonkeyPatch) -> None:
    """As shown, where a mistake in the dark counts as much as one in the light, against as many for every pixel."""
    plain = job()
    converged = backend.render(replace(plain, settings=RenderSettings(spp=1024))).radiance.sum(axis=0)

    def error() -> float:
        found = []
        for number in range(3):
            scene = plain.scene.model_copy(update={"index": 100 + number})
            stack = backend.render(RenderJob(scene, RIG, RenderSettings(spp=16), 0))
            found.append(((stack.combined - converged) / (converged + converged.mean())) ** 2)
        return float(np.mean(found))

    def _alike_for_all(need: np.ndarray, cost: np.ndarray, budget: float, most: float) -> np.ndarray:
        return np.full(need.shape, round(budget / cost.sum()))

    shared = error()
    monkeypatch.setattr(adaptive, "_shared_out", _alike_for_all)
    assert shared < 0.9 * error()
