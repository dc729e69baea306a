"""Denoising: cleaner, cropped without seams, the same on any number of threads, and true to the identities."""

import dataclasses
from collections.abc import Callable

import mitsuba_oidn
import numpy as np
import pytest

from datagen import denoise
from datagen.backends import RenderJob, RenderSettings
from datagen.backends.analytic import AnalyticBackend
from datagen.denoise import denoise_all, denoise_foreground, denoise_without, foreground_layers
from datagen.layers import Float32, LayerStack
from lights.rigs import SPHERES_KINDS, sample_rig
from scenes.assets.library import AssetLibrary
from scenes.spheres import sample_spheres
from scenes.streams import Streams

Stacks = dict[str, LayerStack]


@pytest.fixture(scope="module")
def truth() -> Stacks:
    """A view of closed-form spheres without noise; `without` and `foreground` are of its largest object."""
    streams = Streams(3, 0)
    scene = sample_spheres(streams, index=0, width=160, height=112, views=1)
    rig = sample_rig(streams, scene, AssetLibrary(), kinds=SPHERES_KINDS)
    with AnalyticBackend() as backend:

        def render(variant: str) -> LayerStack:
            return backend.render(RenderJob(scene, rig, RenderSettings(spp=16, threads=1), 0, variant))

        foregrounds = {name: render(f"foreground_{name}") for name in scene.insertable}
        largest = max(foregrounds, key=lambda name: float(np.sum(foregrounds[name].coverage)))
        stacks = {
            "all": render("all"),
            "without": render(f"without_{largest}"),
            "foreground": foregrounds[largest],
        }
    geometry = stacks["all"].geometry
    assert geometry is not None
    guides = {"guide_albedo": geometry.albedo, "guide_normal": geometry.normal_world}
    return {name: dataclasses.replace(stack, **guides) for name, stack in stacks.items()}


@pytest.fixture(scope="module")
def noisy(truth: Stacks) -> Stacks:
    """The same with the noise of few samples, and the same noise in every variant: common random numbers."""
    shape = truth["all"].radiance.shape
    noise = np.random.default_rng(0).gamma(2.0, 0.5, (*shape[:3], 1)).astype(np.float32)
    return {name: dataclasses.replace(stack, radiance=stack.radiance * noise) for name, stack in truth.items()}


def error(a: Float32, b: Float32) -> float:
    """Root mean square difference, relative to the mean of the second."""
    return float(np.sqrt(np.square(a - b).mean()) / b.mean())


def test_layers_come_out_cleaner(truth: Stacks, noisy: Stacks) -> None:
    clean = denoise_all(noisy["all"])
    assert clean.shape == noisy["all"].radiance.shape
    for light in range(len(clean)):
        before = error(noisy["all"].radiance[light], truth["all"].radiance[light])
        assert error(clean[light], truth["all"].radiance[light]) < 0.4 * before


def test_the_scale_is_the_denoisers_own(noisy: Stacks) -> None:
    stack = noisy["all"]
    for light, layer in enumerate(stack.radiance):
        theirs = mitsuba_oidn.denoise(layer, albedo=stack.guide_albedo, normal=stack.guide_normal, hdr=True,
                                        clean_aux=True)  # fmt: skip
        np.testing.assert_allclose(denoise_all(stack)[light], np.maximum(theirs, 0), rtol=1e-2, atol=1e-3)


def test_threads_change_no_bit(noisy: Stacks) -> None:
    calls: list[Callable[[int], Float32]] = [
        lambda threads: denoise_all(noisy["all"], threads=threads),
        lambda threads: denoise_without(noisy["without"], noisy["all"], noisy["all"].radiance, threads=threads),
        lambda threads: denoise_foreground(noisy["foreground"], noisy["all"].radiance, threads=threads),
    ]
    for call in calls:
        np.testing.assert_array_equal(call(1), call(3))


def test_equal_renders_come_out_equal(noisy: Stacks) -> None:
    clean = denoise_all(noisy["all"])
    np.testing.assert_array_equal(denoise_without(noisy["all"], noisy["all"], clean), clean)


def test_effect_is_zero_away_from_every_change(noisy: Stacks) -> None:
    clean = denoise_all(noisy["all"])
    without = denoise_without(noisy["without"], noisy["all"], clean)
    reach = denoise.WINDOW // 2 + 2 * denoise.SEAM
    far = 0
    for light in range(len(clean)):
        changed = (noisy["without"].radiance[light] != noisy["all"].radiance[light]).any(axis=-1)
        untouched = ~denoise.binary_dilation(changed, np.ones((3, 3), bool), iterations=reach)
        np.testing.assert_array_equal(without[light][untouched], clean[light][untouched])
        far += int(untouched.sum())
    assert far > 1000


def test_rectangles_show_no_seams(truth: Stacks, noisy: Stacks) -> None:
    """What was denoised in rectangles is as near to the truth as what was denoised whole."""
    clean = denoise_all(noisy["all"])
    without = denoise_without(noisy["without"], noisy["all"], clean)
    whole = denoise_all(noisy["without"])
    for light, true in enumerate(truth["without"].radiance):
        assert error(without[light], true) < 1.1 * error(whole[light], true) + 1e-3
        assert error(without[light], whole[light]) < 0.6 * error(whole[light], true) + 1e-3


def test_black_layers_stay_black(noisy: Stacks) -> None:
    dark = noisy["all"].radiance.copy()
    dark[0] = 0
    stack = dataclasses.replace(noisy["all"], radiance=dark)
    assert not denoise_all(stack)[0].any()
    clean = denoise_all(noisy["all"])
    assert not denoise_without(stack, noisy["all"], clean)[0].any()


def test_foreground_is_the_whole_inside_and_nothing_outside(truth: Stacks, noisy: Stacks) -> None:
    clean, alpha = denoise_all(noisy["all"]), truth["foreground"].coverage
    assert alpha is not None
    for layers in (denoise_foreground(noisy["foreground"], clean), foreground_layers(noisy["foreground"], clean)):
        np.testing.assert_array_equal(layers[:, alpha >= 1], clean[:, alpha >= 1])
        assert not layers[:, alpha <= 0].any()
    edge = (alpha > 0) & (alpha < 1)
    assert edge.sum() > 30
    true, raw = truth["foreground"].radiance[:, edge], noisy["foreground"].radiance[:, edge]
    assert error(denoise_foreground(noisy["foreground"], clean)[:, edge], true) < 0.7 * error(raw, true)


@pytest.mark.parametrize("shape", [(64, 96), (50, 75), (17, 9)])
def test_rectangles_hold_the_mask_with_a_margin_and_do_not_overlap(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    for share in (0.0, 0.001, 0.01, 0.2):
        mask = rng.random(shape) < share
        held = np.zeros(shape, int)
        for top, end, left, right in denoise._rectangles(mask):
            held[top:end, left:right] += 1
        assert held.max(initial=0) <= 1
        wide = denoise.binary_dilation(mask, np.ones((3, 3), bool), iterations=denoise.TILE)
        assert held[wide].all() or not mask.any()
    assert denoise._rectangles(np.zeros(shape, bool)) == []
