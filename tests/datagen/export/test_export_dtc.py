"""DTC-MultiLight exports, read back by a reader written from the format's description alone."""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.export.dtc.scene import Frame, numbered
from multilight.datagen.export.dtc.work import choose
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.storage.store import ViewData, read_scene, read_view, scene_dir
from multilight.datagen.tuples.compose import background, composite, target
from multilight.lights.display.reinhard import Metering, join, meter_view, tone_map
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, project, unproject
from tests.datagen.chain import chain, rewrite_json

SIZE, MAP, CONDITIONS, EXPOSURES = 48, 32, 3, 2
OPTIONS = ["--size", str(SIZE), "--map-size", str(MAP), "--conditions", str(CONDITIONS)]
OPTIONS += ["--exposures", str(EXPOSURES), "--workers", "1"]
TRAIN, EVAL = ("DTC-MultiLight-2D", "DTC-MultiLight-3D"), ("DTC-MultiLight-2DEval", "DTC-MultiLight-3DEval")
LIGHTINGS = [f"{name}_ev{k}" for name in ("0_0", "0_1", "1_0") for k in range(EXPOSURES)]


def _png(path: Path) -> np.ndarray:
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def dataset(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes, the second held out of training."""
    root = Path(shutil.copytree(spheres_dataset, tmp_path_factory.mktemp("dtc") / "dataset"))
    path = scene_dir(root, 1) / "scene.json"
    rewrite_json(path, lambda record: record.update(split="test"))
    chain(root)
    return root


@pytest.fixture(scope="module")
def exported(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dtc") / "export"
    assert main(["export", "dtc-multilight", str(dataset), "--out", str(out), *OPTIONS]) == 0
    return out


@pytest.fixture(scope="module")
def native(dataset: Path) -> tuple[SceneRecord, list[ViewData]]:
    folder = scene_dir(dataset, 0)
    record = read_scene(folder)
    return record, [read_view(folder / view.file) for view in record.views]


def _cropped(picture: np.ndarray) -> np.ndarray:
    """The views are 64 x 48: the stored square is their middle."""
    return picture[:, 8:56]


def test_folders_and_names_are_the_published_ones(exported: Path) -> None:
    assert {p.name for p in exported.iterdir()} == {
        *TRAIN,
        *EVAL,
        "README.md",
        *("train.json", "test.json", "manifest.json"),
    }
    for root, scene in ((TRAIN[0], "scene_00000"), (TRAIN[1], "scene_00000"), (EVAL[0], "scene_00001")):
        assert [p.name for p in (exported / root).iterdir()] == [scene]
    flat, maps = (exported / root / "scene_00000" for root in TRAIN)
    assert sorted(p.name for p in flat.iterdir()) == LIGHTINGS
    assert sorted(p.name for p in maps.iterdir()) == [*LIGHTINGS, "projs.npy"]
    views, objects = range(3), range(3)
    per_object = {f"{v}_object{j}.png" for v in views for j in objects}
    expected = {
        "images": {f"{v}.png" for v in views},
        "depths": {f"{v}.png" for v in views},
        "env_masks": {f"{v}.png" for v in views},
        "object_masks": per_object,
        "object_bgs": per_object,
    }
    for lighting in LIGHTINGS:
        assert {p.name for p in (flat / lighting).iterdir()} == {*expected, "transforms.json"}
        for folder, names in expected.items():
            assert {p.name for p in (flat / lighting / folder).iterdir()} == names
        names = {f"{kind}{j}.png" for kind in ("bg", "mask") for j in objects}
        assert {p.name for p in (maps / lighting).iterdir()} == {*names, "img.png", "gs.npy", "transforms.json"}
    flat, maps = (exported / root / "scene_00001" for root in EVAL)
    kinds = {"composites", "bgs", "depths", "gts", "masks"}
    assert {p.name for p in flat.iterdir()} == {*kinds, "transforms.json"}
    assert all({p.name for p in (flat / kind).iterdir()} == {f"{v}.png" for v in views} for kind in kinds)
    assert {p.name for p in maps.iterdir()} == {"composite.png", "gt.png", "gs.npy", "projs.npy"}


def test_transforms_hold_the_published_keys_and_existing_paths(exported: Path) -> None:
    root = exported / TRAIN[0]
    data = _json(root / "scene_00000/1_0_ev1/transforms.json")
    assert set(data) == {"camera_angle_x", "frames"}
    keys = {"image_path", "depth_path", "env_mask_path", "object_mask_path", "object_bg_path", "transform_matrix"}
    for number, frame in enumerate(data["frames"]):
        assert set(frame) == keys
        assert frame["image_path"] == f"scene_00000/1_0_ev1/images/{number}.png"
        for key in keys - {"transform_matrix"}:
            paths = frame[key] if isinstance(frame[key], list) else [frame[key]]
            assert all((root / path).is_file() for path in paths)
    data = _json(exported / TRAIN[1] / "scene_00000/1_0_ev1/transforms.json")
    assert set(data) == {"rgb_path", "rgb_bg_path", "rgb_mask_path", "gs_path"}
    for value in data.values():
        assert all((exported / TRAIN[1] / p).is_file() for p in (value if isinstance(value, list) else [value]))
    data = _json(exported / EVAL[0] / "scene_00001/transforms.json")
    keys = {"composite_path", "bg_path", "depth_path", "gt_path", "mask_path"}
    assert all(set(frame) == {*keys, "transform_matrix"} for frame in data["frames"])
    assert all((exported / EVAL[0] / frame[key]).is_file() for frame in data["frames"] for key in keys)


def test_cameras_see_what_the_depth_says(exported: Path, native: tuple[SceneRecord, list[ViewData]]) -> None:
    """Field of view and pose alone put the stored depth where the dataset's own camera puts it."""
    record, views = native
    data = _json(exported / TRAIN[0] / "scene_00000/0_0_ev0/transforms.json")
    limit = max(view.geometry.z_depth.max() for view in views)
    for number, frame in enumerate(data["frames"]):
        camera = camera_from_fov(frame["transform_matrix"], width=SIZE, height=SIZE, fov=data["camera_angle_x"])
        true = _cropped(views[number].geometry.z_depth)
        expected = _cropped(unproject(record.scene.cameras[number], views[number].geometry.z_depth))
        np.testing.assert_allclose(unproject(camera, true), expected, atol=1e-6)
        stored = _png(exported / TRAIN[0] / frame["depth_path"])
        assert stored.dtype == np.uint8
        np.testing.assert_allclose(stored[true > 0], true[true > 0] / limit * 255, atol=1.0)
        assert (stored[true == 0] == 255).all()
        environment = _png(exported / TRAIN[0] / frame["env_mask_path"])
        np.testing.assert_array_equal(environment, np.where(true == 0, 255, 0))


def test_tone_curve_and_exposures_are_the_published_ones(
    exported: Path, native: tuple[SceneRecord, list[ViewData]]
) -> None:
    """Recomputed in plain words from the layers: key, white, curve."""
    record, views = native
    for number, name in enumerate(("0_0", "0_1", "1_0")):
        lit = record.conditions[number]
        radiances = [target(view, lit).astype(np.float64) for view in views]
        hits = [view.geometry.z_depth > 0 for view in views]
        keys = [np.log(r[h][r[h] > 0]).mean() for r, h in zip(radiances, hits, strict=True)]
        largest = max(r[h].max() for r, h in zip(radiances, hits, strict=True))
        for k in range(EXPOSURES):
            ev = -np.mean(keys) - 2.0 + 0.5 * (k + 1)
            white = np.exp(ev) * largest
            for v, view in enumerate(views):
                pictures = {f"images/{v}.png": radiances[v]}
                for j, removed in enumerate(record.scene.insertable):
                    pictures[f"object_bgs/{v}_object{j}.png"] = background(view, removed, lit).astype(np.float64)
                for file, radiance in pictures.items():
                    x = radiance * np.exp(ev)
                    y = np.clip(x * (1 + x / white**2) / (1 + x) * 255, 0, 255)
                    stored = _png(exported / TRAIN[0] / "scene_00000" / f"{name}_ev{k}" / file)
                    assert stored.dtype == np.uint8
                    assert stored.shape == (SIZE, SIZE, 3)
                    assert (np.abs(stored - np.floor(_cropped(y))) <= 1).all()


def test_composites_by_their_formula_equal_ours(exported: Path, native: tuple[SceneRecord, list[ViewData]]) -> None:
    record, views = native
    scene = exported / TRAIN[0] / "scene_00000"
    compared = 0
    for v, view in enumerate(views):
        for j, name in enumerate(record.scene.insertable):
            mask = _png(scene / f"0_0_ev0/object_masks/{v}_object{j}.png")
            coverage = _cropped(view.coverage[name])
            np.testing.assert_allclose(mask, coverage * 255, atol=0.51)
            insert = _png(scene / f"1_0_ev1/images/{v}.png") / 255.0
            base = _png(scene / f"0_1_ev0/object_bgs/{v}_object{j}.png") / 255.0
            share = mask[..., None] / 255.0
            theirs = insert * share + base * (1 - share)
            meterings = {
                number: join([meter_view(target(w, record.conditions[number]), w.geometry.z_depth > 0) for w in views])
                for number in (1, 2)
            }
            gains = {1: np.exp(meterings[1].exposure(0)), 2: np.exp(meterings[2].exposure(1))}
            exposed = {
                number: record.conditions[number].model_copy(
                    update={"exposure_ev": record.conditions[number].exposure_ev + math.log2(gains[number])}
                )
                for number in (1, 2)
            }
            linear = _cropped(composite(view, name, insert=exposed[2], base=exposed[1]))
            white = np.where(mask[..., None] == 255, gains[2] * meterings[2].white, gains[1] * meterings[1].white)
            ours = np.clip(linear * (1 + linear / white**2) / (1 + linear), 0, 1)
            plain = (mask == 0) | (mask == 255)
            compared += int((mask == 255).sum())
            assert np.abs(theirs - ours)[plain].max() < 2.5 / 255
    assert compared > 100


def test_scattering_the_views_by_projs_gives_the_maps(exported: Path) -> None:
    maps, flat = (exported / root / "scene_00000" for root in reversed(TRAIN))
    projs = np.load(maps / "projs.npy")
    assert projs.dtype == np.int32
    assert projs.shape == (MAP * MAP, 4)
    view, pixel, row, column = projs.T
    assert len(set(zip(row.tolist(), column.tolist(), strict=True))) == MAP * MAP
    assert (np.abs(np.diff(projs[:, 2:], axis=0)).sum(axis=1) == 1).all(), "the map is not folded along a curve"
    for lighting in LIGHTINGS:
        images = np.stack([_png(flat / lighting / f"images/{v}.png") for v in range(3)]).reshape(3, -1, 3)
        np.testing.assert_array_equal(_png(maps / lighting / "img.png")[row, column], images[view, pixel])
        for j in range(3):
            removed = [_png(flat / lighting / f"object_bgs/{v}_object{j}.png") for v in range(3)]
            mask = _png(maps / lighting / f"mask{j}.png")
            assert set(np.unique(mask)) <= {0, 255}
            shown = _png(maps / lighting / f"bg{j}.png")
            assert (shown[mask == 255] == 127).all()
            expected = np.stack(removed).reshape(3, -1, 3)[view, pixel]
            others = mask[row, column] == 0
            np.testing.assert_array_equal(shown[row, column][others], expected[others])
            covered = np.stack([_png(flat / lighting / f"object_masks/{v}_object{j}.png") for v in range(3)])
            assert (covered.reshape(3, -1)[view, pixel][~others] > 0).all()
            assert (covered.reshape(3, -1)[view, pixel][others] < 255).all()


def test_gaussians_project_onto_their_pixels_and_show_them(exported: Path) -> None:
    """Splatting each Gaussian's centre with a z-buffer meets the views' colours."""
    maps, flat = (exported / root / "scene_00000" for root in reversed(TRAIN))
    shapes, projs = np.load(maps / "0_0_ev0/gs.npy"), np.load(maps / "projs.npy")
    assert shapes.dtype == np.float32
    assert shapes.shape == (MAP, MAP, 11)
    np.testing.assert_array_equal(shapes, np.load(maps / "1_0_ev1/gs.npy"))
    np.testing.assert_allclose(np.linalg.norm(shapes[..., 7:], axis=-1), 1.0, atol=1e-5)
    assert (shapes[..., 3] == 1.0).all()
    assert (shapes[..., 4:7] > 0).all()
    points = shapes[projs[:, 2], projs[:, 3], :3]
    colors = _png(maps / "0_0_ev1/img.png")[projs[:, 2], projs[:, 3]]
    data = _json(flat / "0_0_ev1/transforms.json")
    for number, frame in enumerate(data["frames"]):
        camera = camera_from_fov(frame["transform_matrix"], width=SIZE, height=SIZE, fov=data["camera_angle_x"])
        pixels, depth = project(camera, points)
        own = projs[:, 0] == number
        np.testing.assert_allclose(
            pixels[own], np.stack([projs[own, 1] % SIZE, projs[own, 1] // SIZE], axis=-1) + 0.5, atol=1e-3
        )
        inside = np.all((pixels >= 0) & (pixels < SIZE), axis=1)
        order = np.flatnonzero(inside)[np.argsort(-depth[inside])]
        splat = np.full((SIZE, SIZE, 3), -1, np.int64)
        columns, rows = pixels[order].astype(int).T
        splat[rows, columns] = colors[order]
        image = _png(flat / f"0_0_ev1/images/{number}.png").astype(int)
        shown = splat[..., 0] >= 0
        assert shown.sum() > 300
        assert np.median(np.abs(splat - image)[shown].max(axis=-1)) <= 3


def test_evaluation_scene_is_one_composite(exported: Path, dataset: Path) -> None:
    flat, maps = (exported / root / "scene_00001" for root in EVAL)
    record = read_scene(scene_dir(dataset, 1))
    choice = choose(record, record.conditions[:CONDITIONS], EXPOSURES)
    assert choice.base.name != choice.insert.name
    name = record.scene.insertable[choice.object]
    changed = 0
    for v, stored in enumerate(record.views):
        coverage = _cropped(read_view(scene_dir(dataset, 1) / stored.file).coverage[name])
        composite_, behind, truth = (
            _png(flat / kind / f"{v}.png").astype(int) for kind in ("composites", "bgs", "gts")
        )
        np.testing.assert_array_equal(composite_[coverage == 0], behind[coverage == 0])
        changed += int((np.abs(composite_ - truth)[coverage == 1].max(axis=-1) > 3).sum())
        mask, depth = _png(flat / f"masks/{v}.png"), _png(flat / f"depths/{v}.png")
        assert (depth[mask == 255] == 255).all()
        assert set(np.unique(mask)) <= {0, 255}
    assert changed > 50
    view, pixel, row, column = np.load(maps / "projs.npy").T
    for file, kind in (("composite", "composites"), ("gt", "gts")):
        pictures = np.stack([_png(flat / kind / f"{v}.png") for v in range(3)]).reshape(3, -1, 3)
        np.testing.assert_array_equal(_png(maps / f"{file}.png")[row, column], pictures[view, pixel])
    assert np.load(maps / "gs.npy").shape == (MAP, MAP, 11)


def test_lists_name_roots_and_scenes(exported: Path) -> None:
    lists = {file: _json(exported / file) for file in ("train.json", "test.json")}
    assert lists["train.json"]["train"]["scenes"] == ["scene_00000"]
    assert lists["test.json"]["test"]["scenes"] == ["scene_00001"]
    for group, roots in ((lists["train.json"]["train"], TRAIN), (lists["test.json"]["test"], EVAL)):
        assert group["data_root"] == group["data_root_2d"] == str((exported / roots[0]).resolve())
        assert group["data_root_3d"] == str((exported / roots[1]).resolve())


def test_export_goes_on_where_it_was(exported: Path, dataset: Path, tmp_path: Path) -> None:
    """What is missing is written anew, byte for byte; what is there is not touched."""
    out = Path(shutil.copytree(exported, tmp_path / "export"))
    lost, kept = out / TRAIN[0] / "scene_00000", out / TRAIN[1] / "scene_00000" / "projs.npy"
    shutil.rmtree(lost)
    (out / "work" / "half" / "0_0_ev0").mkdir(parents=True)
    before = kept.stat().st_mtime_ns
    assert main(["export", "dtc-multilight", str(dataset), "--out", str(out), "--part", "2d-train", *OPTIONS]) == 0
    assert kept.stat().st_mtime_ns == before
    assert not (out / "work").exists()
    files = [p.relative_to(lost) for p in lost.rglob("*") if p.is_file()]
    assert len(files) == len([p for p in (exported / TRAIN[0] / "scene_00000").rglob("*") if p.is_file()])
    for file in files:
        assert (lost / file).read_bytes() == (exported / TRAIN[0] / "scene_00000" / file).read_bytes(), file


def _refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["export", "dtc-multilight", *words]) == 1
    return capsys.readouterr().err


def test_refusals_name_value_and_remedy(
    dataset: Path, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, out = str(dataset), str(tmp_path / "out")
    assert "--size 64 must be 1 to 48: the views are rendered at 64x48" in _refused(
        capsys, data, "--out", out, "--size", "64"
    )
    assert "power of two" in _refused(capsys, data, "--out", out, "--size", "48", "--map-size", "100")
    assert "--conditions 99 must be 1 to" in _refused(capsys, data, "--out", out, "--size", "48", "--conditions", "99")
    assert "--exposures 0" in _refused(capsys, data, "--out", out, "--size", "48", "--exposures", "0")
    assert not (tmp_path / "out").exists()
    assert "was made with conditions = 3, not None" in _refused(capsys, data, "--out", str(exported), "--size", "32")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("dear")
    assert "is not empty" in _refused(capsys, data, "--out", str(tmp_path / "mine"), "--size", "48")
    assert "is missing: not a dataset" in _refused(capsys, str(tmp_path / "nowhere"), "--out", out)


def test_a_broken_view_costs_its_scene_only(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = Path(shutil.copytree(dataset, tmp_path / "dataset"))
    path = scene_dir(broken, 0) / read_scene(scene_dir(broken, 0)).views[1].file
    path.write_bytes(path.read_bytes()[:1000])
    out = tmp_path / "out"
    words = ["export", "dtc-multilight", str(broken), "--out", str(out), *OPTIONS]
    assert main(words) == 1
    assert str(path) in capsys.readouterr().err
    assert main([*words, "--on-broken", "skip"]) == 0
    shown = capsys.readouterr().out
    assert "written 1, kept 0, passed over 1" in shown or "written 0, kept 1, passed over 1" in shown
    assert f"scene 0: {path}" in shown
    assert (out / "README.md").read_text().count("0 scenes of split `train`") == 1
    assert not (out / TRAIN[0] / "scene_00000").exists()
    assert (out / EVAL[1] / "scene_00001/gt.png").is_file()


def test_twelve_conditions_are_six_by_two() -> None:
    assert [numbered(i) for i in range(12)] == [f"{a}_{b}" for a in range(6) for b in range(2)]


def test_frame_shrinks_and_crops_as_published() -> None:
    """768 x 512 becomes the middle 256 x 256 of 384 x 256, each pixel the mean of four."""
    picture = np.random.default_rng(0).integers(0, 256, (512, 768, 3), np.uint8)
    frame = Frame.fit(256, 512, 768)
    means = picture.reshape(256, 2, 384, 2, 3).mean(axis=(1, 3))[:, 64:320]
    # The filter rounds twice, once an axis.
    assert np.abs(frame.shrink(picture) - means).max() <= 1.0
    rows, columns = np.mgrid[:512, :768]
    np.testing.assert_array_equal(frame.pick(rows)[:, 0], 2 * np.arange(256) + 1)
    np.testing.assert_array_equal(frame.pick(columns)[0], 2 * np.arange(256) + 129)


@pytest.mark.parametrize(("height", "width"), [(512, 768), (300, 300), (256, 400)])
def test_picked_camera_sees_through_the_picked_pixels(height: int, width: int) -> None:
    pose = look_at((2.0, 1.0, 1.5), (0.0, 0.0, 0.0))
    rendered = camera_from_fov(pose, width=width, height=height, fov=0.9)
    frame = Frame.fit(256, height, width)
    depth = np.full((height, width), 2.0)
    lifted = unproject(frame.picked_camera(rendered), frame.pick(depth))
    lifted -= np.asarray(frame.pick(unproject(rendered, depth)), np.float64)
    error = np.linalg.norm(lifted, axis=-1) / (2.0 / frame.camera(rendered).fx)
    whole = height % 256 == 0
    assert error.max() < (1e-6 if whole else 0.75)
    stored, picked = frame.camera(rendered), frame.picked_camera(rendered)
    assert abs(stored.cx - 128) < 0.51
    assert max(abs(stored.cx - picked.cx), abs(stored.cy - picked.cy)) <= 0.5


def test_metering_of_the_dark_and_of_one_value() -> None:
    seen = np.ones((2, 2), bool)
    dark = join([meter_view(np.zeros((2, 2, 3)), seen)])
    assert (tone_map(np.zeros((2, 2, 3)), dark, 0) == 0).all()
    even = join([meter_view(np.full((2, 2, 3), math.e**3), seen), meter_view(np.zeros((2, 2, 3)), seen)])
    assert even.key == pytest.approx(3.0)
    assert even.exposure(0) == pytest.approx(-3.0 - 1.5)
    assert tone_map(np.full(3, even.white), even, 2).tolist() in ([255] * 3, [254] * 3)
    # A pixel brighter than white is clipped; a channel without light stays out of the mean.
    assert tone_map(np.array([1e9, 0.0, 0.0]), Metering(0.0, 1.0), 3).tolist() == [255, 0, 0]
    red = meter_view(np.tile([math.e, 0.0, 0.0], (2, 2, 1)), seen)
    assert red.key == pytest.approx(1.0)


def test_reads_from_any_address(dataset: Path, tmp_path: Path) -> None:
    """A remote dataset exports like a local one: through a zip archive, as fsspec opens it."""
    archive = shutil.make_archive(str(tmp_path / "set"), "zip", dataset)
    source = open_dataset(f"zip://::{archive}")
    assert source.indices == (0, 1)
    words = ["--part", "3d-eval", "--out", str(tmp_path / "out"), *OPTIONS]
    assert main(["export", "dtc-multilight", f"zip://::{archive}", *words]) == 0
    assert (tmp_path / "out" / EVAL[1] / "scene_00001/projs.npy").is_file()
    assert not (tmp_path / "out" / EVAL[0]).exists()
