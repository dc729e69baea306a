"""Cycles and Mitsuba show the same scene: each kind of light, each kind of surface, and whole sampled scenes.

Means are held to 2 % for each light; what cannot agree better is listed with its figure in ARCHITECTURE.md.
Where a comparison fails, both pictures and their difference are written to the test's folder.
"""

import importlib.util
import shutil
from collections.abc import Iterator
from pathlib import Path

import flip_evaluator
import numpy as np
import pytest
import trimesh
from PIL import Image

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import Backend, RenderJob, RenderSettings
from multilight.datagen.config.dataset import DatasetConfig
from multilight.datagen.production.denoise import denoise_all
from multilight.datagen.production.scene import sample_scene
from multilight.datagen.storage.layers import GeometryBuffers
from multilight.lights.display.tonemap import meter_ev, to_display
from multilight.lights.spec import LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec
from multilight.scenes.still_life.setting import make_body
from tests.datagen.backends.calibration_scenes import GREY, LIGHTS, SURFACES, calibration_job, calibration_scene
from tests.datagen.backends.contract_scenes import placed

CASES = Path(__file__).parents[2] / "scenes" / "cases"
CHOICE = choose_variant()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHOICE.variant is None, reason=f"Mitsuba cannot run here: {CHOICE.why}"),
    pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="the package bpy is not installed"),
]

SPP = 128
SAMPLED_SPP = 256
CLIP = 0.999
"""Quantile beyond which a layer's values are clipped: a firefly is no disagreement."""


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def renderers(library: AssetLibrary) -> Iterator[tuple[Backend, Backend]]:
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


def test_imported_materials(tmp_path: Path) -> None:
    """What files bring and the library does not: clamped and cut-out pictures, vertex colours, maps of metal, coats."""
    folder = tmp_path / "own"
    folder.mkdir()
    for case in ("models/a24_clamp", "models/a16_blend_factor_and_texture", "models/a17_transmission_ior",
                 "models/a18_clearcoat", "bg/c33_mask_cutoff"):  # fmt: skip
        shutil.copy(CASES / f"{case}.glb", folder)
    colourful, patchy = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.1))
    colourful.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (8, 4), np.uint8)
    packed = np.zeros((16, 16, 3), np.uint8)
    packed[..., 1], packed[:, 8:, 2] = 90, 255
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=(220, 180, 60, 255), metallicRoughnessTexture=Image.fromarray(packed)
    )
    patchy.visual = trimesh.visual.TextureVisuals(uv=patchy.vertices[:, :2] * 10 + 0.5, material=material)
    colourful.export(folder / "colourful.glb")
    patchy.export(folder / "patchy.glb")
    library = AssetLibrary(tmp_path / "cache", packs=("builtin",), folders=(folder,))
    bodies = [body for body in calibration_scene(GREY).bodies if body.name == "ground"]
    infos = sorted(library.list("object"), key=lambda info: info.id) + list(library.list("surrounding"))[-1:]
    infos = [info for info in infos if info.pack == "own"]
    for number, info in enumerate(infos):
        mesh = library.mesh(info.id)
        scale = 0.35 / max(info.size or (1,))
        pose = placed((number % 3 - 1) * 0.6, (number // 3 - 0.5) * 0.7, 0.02) @ np.diag([scale, scale, scale, 1])
        materials = [part.material for part in mesh.parts]
        bodies.append(make_body(f"b{number}", "object", info, mesh, materials, pose))
    camera = camera_from_fov(look_at((0.3, -2.6, 1.6), (0, 0, 0.1)), width=128, height=96, fov=0.8)
    scene = SceneSpec(kind="custom", index=0, bodies=tuple(bodies), cameras=(camera,))
    assert len(infos) == 6 + 1
    job = RenderJob(
        scene, LightRig(lights=(LIGHTS["uniform"], LIGHTS["rectangle"])), RenderSettings(spp=256, threads=2), 0
    )
    pictures = []
    for name in ("mitsuba", "cycles"):
        with open_backend(name, library) as backend:
            pictures.append(backend.render(job))
    ours, theirs = pictures
    _save(tmp_path, "imported", ours.combined, theirs.combined)
    assert ours.combined.mean() == pytest.approx(theirs.combined.mean(), rel=0.02), tmp_path
    assert _psnr(ours.combined, theirs.combined) > 30.0, tmp_path
    assert ours.geometry is not None
    assert theirs.geometry is not None
    seen = ours.geometry.instance_id == theirs.geometry.instance_id
    assert seen.mean() > 0.99
    assert 2 not in theirs.geometry.instance_id, "what is of an opacity of 0.3 owns no pixel"
    for name in ("albedo", "roughness", "metallic"):
        apart = np.abs(getattr(ours.geometry, name) - getattr(theirs.geometry, name))[seen]
        assert np.quantile(apart, 0.97) < 0.02, (name, tmp_path)


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
def test_sampled_tabletops(
    renderers: tuple[Backend, Backend], library: AssetLibrary, seed: int, tmp_path: Path
) -> None:
    """Whole scenes, denoised, so that what is left is not noise."""
    config = DatasetConfig(seed=seed, width=64, height=64, views=4)
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
