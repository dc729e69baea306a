"""Each check of `verify` finds the fault it is there for, and nothing in a sound dataset."""

import contextlib
import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from multilight.datagen.cli import main
from multilight.datagen.storage.records import view_file
from multilight.datagen.storage.store import (
    ViewData,
    file_sha256,
    read_scene,
    read_view,
    scene_dir,
    write_text,
    write_view,
)
from multilight.datagen.tuples.exposure import DARK, LIFTED_BRIGHT, LIFTED_DARK, levels, meter_condition, thumbnail
from multilight.datagen.verification.dataset import verify_dataset
from multilight.datagen.verification.views import Fault, verify_views
from multilight.lights.spec import LightingCondition
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import luminance

Damage = Callable[[ViewData, str], ViewData]


def verify_scene(folder: Path) -> list[Fault]:
    """Check the views of one scene's folder alone."""
    return verify_views(read_scene(folder), lambda name: contextlib.nullcontext(folder / name))


def test_a_sound_dataset_has_no_fault(spheres_dataset: Path) -> None:
    assert [found for _, found in verify_dataset(str(spheres_dataset)).results] == [[], [], []]


def rewrite(folder: Path, damage: Damage, *, view: int = 1) -> None:
    """Damage a view's content while file and hash stay in order, so that only the identities can tell."""
    record = read_scene(folder)
    path = folder / view_file(view)
    write_view(path, damage(read_view(path), record.scene.insertable[0]))
    views = list(record.views)
    views[view] = views[view].model_copy(update={"file_sha256": file_sha256(path)})
    write_text(folder / "scene.json", record.model_copy(update={"views": tuple(views)}).sealed().model_dump_json())


def changed_variant(view: ViewData, variant: str, change: Callable[[np.ndarray], np.ndarray]) -> ViewData:
    variants = dict(view.variants)
    variants[variant] = change(variants[variant].copy())
    return dataclasses.replace(view, variants=variants)


def with_nan(view: ViewData, _: str) -> ViewData:
    def change(layers: np.ndarray) -> np.ndarray:
        layers[0, 3, 4] = np.nan
        return layers

    return changed_variant(view, "all", change)


def with_lost_light(view: ViewData, _: str) -> ViewData:
    return changed_variant(view, "all", lambda layers: layers * np.float32(0.8))


def with_darker_background(view: ViewData, name: str) -> ViewData:
    return changed_variant(view, f"foreground_{name}", lambda layers: layers + np.float32(0.01) * layers.max())


def with_overlapping_masks(view: ViewData, name: str) -> ViewData:
    other = next(n for n in view.coverage if n != name)
    coverage = dict(view.coverage)
    coverage[other] = np.maximum(coverage[other], coverage[name])
    return dataclasses.replace(view, coverage=coverage)


def with_firefly(view: ViewData, name: str) -> ViewData:
    inside = np.argwhere(view.geometry.instance_id > 0)[50]

    def change(layers: np.ndarray) -> np.ndarray:
        layers[0, inside[0], inside[1]] = 1e4
        return layers

    return changed_variant(view, "all", change)


def with_object_left_in(view: ViewData, name: str) -> ViewData:
    return changed_variant(view, f"without_{name}", lambda _: view.variants["all"].copy())


def with_blackness(view: ViewData, _: str) -> ViewData:
    dark = {variant: layers * np.float32(1e-4) for variant, layers in view.variants.items()}
    return dataclasses.replace(view, variants=dark, combined=view.combined * np.float32(1e-4))


def with_scaled_depth(factor: float) -> Damage:
    def damage(view: ViewData, _: str) -> ViewData:
        z_depth = view.geometry.z_depth * np.float32(factor)
        return dataclasses.replace(view, geometry=dataclasses.replace(view.geometry, z_depth=z_depth))

    return damage


@pytest.mark.parametrize(
    ("damage", "check"),
    [
        (with_nan, "finite"),
        (with_lost_light, "additivity"),
        (with_darker_background, "composite"),
        (with_overlapping_masks, "masks"),
        (with_firefly, "fireflies"),
        (with_object_left_in, "removal"),
        (with_blackness, "exposure"),
        (with_scaled_depth(0.95), "reprojection"),
        (with_scaled_depth(1.05), "reprojection"),
    ],
)
def test_damage_is_found(spheres_copy: Path, damage: Damage, check: str) -> None:
    folder = scene_dir(spheres_copy, 0)
    rewrite(folder, damage)
    assert check in {fault.check for fault in verify_scene(folder)}


def test_changed_bytes_and_missing_files_are_found(spheres_copy: Path) -> None:
    first, second = scene_dir(spheres_copy, 0), scene_dir(spheres_copy, 1)
    (first / view_file(0)).unlink()
    assert [(f.check, f.view) for f in verify_scene(first)] == [("files", 0)]
    write_view(second / view_file(2), read_view(second / view_file(1)))
    assert ("files", 2) in [(f.check, f.view) for f in verify_scene(second)]


