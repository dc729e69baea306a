"""Cycles and Mitsuba show the same scene: each kind of light, each kind of surface, and whole sampled scenes.

Means are held to 2 % for each light; what cannot agree better is listed with its figure in ARCHITECTURE.md.
Where a comparison fails, both pictures and their difference are written to the test's folder.
"""

import importlib.util
from collections.abc import Iterator
from pathlib import Path

import flip_evaluator
import numpy as np
import pytest
from PIL import Image

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.variants import choose_variant
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.denoise import denoise_all
from multilight.datagen.production.scene import sample_scene
from multilight.datagen.storage.layers import GeometryBuffers
from multilight.lights.display.tonemap import meter_ev, to_display
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.streams import Streams
from tests.datagen.backends.calibration_scenes import LIGHTS, SURFACES, calibration_job

CHOICE = choose_variant()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHOICE.variant == "scalar_rgb", reason=f"no vectorized Mitsuba: {CHOICE.why}"),
    pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="the package bpy is not installed"),
]

SPP = 128
SAMPLED_SPP = 256
CLIP = 0.999
"""Quantile beyond which a layer's values are clipped: a firefly is no disagreement."""


@pytest.fixture(scope="module")
def renderers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Backend, Backend]]:
    library = AssetLibrary(cache=tmp_path_factory.mktemp("cache"), packs=("builtin",))
    with open_backend("mitsuba", library) as mitsuba, open_backend("cycles", library) as cycles:
        yield mitsuba, cycles


def _save(folder: Path, name: str, ours: Float32, theirs: Float32) -> None:
    exposure = meter_ev(theirs)
    a, b = to_display(ours, exposure), to_display(theirs, exposure)
    difference = np.clip(128 + 4 * (a.astype(int) - b), 0, 255).astype(np.uint8)
    Image.fromarray(np.concatenate([a, b, difference], axis=1)).save(folder / f"{name}.png")


def _psnr(ours: Float32, theirs: Float32) -> float:
    exposure = meter_ev(theirs)
    a, b = (to_display(p, exposure).astype(np.float64) for p in (ours, theirs))
    return float(10 * np.log10(255**2 / np.mean((a - b) ** 2)))


# What light through glass and off mirrors adds is noise at any affordable number of samples.
MEANS = {"frosted": 0.05, "glass": 0.05, "metal": 0.05}
LEAST_DECIBELS = {"frosted": 32.0, "glass": 32.0, "metal": 32.0}


@pytest.mark.parametrize("surface", SURFACES)
def test_each_light_on_each_surface(renderers: tuple[Backend, Backend], surface: str, tmp_path: Path) -> None:
    names = [name for name in LIGHTS if name != "uniform"]
    job = calibration_job(SURFACES[surface], tuple(LIGHTS[name] for name in names), SPP)
    ours, theirs = (backend.render(job) for backend in renderers)
    for name, a, b in zip(names, ours.radiance, theirs.radiance, strict=True):
        _save(tmp_path, f"{surface}-{name}", a, b)
        ceiling = np.quantile(b, CLIP)
        means = [np.minimum(layer, ceiling).mean(dtype=np.float64) for layer in (a, b)]
        assert means[0] == pytest.approx(means[1], rel=MEANS.get(surface, 0.02)), (name, tmp_path)
    _save(tmp_path, surface, ours.combined, theirs.combined)
    assert _psnr(ours.combined, theirs.combined) > LEAST_DECIBELS.get(surface, 35.0), tmp_path
    _same_geometry(ours.geometry, theirs.geometry)


def _same_geometry(ours: GeometryBuffers | None, theirs: GeometryBuffers | None) -> None:
    assert ours is not None
    assert theirs is not None
    assert np.mean(ours.instance_id == theirs.instance_id) > 0.99
    same = (ours.instance_id == theirs.instance_id) & (theirs.instance_id > 0)
    np.testing.assert_allclose(ours.z_depth[same], theirs.z_depth[same], rtol=2e-3)
    assert np.quantile(np.abs(ours.normal_world - theirs.normal_world)[same], 0.95) < 0.03
    assert np.quantile(np.abs(ours.albedo - theirs.albedo)[same], 0.95) < 0.02
    assert np.quantile(np.abs(ours.roughness - theirs.roughness)[same], 0.95) < 0.01
    assert np.abs(ours.metallic - theirs.metallic)[same].max() < 0.01
    assert np.abs(ours.environment - theirs.environment).mean() < 0.01


@pytest.mark.parametrize("seed", [1, 4])
def test_sampled_tabletops(renderers: tuple[Backend, Backend], seed: int, tmp_path: Path) -> None:
    """Whole scenes, denoised, so that what is left is not noise."""
    library = AssetLibrary(cache=tmp_path / "cache", packs=("builtin",))
    config = DatasetConfig(seed=seed, width=96, height=96, views=4)
    scene, rig = sample_scene(config, library, Streams(seed, 0))
    job = RenderJob(scene, rig, RenderSettings(spp=SAMPLED_SPP, threads=2), 2)
    ours, theirs = (denoise_all(backend.render(job), threads=2) for backend in renderers)
    _save(tmp_path, "sampled", ours.sum(axis=0), theirs.sum(axis=0))
    for name, a, b in zip(rig.names, ours, theirs, strict=True):
        assert a.mean() == pytest.approx(b.mean(), rel=0.05), (name, tmp_path)
    assert _psnr(ours.sum(axis=0), theirs.sum(axis=0)) > 35.0, tmp_path
    exposure = meter_ev(theirs.sum(axis=0))
    shown = [to_display(p.sum(axis=0), exposure).astype(np.float32) / 255 for p in (theirs, ours)]
    _, error, _ = flip_evaluator.evaluate(*shown, "LDR", inputsRGB=True)
    assert error < 0.06, tmp_path
