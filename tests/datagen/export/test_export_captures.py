"""Captures for nerfstudio and COLMAP: read by pycolmap and trimesh, and held against the scene in closed form."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from multilight.datagen.cli import main
from multilight.datagen.export.images import depth_mm
from multilight.datagen.storage.open_dataset import DatasetSource, open_dataset
from multilight.datagen.storage.records import SceneRecord
from multilight.datagen.tuples import compose
from multilight.lights.display.tonemap import to_display
from multilight.scenes.arrays import Float64
from multilight.scenes.spec import Rectangle, Sphere

POINTS = 3000


def exported(kind: str, dataset: Path, out: Path) -> Path:
    words = ["export", kind, str(dataset), "--out", str(out), "--conditions", "2", "--points", str(POINTS)]
    assert main([*words, "--where", "index = 0"]) == 0
    return out


@pytest.fixture(scope="module")
def nerfstudio(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported("nerfstudio", spheres_dataset, tmp_path_factory.mktemp("nerfstudio"))


@pytest.fixture(scope="module")
def colmap(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return exported("colmap", spheres_dataset, tmp_path_factory.mktemp("colmap"))


@pytest.fixture(scope="module")
def source(spheres_dataset: Path) -> DatasetSource:
    return open_dataset(spheres_dataset)


def read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def distance_to_surfaces(record: SceneRecord, points: Float64) -> Float64:
    """Distance [m] of points (N, 3) from the nearest sphere or plane, in closed form."""
    found = []
    for body in record.scene.bodies:
        pose = np.array(body.world_from_body)
        scale = float(np.linalg.norm(pose[:3, 0]))
        match body.geometry:
            case Sphere(radius=radius):
                found.append(np.abs(np.linalg.norm(points - pose[:3, 3], axis=1) - radius * scale))
            case Rectangle():
                found.append(np.abs((points - pose[:3, 3]) @ (pose[:3, 2] / scale)))
    return np.min(found, axis=0)


def test_nerfstudio_depth_and_poses_give_the_scene_back(nerfstudio: Path, source: DatasetSource) -> None:
    record = source.scene(0)
    for condition in record.conditions[:2]:
        folder = nerfstudio / "scene_000000" / condition.name
        content: dict[str, Any] = json.loads((folder / "transforms.json").read_text())
        assert len(content["frames"]) == len(record.views)
        for number, frame in enumerate(content["frames"]):
            lens = content | frame  # nerfstudio: per frame, else for all
            depth = read(folder / frame["depth_file_path"])
            assert depth.dtype == np.uint16
            assert depth.shape == (lens["h"], lens["w"])
            rows, columns = np.nonzero(depth)
            z = depth[rows, columns] / 1000.0
            # OpenGL axes: x right, y up, looking along -z.
            right = (columns + 0.5 - lens["cx"]) / lens["fl_x"] * z
            up = -(rows + 0.5 - lens["cy"]) / lens["fl_y"] * z
            pose = np.array(frame["transform_matrix"])
            points = np.stack([right, up, -z, np.ones_like(z)], axis=1) @ pose.T
            assert distance_to_surfaces(record, points[:, :3]).max() < 0.003  # half a millimetre of depth, at a slant
            view = source.view(record, number)
            np.testing.assert_array_equal(
                read(folder / frame["file_path"]), to_display(compose.target(view, condition))
            )
            mask = read(folder / frame["mask_path"])
            np.testing.assert_array_equal(mask == 0, view.geometry.environment >= 0.5)
            assert set(np.unique(mask)) <= {0, 255}


def test_lens_stands_once_where_all_views_share_it(nerfstudio: Path, source: DatasetSource) -> None:
    content = json.loads((nerfstudio / "scene_000000" / "all" / "transforms.json").read_text())
    cameras = source.scene(0).scene.cameras
    shared = len({(camera.fx, camera.fy, camera.cx, camera.cy) for camera in cameras}) == 1
    assert ("fl_x" in content) == shared
    for frame, camera in zip(content["frames"], cameras, strict=True):
        assert (content | frame)["fl_x"] == camera.fx


def test_initial_points_lie_on_the_surfaces_in_their_colours(nerfstudio: Path, source: DatasetSource) -> None:
    record = source.scene(0)
    folders = [nerfstudio / "scene_000000" / condition.name for condition in record.conditions[:2]]
    first, second = (trimesh.load(folder / "points.ply") for folder in folders)
    assert first.vertices.shape == (POINTS, 3)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    assert (first.colors != second.colors).any()
    assert distance_to_surfaces(record, np.asarray(first.vertices)).max() < 1e-4


def test_pycolmap_reads_the_model_and_it_reprojects(colmap: Path, source: DatasetSource) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    record = source.scene(0)
    folder = colmap / "scene_000000" / record.conditions[1].name
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert model.num_reg_images() == model.num_cameras() == len(record.views)
    assert model.num_points3D() == POINTS
    for image in model.images.values():
        number = int(image.name.split(".")[0])
        camera = record.scene.cameras[number]
        np.testing.assert_allclose(image.projection_center(), camera.pose()[:3, 3], atol=1e-9)
        np.testing.assert_allclose(image.viewing_direction(), -camera.pose()[:3, 2], atol=1e-9)
        depth = read(folder / "depths" / image.name) / 1000.0
        picture = read(folder / "images" / image.name)
        assert (folder / "masks" / f"{image.name}.png").is_file()
        seen = [point for point in image.points2D if point.has_point3D()]
        assert len(seen) == len(image.points2D) > POINTS // (2 * len(record.views))
        pixels = np.array([point.xy for point in seen])
        points = np.array([model.points3D[point.point3D_id].xyz for point in seen])
        local = image.cam_from_world() * points
        np.testing.assert_allclose(model.cameras[image.camera_id].img_from_cam(local), pixels, atol=1e-6)
        column, row = pixels.astype(int).T
        np.testing.assert_allclose(local[:, 2], depth[row, column], rtol=0.011)
        colours = np.array([model.points3D[point.point3D_id].color for point in seen]).astype(int)
        assert np.median(np.abs(colours - picture[row, column])) <= 2


def test_pycolmap_finds_every_track_where_the_images_say(colmap: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(colmap / "scene_000000" / "all" / "sparse" / "0")
    several = 0
    for number, point in model.points3D.items():
        assert point.track.length() >= 1
        for element in point.track.elements:
            assert model.images[element.image_id].points2D[element.point2D_idx].point3D_id == number
        several += point.track.length() > 1
    assert several > POINTS // 4


def test_a_second_run_keeps_what_is_there(nerfstudio: Path, spheres_dataset: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in nerfstudio.rglob("*")}
    exported("nerfstudio", spheres_dataset, nerfstudio)
    assert {path: path.stat().st_mtime_ns for path in nerfstudio.rglob("*")} == before


def test_depth_in_millimetres() -> None:
    depth = np.array([[0.0, 0.0004, 1.2346, 65.535, 65.536, 900.0]])
    assert depth_mm(depth).tolist() == [[0, 0, 1235, 65535, 0, 0]]


@pytest.mark.parametrize(("word", "value"), [("--conditions", "0"), ("--points", "0")])
def test_bad_values_are_named(
    word: str, value: str, spheres_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "colmap", str(spheres_dataset), "--out", str(tmp_path / "out"), word, value]) == 1
    assert f"{word} {value}" in capsys.readouterr().err