def test_a_view_that_would_be_black_is_brightened() -> None:
    """A small lamp lights most views and hardly the last: one exposure for all must not leave that black."""
    lit = np.random.default_rng(0).uniform(0.1, 1.9, (1, 32, 32, 3)).astype(np.float32)
    condition = LightingCondition(name="lamp", gains={"lamp": (1.0, 1.0, 1.0)})

    def exposed(*views: Float32) -> float:
        return meter_condition(condition, ("lamp",), views, [levels(view[0]) for view in views]).exposure_ev

    metered = exposed(*[lit] * 8)
    for share, brightened in ((0.5, False), (0.15, True)):
        dark = lit * np.float32(share)
        exposure = exposed(*[lit] * 8, dark)
        high = np.percentile(luminance(dark), 95) * 2.0**exposure
        assert (high == pytest.approx(LIFTED_DARK, rel=1e-3)) == brightened
        assert high > DARK
        assert exposure < metered + 1.0
    hopeless = exposed(*[lit] * 8, lit * np.float32(1e-4))
    assert np.median(luminance(lit)) * 2.0**hopeless <= LIFTED_BRIGHT * 1.001


def test_a_light_too_small_for_thumbnails_is_metered_in_the_picture() -> None:
    """Two pixels of a hundred glow: in thumbnails, where they are spread, a twentieth of the picture seems to."""
    lit = np.full((1, 128, 128, 3), 0.1, np.float32)
    small = np.full((1, 128, 128, 3), 0.01, np.float32)
    small[:, ::8, ::8] = 30.0
    condition = LightingCondition(name="lamp", gains={"lamp": (1.0, 1.0, 1.0)})
    seen = [levels(view[0]) for view in (lit, small)]
    exposure = meter_condition(condition, ("lamp",), [thumbnail(lit), thumbnail(small)], seen).exposure_ev
    assert np.percentile(luminance(small), 95) * 2.0**exposure == pytest.approx(LIFTED_DARK, rel=1e-3)


@pytest.fixture(scope="module")
def noisy_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two small views by Cycles with few samples, denoised, the raw layers kept."""
    root = tmp_path_factory.mktemp("noisy") / "dataset"
    size = (
        "--preset",
        "smoke",
        "--width",
        "96",
        "--height",
        "72",
        "--views",
        "2",
        "--spp",
        "16",
        "--seed",
        "5",
        "--keep-raw",
    )
    assert main(["scene", "--out", str(root), "--renderer", "cycles", *size]) == 0
    return root


@pytest.mark.slow
def test_noisy_views_are_sound(noisy_dataset: Path) -> None:
    folder = scene_dir(noisy_dataset, 0)
    record = read_scene(folder)
    assert record.denoised
    assert verify_scene(folder) == []
    for number, stated in enumerate(record.views):
        view = read_view(folder / view_file(number))
        assert set(view.raw) == set(view.variants)
        assert (view.raw["all"] != view.variants["all"]).any()
        np.testing.assert_allclose(view.raw["all"].sum(axis=0), view.combined, rtol=5e-3, atol=1e-3)
        for light, layer in zip(view.lights, view.raw["all"], strict=True):
            assert layer.mean() == pytest.approx(stated.energy["all"][light].mean, rel=2e-3)


def brightest_layer(change: Callable[[Float32], Float32], variant: str = "all") -> Damage:
    """Change the layer that gives most light, as a fault in storing or mixing layers would."""

    def damage(view: ViewData, name: str) -> ViewData:
        def changed(layers: Float32) -> Float32:
            brightest = int(np.argmax(layers.mean(axis=(1, 2, 3))))
            layers[brightest] = change(layers[brightest])
            return layers

        return changed_variant(view, variant.format(name), changed)

    return damage


def with_mirrored_layers(view: ViewData, _: str) -> ViewData:
    return changed_variant(view, "all", lambda layers: layers[:, :, ::-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(brightest_layer(np.zeros_like), id="lost"),
        pytest.param(brightest_layer(lambda layer: 2 * layer), id="doubled"),
        pytest.param(brightest_layer(lambda layer: layer * np.float32(0.7)), id="half-a-stop-darker"),
        pytest.param(brightest_layer(np.zeros_like, "without_{}"), id="lost-in-background"),
        pytest.param(with_mirrored_layers, id="mirrored"),
    ],
)
def test_damage_is_found_in_noisy_layers(noisy_dataset: Path, tmp_path: Path, damage: Damage) -> None:
    folder = Path(shutil.copytree(noisy_dataset, tmp_path / "dataset")) / "scenes" / "000000"
    rewrite(folder, damage)
    assert "additivity" in {fault.check for fault in verify_scene(folder)}
