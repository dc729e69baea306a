"""Denoising: cleaner, cropped without seams, the same on any number of threads, and true to the identities."""

import dataclasses
from collections.abc import Callable

import mitsuba_oidn
import numpy as np
import pytest

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.datagen.production import denoise
from multilight.datagen.production.denoise import (
    Removed,
    denoise_all,
    denoise_foreground,
    denoise_without,
    foreground_layers,
)
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.rigs.sample import SPHERES_KINDS, sample_rig
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.kinds.spheres import sample_spheres
from multilight.scenes.random_streams import Streams

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
        coverages = {name: stack.coverage for name, stack in foregrounds.items() if stack.coverage is not None}
        largest = max(coverages, key=lambda name: float(coverages[name].sum()))
        stacks = {"all": render("all"), "without": render(f"without_{largest}"), "foreground": foregrounds[largest]}
    geometry = stacks["all"].geometry
    assert geometry is not None
    albedo, normal = geometry.albedo, geometry.normal_world
    return {n: dataclasses.replace(s, guide_albedo=albedo, guide_normal=normal) for n, s in stacks.items()}


@pytest.fixture(scope="module")
def noisy(truth: Stacks) -> Stacks:
    """The same with the noise of few samples, and the same noise in every variant: common random numbers."""
    shape = truth["all"].radiance.shape
    noise = np.random.default_rng(0).gamma(2.0, 0.5, (*shape[:3], 1)).astype(np.float32)
    return {name: dataclasses.replace(stack, radiance=stack.radiance * noise) for name, stack in truth.items()}


def error(a: Float32, b: Float32) -> float:
    """Root mean square difference, relative to the mean of the second."""
    return float(np.sqrt(np.square(a - b).mean()) / b.mean())


def removed(stacks: Stacks, clean: Float32, *, threads: int = 1) -> Removed:
    """Denoise the variant `without`; the object was to be seen where it covers something."""
    coverage = stacks["foreground"].coverage
    assert coverage is not None
    return denoise_without(stacks["without"], stacks["all"], clean, coverage > 0, threads=threads)


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
        lambda threads: removed(noisy, noisy["all"].radiance, threads=threads).layers,
        lambda threads: denoise_foreground(noisy["foreground"], noisy["all"].radiance, threads=threads),
    ]
    for call in calls:
        np.testing.assert_array_equal(call(1), call(3))


def test_equal_renders_come_out_equal(noisy: Stacks) -> None:
    clean = denoise_all(noisy["all"])
    nowhere = np.zeros(clean.shape[1:3], bool)
    found = denoise_without(noisy["all"], noisy["all"], clean, nowhere)
    np.testing.assert_array_equal(found.layers, clean)
    assert found.anew == ()


def test_effect_is_zero_away_from_every_change(noisy: Stacks) -> None:
    clean = denoise_all(noisy["all"])
    without = removed(noisy, clean).layers
    reach = denoise.WINDOWS[0] // 2 + 2 * denoise.SEAM
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
    without = removed(noisy, clean).layers
    whole = denoise_all(noisy["without"])
    for light, true in enumerate(truth["without"].radiance):
        assert error(without[light], true) < 1.1 * error(whole[light], true) + 1e-3
        assert error(without[light], whole[light]) < 0.6 * error(whole[light], true) + 1e-3


HUES = np.array([[0.75, 0.08, 0.1], [0.1, 0.222, 0.608]], np.float32)
"""Red and blue of one luminance, and of one mean over the channels."""


