"""Each check of `verify` finds the fault it is there for, and nothing in a sound dataset."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from datagen.store import ViewData, file_sha256, read_scene, read_view, scene_dir, view_file, write_text, write_view
from datagen.verify import verify_dataset, verify_scene

Damage = Callable[[ViewData, str], ViewData]


def test_a_sound_dataset_has_no_fault(spheres_dataset: Path) -> None:
    assert [faults for _, faults in verify_dataset(spheres_dataset)] == [[], []]


def rewrite(folder: Path, damage: Damage, *, view: int = 1) -> None:
    """Damage a view's content while file and hash stay in order, so that only the identities can tell."""
    record = read_scene(folder)
    path = folder / view_file(view)
    write_view(path, damage(read_view(path), record.scene.insertable[0]))
    views = list(record.views)
    views[view] = views[view].model_copy(update={"file_sha256": file_sha256(path)})
    write_text(folder / "scene.json", record.model_copy(update={"views": tuple(views)}).model_dump_json())


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
