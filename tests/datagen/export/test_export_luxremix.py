"""LuxRemix' layout, read by a small reader of our own that knows only the published description."""

import json
import re
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from multilight.datagen.cli import main
from multilight.datagen.export.luxremix.export import _rgba, light_masks
from multilight.datagen.export.luxremix.meta import draw_passes
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, write_exr
from multilight.lights.spec import EmissiveLight, EnvironmentLight, LightRig

IMAGE = re.compile(r"^(\d{4})\.(\d{4})\.([a-z_]+)\.(exr|png|jpg)$")
META = re.compile(r"^(\d{4})\.meta\.json$")


class Scene:
    """What FORMAT.md says of a scene's folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.images = {(int(m[1]), int(m[2]), m[3]): m[0] for p in folder.iterdir() if (m := IMAGE.match(p.name))}
        self.metas = {int(m[1]): json.loads(p.read_text()) for p in folder.iterdir() if (m := META.match(p.name))}
        assert len(self.images) + len(self.metas) == len(list(folder.iterdir()))
        self.views = sorted({view for _, view, _ in self.images})
        self.olat = sorted(number for number in self.metas if number > 1000)

    def channels(self, number: int, view: int, kind: str) -> dict[str, Any]:
        path = self.folder / self.images[number, view, kind]
        return {name: c.pixels for name, c in OpenEXR.File(str(path), separate_channels=True).channels().items()}

    def rgb(self, number: int, view: int, kind: str) -> np.ndarray:
        channels = self.channels(number, view, kind)
        return np.stack([channels[c] for c in "RGB"], axis=-1).astype(np.float64)

    def picture(self, number: int, view: int, kind: str) -> np.ndarray:
        return np.asarray(Image.open(self.folder / self.images[number, view, kind]))


@pytest.fixture(scope="module")
def exported(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("luxremix")
    assert main(["export", "luxremix", str(spheres_dataset), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def scene(exported: Path) -> Scene:
    return Scene(exported / "000001")  # the one with five lamps


def test_every_view_has_every_file(exported: Path, spheres_dataset: Path) -> None:
    for record in open_dataset(spheres_dataset).scenes():
        scene = Scene(exported / f"{record.index:06d}")
        lights = [light for light in record.rig.lights if light.kind != "environment"]
        assert scene.views == list(range(1, len(record.views) + 1))
        assert scene.olat == [1001 + i for i in range(len(lights))]
        assert sorted(scene.metas) == [0, 1, 2, 3, 1000, *scene.olat]
        wanted = {(0, kind) for kind in ("depth", "normal", "diffcol", "lgt_obj", "lgt_src", "window")}
        wanted |= {(number, kind) for number in range(4) for kind in ("rgb_mix", "rgb_ldr_mix")}
        wanted |= {(1000, kind) for kind in ("rgb_bg", "rgb_ldr_bg")}
        wanted |= {(number, kind) for number in scene.olat for kind in ("rgb_olat", "rgb_ldr_olat")}
        for view in scene.views:
            assert {(number, kind) for number, v, kind in scene.images if v == view} == wanted | {
                (number, "rgb_ldr_mix") for number in range(4)
            }


def test_pixel_types_are_those_of_the_description(scene: Scene) -> None:
    assert {n: p.dtype for n, p in scene.channels(0, 1, "rgb_mix").items()} == dict.fromkeys(
        "RGBA", np.dtype("float16")
    )
    assert {n: p.dtype for n, p in scene.channels(1000, 1, "rgb_bg").items()} == dict.fromkeys(
        "RGBA", np.dtype("float16")
    )
    olat = scene.channels(scene.olat[0], 1, "rgb_olat")
    assert {n: p.dtype for n, p in olat.items()} == dict.fromkeys("RGB", np.dtype("float32"))
    (depth,) = scene.channels(0, 1, "depth").values()
    assert depth.dtype == np.float32


def test_mixes_are_the_weighted_sums_that_the_metadata_say(scene: Scene) -> None:
    reference = {light["id"]: light for light in scene.metas[0]["lighting"]}
    for view in scene.views:
        background = scene.rgb(1000, view, "rgb_bg")
        for number in range(4):
            total = background.copy()
            for olat in scene.olat:
                (active,) = [light["id"] for light in scene.metas[olat]["lighting"] if light["update"]]
                now = next(light for light in scene.metas[number]["lighting"] if light["id"] == active)
                gain = now["power"] * np.array(now["color"])
                gain /= reference[active]["power"] * np.array(reference[active]["color"])
                total += gain * scene.rgb(olat, view, "rgb_olat")
            np.testing.assert_allclose(scene.rgb(number, view, "rgb_mix"), total, rtol=2e-3, atol=2e-3 * total.mean())
    assert not any(light["update"] for number in (0, 1, 2, 3, 1000) for light in scene.metas[number]["lighting"])
    powers = {number: [light["power"] for light in scene.metas[number]["lighting"]] for number in range(4)}
    assert len({tuple(each) for each in powers.values()}) == 4


def test_depth_is_along_the_ray_and_cameras_say_where_it_leads(scene: Scene, spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(1)
    for view, pose in zip(scene.views, scene.metas[0]["camera_pose"], strict=True):
        (distance,) = scene.channels(0, view, "depth").values()
        height, width = distance.shape
        focal = width / 2 / np.tan(np.radians(pose["fov"]) / 2)
        x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, height / 2 - np.arange(height) - 0.5)
        rays = np.stack([x, y, np.full_like(x, -focal)], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        w, *xyz = pose["rotation"]
        rotation = Rotation.from_quat([*xyz, w]).as_matrix()
        np.testing.assert_allclose(rotation, np.array(record.views[view - 1].c2w)[:3, :3], atol=1e-6)
        z_depth = -(rays * distance[..., None])[..., 2]
        np.testing.assert_allclose(z_depth, source.view(record, view - 1).geometry.z_depth, rtol=1e-5, atol=1e-6)


def test_normals_window_and_light_masks(scene: Scene, spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(1)
    colours = {tuple(light["mask_color"]) for light in scene.metas[0]["lighting"]}
    assert len(colours) == len(scene.olat)
    for view in scene.views:
        buffers = source.view(record, view - 1).geometry
        decoded = scene.picture(0, view, "normal") / 255.0 * 2.0 - 1.0
        np.testing.assert_allclose(decoded, buffers.normal_world, atol=0.005)
        np.testing.assert_allclose(scene.picture(0, view, "window") / 255.0, buffers.environment, atol=0.003)
        for kind in ("lgt_obj", "lgt_src"):
            painted = {tuple(c) for c in scene.picture(0, view, kind).reshape(-1, 3).tolist()} - {(0, 0, 0)}
            assert painted <= colours


def test_tars_hold_ten_scenes_and_the_same_files(exported: Path, spheres_dataset: Path, tmp_path: Path) -> None:
    assert main(["export", "luxremix", str(spheres_dataset), "--out", str(tmp_path), "--tar"]) == 0
    found: dict[str, bytes] = {}
    assert (tmp_path / "manifest.json").is_file()
    for path in tmp_path.glob("*.tar"):
        assert re.fullmatch(r"(training|test)-\d{4}\.tar", path.name)
        with tarfile.open(path, "r:") as tar:
            found |= {entry.name: tar.extractfile(entry).read() for entry in tar}
    there = {str(path.relative_to(exported)): path.read_bytes() for path in exported.rglob("*/*") if path.is_file()}
    assert found == there


def test_glowing_bodies_are_painted_and_what_shines_of_them(sphere_view: tuple[SceneRecord, ViewData]) -> None:
    record, view = sphere_view
    name = record.scene.insertable[0]
    body = view.geometry.instance_id == record.scene.instance_id(name)
    shining = body & (np.arange(body.shape[0])[:, None] % 2 == 0)
    light = np.array([4, 2, 1], np.float32)
    layer = np.where(shining[..., None], light, np.float32(0.5))  # the rest is lit by what shines
    glow = EmissiveLight(name="glow", body=name, radiance=(4.0, 2.0, 1.0))
    record = record.model_copy(update={"rig": LightRig(lights=(*record.rig.lights, glow))})
    layers = np.concatenate([view.variants["all"], layer[None]])
    view = replace(view, lights=(*view.lights, "glow"), variants=dict(view.variants) | {"all": layers})
    passes = draw_passes(record)
    fixtures, sources = light_masks(view, record, passes)
    assert shining.any()
    for mask, wanted in ((fixtures, body), (sources, shining)):
        np.testing.assert_array_equal((mask == passes.colours["glow"]).all(axis=-1), wanted)
        assert not mask[~wanted].any()


def test_a_scene_of_environment_light_alone_has_no_layers(spheres_dataset: Path) -> None:
    record = open_dataset(spheres_dataset).scene(0)
    rig = record.rig.model_copy(update={"lights": (EnvironmentLight(name="environment"),)})
    assert draw_passes(record.model_copy(update={"rig": rig})).lights == ()


def test_radiance_beyond_half_floats_is_not_clamped(tmp_path: Path) -> None:
    for peak, kind in ((1e4, np.float16), (1e6, np.float32)):
        picture = np.full((4, 6, 3), peak, np.float32)
        write_exr(tmp_path / "mix.exr", _rgba(picture))
        channels = OpenEXR.File(str(tmp_path / "mix.exr"), separate_channels=True).channels()
        assert set(channels) == set("RGBA")
        assert channels["R"].pixels.dtype == kind
        np.testing.assert_array_equal(channels["G"].pixels, picture[..., 1])
        np.testing.assert_array_equal(channels["A"].pixels, 1)