def patch(noise: float, *, bright: float = 1.0) -> tuple[Stacks, Mask]:
    """A red square on a blue ground, equal in all but hue, and what is behind it; noise of 64x64 pixels in common."""
    square = np.zeros((64, 64), bool)
    square[20:44, 24:40] = True
    alike = np.random.default_rng(3).gamma(1 / noise**2, noise**2, (64, 64, 1)).astype(np.float32)
    behind = np.broadcast_to(HUES[1] * np.float32(bright), (64, 64, 3))
    there = np.where(square[..., None], HUES[0] * np.float32(bright), behind)
    upright = np.broadcast_to(np.array((0, 0, 1), np.float32), (64, 64, 3))
    stacks = {
        name: LayerStack(("lamp",), (image * alike)[None], image * alike, guide_albedo=albedo, guide_normal=upright)
        for name, image, albedo in (
            ("all", there, np.where(square[..., None], HUES[0], HUES[1])),
            ("without", behind, behind),
        )
    }
    return stacks, square


@pytest.mark.parametrize("noise", [0.1, 1.0, 3.0])
@pytest.mark.parametrize("bright", [1.0, 1e-5])
def test_where_an_object_was_its_background_is_made_of_its_own_samples(noise: float, bright: float) -> None:
    """Whatever they look like: before, what did not differ in its mean over the channels was taken from `all`."""
    stacks, square = patch(noise, bright=bright)
    clean = denoise_all(stacks["all"])
    found = denoise_without(stacks["without"], stacks["all"], clean, square)
    red = found.layers[0][square].mean(axis=0)
    own = stacks["without"].radiance[0][square].mean(axis=0)
    np.testing.assert_allclose(red, own, rtol=0.15)


@pytest.mark.parametrize("noise", [0.1, 0.5])
def test_coloured_shadows_of_equal_luminance_are_changes(noise: float) -> None:
    """The same square as a change of the light where no object was."""
    stacks, square = patch(noise)
    clean = denoise_all(stacks["all"])
    nowhere = np.zeros_like(square)
    layer = denoise_without(stacks["without"], stacks["all"], clean, nowhere).layers[0]
    inner = denoise.binary_dilation(~square, iterations=3)
    np.testing.assert_allclose(layer[~inner].mean(axis=0), stacks["without"].radiance[0][~inner].mean(axis=0), rtol=0.1)


def test_rare_bright_dots_tell_a_change_over_wide_windows() -> None:
    """Light from an object on dark ground, one bright dot in 200 pixels: no small window knows it from chance."""
    rng = np.random.default_rng(5)
    dots = (rng.random((128, 128, 1)) < 0.005) * rng.gamma(2.0, 1.0, (128, 128, 1))
    ground = np.full((128, 128, 3), 1e-4, np.float32)
    raw_all = (ground + dots * (0.3, 0.2, 0.1)).astype(np.float32)
    clean = np.broadcast_to(raw_all.mean(axis=(0, 1)), raw_all.shape)
    changed = denoise._changed(np.zeros((128, 128), bool), ground, raw_all, clean)
    assert changed.mean() > 0.95


def test_a_layer_that_lost_light_is_denoised_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    stacks, square = patch(0.3)
    clean = denoise_all(stacks["all"])
    monkeypatch.setattr(denoise, "_changed", lambda shown, *_: shown)
    nowhere = np.zeros_like(square)
    found = denoise_without(stacks["without"], stacks["all"], clean, nowhere)
    assert found.anew == ("lamp",)
    np.testing.assert_array_equal(found.layers, denoise_all(stacks["without"]))
    assert found.outside[0] < 0.02


def test_black_layers_stay_black(noisy: Stacks) -> None:
    dark = noisy["all"].radiance.copy()
    dark[0] = 0
    stack = dataclasses.replace(noisy["all"], radiance=dark)
    assert not denoise_all(stack)[0].any()
    clean = denoise_all(noisy["all"])
    nowhere = np.zeros(clean.shape[1:3], bool)
    assert not denoise_without(stack, noisy["all"], clean, nowhere).layers[0].any()


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
        wide = denoise.binary_dilation(mask, np.ones((3, 3), bool), iterations=denoise.AROUND * denoise.TILE)
        assert held[wide].all() or not mask.any()
    assert denoise._rectangles(np.zeros(shape, bool)) == []
