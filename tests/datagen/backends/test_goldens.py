"""Both renderers still make the pictures that were judged right, within noise (`goldens/`)."""

import importlib.util
from collections.abc import Iterator

import numpy as np
import pytest

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import Backend
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from tests.datagen.backends.goldens import CASES, FOLDER, REPEATS, Golden, golden_job, load

BACKENDS = [
    pytest.param(
        "mitsuba", marks=pytest.mark.skipif(choose_variant().variant is None, reason="Mitsuba cannot run here")
    ),
    pytest.param(
        "cycles", marks=pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="no package bpy here")
    ),
]
BLOCK = 4
WILD = 4.0
"""Standard errors beyond which a block sticks out."""


@pytest.fixture(scope="module", params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with open_backend(request.param, AssetLibrary(packs=("builtin",))) as opened:
        yield opened


def faults(layer: Float32, mean: Float32, variance: Float32) -> list[str]:
    """Say how a layer (H, W, 3) differs from its golden: a Z-test over blocks of pixels, and one over the whole."""
    height, width = variance.shape

    def blocks(picture: np.ndarray) -> np.ndarray:
        return picture.reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK).mean(axis=(1, 3), dtype=np.float64)

    # Light of one colour: the channels' errors go together, so their mean has the variance of one. The stored mean
    # has noise of its own; and half precision, and paths too rare for a few renders to show, make up the floor.
    error = blocks((layer - mean).mean(axis=-1))
    floor = 2e-3 * blocks(mean.mean(axis=-1)) + 1e-4 * mean.mean()
    deviation = np.sqrt(blocks(variance) / BLOCK**2 * (1 + 1 / REPEATS)) + floor
    z = error / deviation
    whole = error.mean() / (np.sqrt(np.square(deviation).mean() / deviation.size) + 1e-3 * mean.mean())
    found = []
    if (share := float(np.mean(np.abs(z) > WILD))) > 0.01:
        found.append(f"{share:.1%} of the blocks are more than {WILD} standard errors off")
    if (spread := float(np.mean(np.clip(z, -WILD, WILD) ** 2))) > 1.5:
        found.append(f"mean squared z is {spread:.2f}")
    if abs(whole) > WILD:
        found.append(f"the mean is {whole:.1f} standard errors off")
    return found


@pytest.mark.parametrize("case", CASES)
def test_renders_as_it_did(backend: Backend, case: str) -> None:
    golden = load(f"{backend.name}-{case}")
    stack = backend.render(golden_job(case, 0))
    for number, light in enumerate(stack.lights):
        assert not faults(stack.radiance[number], golden.mean[number], golden.variance[number]), light


def _sampled(golden: Golden, light: int) -> Float32:
    """Draw a picture with the golden's mean and noise."""
    noise = np.random.default_rng(light).normal(size=golden.variance[light].shape)
    return golden.mean[light] + (np.sqrt(golden.variance[light]) * noise)[..., None].astype(np.float32)


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("*.npz")))
def test_the_test_sees_small_changes(name: str) -> None:
    """A layer two hundredths brighter, one moved by a pixel, and one with another's light in it are told apart."""
    golden = load(name)
    for light in range(len(golden.mean)):
        mean, variance = golden.mean[light], golden.variance[light]
        picture = _sampled(golden, light)
        assert not faults(picture, mean, variance)
        assert faults(picture * 1.02, mean, variance)
        assert faults(np.roll(picture, 1, axis=1), mean, variance)
        assert faults(picture + 0.03 * golden.mean[light - 1] * mean.mean() / golden.mean[light - 1].mean(), mean,
                      variance)  # fmt: skip


def test_they_are_small_and_whole() -> None:
    expected = {f"{backend}-{case}" for backend in ("mitsuba", "cycles") for case in CASES}
    assert {path.stem for path in FOLDER.glob("*.npz")} == expected
    assert sum(path.stat().st_size for path in FOLDER.glob("*.npz")) < 1_000_000
