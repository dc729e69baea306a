import dataclasses
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from multilight.datagen.errors import StoreError
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, read_dataset, read_scene, read_view, scene_dir, write_view
from tests.datagen.chain import rewrite_json


def all_channels(path: Path) -> dict[str, np.ndarray]:
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    return {name: channel.pixels for part in parts for name, channel in part.channels.items()}


def test_channels_are_named_and_typed_as_documented(
    sphere_view: tuple[SceneRecord, ViewData], spheres_dataset: Path
) -> None:
    record, _ = sphere_view
    channels = all_channels(scene_dir(spheres_dataset, 0) / record.views[0].file)
    objects = record.scene.insertable
    assert len(objects) == 3
    variants = ["all", *(f"{a}_{o}" for a in ("without", "foreground") for o in objects)]
    expected = {f"{v}.{light}.{c}" for v in variants for light in record.rig.names for c in "RGB"}
    expected |= {f"combined.{c}" for c in "RGB"} | {f"albedo.{c}" for c in "RGB"}
    expected |= {f"normal_world.{c}" for c in "XYZ"} | {f"coverage_{o}.A" for o in objects}
    expected |= {"z_depth.Z", "roughness.Y", "metallic.Y", "instance_id.ID", "environment.A"}
    assert set(channels) == expected
    assert channels["z_depth.Z"].dtype == np.float32
    assert channels["instance_id.ID"].dtype == np.uint32
    assert channels[f"all.{record.rig.names[0]}.R"].dtype == np.float16


def test_a_variant_is_a_part_of_its_own(sphere_view: tuple[SceneRecord, ViewData], spheres_dataset: Path) -> None:
    record, _ = sphere_view
    file = OpenEXR.File(str(scene_dir(spheres_dataset, 0) / record.views[0].file), separate_channels=True)
    names = [part.name() for part in file.parts]
    assert names[0] == "all"
    assert {"combined", "geometry", *(f"without_{o}" for o in record.scene.insertable)} <= set(names)
    for part in file.parts[:-1]:
        assert all(channel.startswith(part.name() + ".") for channel in part.channels)


def test_round_trip_keeps_everything_to_half_precision(
    sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path
) -> None:
    _, view = sphere_view
    write_view(tmp_path / "v.exr", view)
    back = read_view(tmp_path / "v.exr")
    assert back.lights == view.lights
    for name, layers in view.variants.items():
        np.testing.assert_array_equal(back.variants[name], layers)
    for name, alpha in view.coverage.items():
        np.testing.assert_array_equal(back.coverage[name], alpha)
    for field in dataclasses.fields(view.geometry):
        np.testing.assert_array_equal(getattr(back.geometry, field.name), getattr(view.geometry, field.name))


def test_raw_layers_are_kept_beside_the_others(sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path) -> None:
    _, view = sphere_view
    raw = {variant: layers * np.float32(0.5) for variant, layers in view.variants.items()}
    write_view(tmp_path / "v.exr", dataclasses.replace(view, raw=raw))
    channels = all_channels(tmp_path / "v.exr")
    name = next(iter(view.coverage))
    assert {f"raw_{v}.{view.lights[0]}.R" for v in ("all", f"without_{name}", f"foreground_{name}")} <= set(channels)
    back = read_view(tmp_path / "v.exr")
    assert set(back.variants) == set(back.raw) == set(view.variants)
    for variant, layers in raw.items():
        np.testing.assert_allclose(back.raw[variant], layers, rtol=1e-3, atol=1e-7)
    assert view.raw == {}


def test_radiance_beyond_half_is_kept_as_float(sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path) -> None:
    _, view = sphere_view
    bright = {name: layers.copy() for name, layers in view.variants.items()}
    bright["all"][0, 5, 7] = 1e6
    write_view(tmp_path / "v.exr", dataclasses.replace(view, variants=bright))
    assert read_view(tmp_path / "v.exr").variants["all"][0, 5, 7, 1] == 1e6


def test_same_view_same_bytes(sphere_view: tuple[SceneRecord, ViewData], tmp_path: Path) -> None:
    _, view = sphere_view
    write_view(tmp_path / "a.exr", view)
    write_view(tmp_path / "b.exr", view)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99])
def test_truncated_view_names_the_file(spheres_copy: Path, keep: float) -> None:
    path = scene_dir(spheres_copy, 0) / "views" / "00.exr"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data) if keep < 1 else keep)])
    with pytest.raises(StoreError, match=re.escape(str(path))):
        read_view(path)


def test_foreign_exr_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.exr"
    OpenEXR.File({}, {"RGB": np.zeros((4, 4, 3), np.float32)}).write(str(path))
    with pytest.raises(StoreError, match=r"other\.exr.*missing"):
        read_view(path)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"index": 0', '"index": -1', "damaged"),
        ('"schema_version": 3', '"schema_version": 99', "schema version 99"),
        ('"radius"', '"radios"', "damaged"),
    ],
)
def test_damaged_scene_record_is_refused(spheres_copy: Path, old: str, new: str, expected: str) -> None:
    path = scene_dir(spheres_copy, 0) / "scene.json"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(StoreError, match=expected):
        read_scene(path.parent)


def test_scene_record_with_changed_content_fails_its_hash(spheres_copy: Path) -> None:
    path = scene_dir(spheres_copy, 0) / "scene.json"
    text = path.read_text()
    changed = re.sub(r'("radius": )([0-9.]+)', lambda m: f"{m[1]}{float(m[2]) * 1.5}", text, count=1)
    assert changed != text
    path.write_text(changed)
    with pytest.raises(StoreError, match="record_sha256"):
        read_scene(path.parent)
    rewrite_json(path, lambda _: None)
    with pytest.raises(StoreError, match="scene_sha256"):
        read_scene(path.parent)


def test_not_a_dataset(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"dataset\.json is missing"):
        read_dataset(tmp_path)
