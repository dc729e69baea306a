"""Captures of many views: readers, lenses, depth, and poses found from pictures, held against closed forms."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from multilight.datagen.errors import UserError
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.model.captures.capture import Capture, check_alignment, scaled_camera
from multilight.model.captures.colmap import find_poses
from multilight.model.captures.depths import aligned_depth, depth_of_gaussians, with_depth
from multilight.model.captures.lenses import Lens, undistorted
from multilight.model.captures.planes import scene_centre
from multilight.model.captures.read import read_capture
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, project, unproject
from multilight.scenes.gaussians.from_views import gaussians_from_views
from multilight.scenes.gaussians.ply import write_gaussians
from multilight.scenes.spec import Camera

pytest.importorskip("pycolmap")


@pytest.fixture
def edited(capture_folders: dict[str, Path], tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], None]], Path]:
    """A copy of the nerfstudio capture with its transforms.json changed."""

    def edit(change: Callable[[dict[str, Any]], None]) -> Path:
        copy = tmp_path / "capture"
        for file in (f for f in capture_folders["nerfstudio"].rglob("*") if f.is_file()):
            to = copy / file.relative_to(capture_folders["nerfstudio"])
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(file.read_bytes())
        content = json.loads((copy / "transforms.json").read_text())
        change(content)
        (copy / "transforms.json").write_text(json.dumps(content))
        return copy

    return edit


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_readers_give_the_scene_back(kind: str, capture_folders: dict[str, Path], spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    found = read_capture(capture_folders[kind])
    assert found.z_depths is not None
    for number, (camera, true) in enumerate(zip(found.cameras, record.scene.cameras, strict=True)):
        np.testing.assert_allclose(camera.pose(), true.pose(), atol=1e-9)
        np.testing.assert_allclose(camera.intrinsics(), true.intrinsics(), atol=1e-9)
        depth = source.view(record, number).geometry.z_depth
        np.testing.assert_allclose(found.z_depths[number], np.where(depth < 65.5, depth, 0), atol=0.00051)
        image = np.asarray(Image.open(capture_folders[kind] / "images" / f"{number:02d}.png"))
        np.testing.assert_array_equal(np.rint(found.images[number] * 255), image)
    assert len(found.points) == 500
    if kind == "colmap":
        assert found.seen is not None
        for camera, seen in zip(found.cameras, found.seen, strict=True):
            pixels, _ = project(camera, found.points[seen])
            assert ((pixels > -1e-6) & (pixels < [camera.width + 1e-6, camera.height + 1e-6])).all()


def test_smaller_pictures_keep_their_rays(capture_folders: dict[str, Path], capture: Capture) -> None:
    small = read_capture(capture_folders["nerfstudio"], max_side=32, every=2)
    assert small.images.shape == (2, 24, 32, 3)
    assert small.names == capture.names[::2]
    point = scene_centre(capture)[None]
    for a, b in zip(small.cameras, capture.cameras[::2], strict=True):
        np.testing.assert_allclose(project(a, point)[0] * 2, project(b, point)[0])
    np.testing.assert_allclose(small.images.mean(), capture.images[::2].mean(), atol=0.003)


def test_distortion_is_taken_out() -> None:
    """OpenCV's polynomial, written out: x_d = x (1 + k1 r² + k2 r⁴) + 2 p1 x y + p2 (r² + 2 x²), y likewise."""
    k1, k2, p1, p2 = -0.2, 0.05, 0.004, -0.003
    lens = Lens("OPENCV", 80, 60, (70.0, 72.0, 41.0, 29.0, k1, k2, p1, p2))
    rows, columns = np.mgrid[0:60, 0:80].astype(np.float32)
    image = np.stack([columns, rows, np.zeros_like(rows)], axis=-1)
    camera, straight, depth = undistorted(lens, np.eye(4), image, np.ones((60, 80), np.float32))
    assert depth is not None
    assert depth.shape == straight.shape[:2] == (camera.height, camera.width)
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    x, y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2
    wanted_x = 70 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)) + 41 - 0.5
    wanted_y = 72 * (y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y) + 29 - 0.5
    inside = (wanted_x > 0) & (wanted_x < 79) & (wanted_y > 0) & (wanted_y < 59)
    assert inside.mean() > 0.95
    np.testing.assert_allclose(straight[..., 0][inside], wanted_x[inside], atol=1e-3)
    np.testing.assert_allclose(straight[..., 1][inside], wanted_y[inside], atol=1e-3)


def test_depth_is_aligned_to_sparse_points(capture: Capture) -> None:
    assert capture.z_depths is not None
    camera, depth = capture.cameras[0], capture.z_depths[0]
    rng = np.random.default_rng(3)
    known = depth > 0
    inverse = np.where(known, 1.0 / np.where(known, depth, 1.0), 0.0)
    relative = (3.0 * inverse + 0.7).astype(np.float32)  # a model's own scale and shift
    points = unproject(camera, depth)[known]
    points = points[rng.choice(len(points), 200, replace=False)]
    hidden = points[:40] + 0.4 * (points[:40] - camera.pose()[:3, 3])  # behind what this view sees
    found = aligned_depth(camera, relative, np.concatenate([hidden, points[40:]]))
    near = known & (depth < 1.9 * project(camera, points)[1].max())
    np.testing.assert_allclose(found[near], depth[near], rtol=0.01)
    with pytest.raises(ValueError, match="12 are needed"):
        aligned_depth(camera, relative, points[:5])
    with pytest.raises(ValueError, match="near points are far"):
        aligned_depth(camera, -relative, points)


def test_depth_from_a_model(capture: Capture, tmp_path: Path) -> None:
    """The "model" reads inverse depth off the red channel, in a scale and with a shift of its own."""
    from onnx import TensorProto, helper, save

    shape: list[int | str | None] = [1, 3, "height", "width"]
    nodes = [
        helper.make_node("Gather", ["image", "first"], ["red"], axis=1),
        helper.make_node("Add", ["red", "shift"], ["depth"]),
    ]
    constants = [
        helper.make_tensor("first", TensorProto.INT64, [], [0]),
        helper.make_tensor("shift", TensorProto.FLOAT, [], [3.0]),
    ]
    put = helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)
    out = helper.make_tensor_value_info("depth", TensorProto.FLOAT, [1, "height", "width"])
    graph = helper.make_graph(nodes, "red", [put], [out], constants)
    save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), tmp_path / "m.onnx")
    assert capture.z_depths is not None
    known = capture.z_depths > 0
    inverse = np.where(known, 1.0 / np.where(known, capture.z_depths, 1.0), 0.0)
    painted = np.repeat((inverse / inverse.max()).astype(np.float32)[..., None], 3, axis=-1)
    found = with_depth(replace(capture, images=painted, z_depths=None), None, tmp_path / "m.onnx").z_depths
    assert found is not None
    both = known & (found > 0)
    assert both.mean() > 0.5
    assert np.median(np.abs(found[both] / capture.z_depths[both] - 1)) < 0.01
    bare = replace(capture, z_depths=None, points=capture.points[:5])
    with pytest.raises(UserError, match=r"depth of 00\.png cannot be aligned: .* 12 are needed"):
        with_depth(bare, None, tmp_path / "m.onnx")


def test_depth_from_gaussians(capture: Capture, tmp_path: Path) -> None:
    assert capture.z_depths is not None
    laid = gaussians_from_views(capture.cameras, capture.z_depths, np.zeros(capture.z_depths.shape, int), [], side=128)
    write_gaussians(tmp_path / "scene.ply", laid.gaussians)
    bare = replace(capture, z_depths=None)
    found = with_depth(bare, tmp_path / "scene.ply", None).z_depths
    assert found is not None
    both = (found > 0) & (capture.z_depths > 0)
    assert both.sum() > 0.95 * (capture.z_depths > 0).sum()
    pixel = (
        1.0 / capture.cameras[0].fx
    )  # over its distance; nearer discs lie over farther ones, so depth comes out near
    assert np.median(np.abs(found[both] / capture.z_depths[both] - 1)) < 2.0 * pixel
    away = replace(laid.gaussians, means=laid.gaussians.means + np.float32(100.0))
    write_gaussians(tmp_path / "away.ply", away)
    with pytest.raises(UserError, match="not of one world"):
        depth_of_gaussians(bare, tmp_path / "away.ply")


def test_misaligned_cameras_are_told(capture: Capture, edited: Any) -> None:
    check_alignment(capture)

    def swap(content: dict[str, Any]) -> None:
        a, b = content["frames"][0], content["frames"][1]
        a["transform_matrix"], b["transform_matrix"] = b["transform_matrix"], a["transform_matrix"]

    with pytest.raises(UserError, match="cameras and depth do not fit"):
        check_alignment(read_capture(edited(swap)))


def test_what_is_missing_is_told(edited: Any, tmp_path: Path) -> None:
    folder = edited(lambda content: content["frames"][1].update(file_path="images/nowhere.png"))
    with pytest.raises(UserError, match=r"1 of 3 pictures .* missing.*nowhere\.png"):
        read_capture(folder)
    folder = edited(lambda content: [frame.pop("depth_file_path") for frame in content["frames"]])
    with pytest.raises(UserError, match="--depth-model"):
        with_depth(read_capture(folder), None, None)
    folder = edited(lambda content: content["frames"][2].pop("depth_file_path"))
    with pytest.raises(UserError, match=r"02\.png has no depth"):
        read_capture(folder)
    folder = edited(lambda content: content["frames"][0].pop("transform_matrix"))
    with pytest.raises(UserError, match="has no 'transform_matrix'"):
        read_capture(folder)
    folder = edited(lambda content: [frame.update(w=48, h=64) for frame in content["frames"]])
    with pytest.raises(UserError, match="do not belong together"):
        read_capture(folder)
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="is no capture"):
        read_capture(tmp_path / "empty")
    with pytest.raises(UserError, match="does not exist"):
        read_capture(tmp_path / "nothing")


def corner_pictures(folder: Path, cameras: list[Camera]) -> None:
    """Three walls of a corner, painted with noise at several scales, ray traced in closed form."""
    rng = np.random.default_rng(7)
    walls = []
    for _ in range(3):
        layers = [np.kron(rng.random((n, n)), np.ones((512 // n, 512 // n))) for n in (16, 32, 64, 128)]
        walls.append(np.mean(layers, axis=0))
    folder.mkdir(parents=True)
    for number, camera in enumerate(cameras):
        wide = scaled_camera(camera, (2 * camera.height, 2 * camera.width))
        ways = unproject(wide, np.ones((wide.height, wide.width))) - camera.pose()[:3, 3]
        distance = -camera.pose()[:3, 3] / ways  # to the planes x = 0, y = 0, z = 0
        distance = np.where(distance > 0, distance, np.inf)
        axis = np.argmin(distance, axis=-1)
        at = camera.pose()[:3, 3] + distance.min(axis=-1)[..., None] * ways
        grey = np.zeros(axis.shape)
        for wall in range(3):
            u, v = np.moveaxis(np.clip(np.delete(at[axis == wall], wall, axis=-1) / 3.0 * 512, 0, 511), -1, 0)
            grey[axis == wall] = walls[wall][u.astype(int), v.astype(int)]
        small = grey.reshape(camera.height, 2, camera.width, 2).mean(axis=(1, 3))
        Image.fromarray(np.rint(np.stack([small] * 3, axis=-1) * 255).astype(np.uint8)).save(
            folder / f"{number:02d}.png"
        )


def test_poses_are_found_from_pictures_alone(tmp_path: Path) -> None:
    angles = np.linspace(0.45, 1.1, 7)
    eyes = [[2.6 * np.cos(a), 2.6 * np.sin(a), 1.4 + 0.3 * np.sin(5 * a)] for a in angles]
    cameras = [camera_from_fov(look_at(e, [0.5, 0.5, 0.4]), width=240, height=200, fov=0.8) for e in eyes]
    corner_pictures(tmp_path / "images", cameras)
    found = find_poses(tmp_path / "images")
    assert found.num_reg_images() == 7
    images = sorted(found.images.values(), key=lambda image: image.name)
    centres = np.stack([image.projection_center() for image in images])
    ways = np.stack([image.viewing_direction() for image in images])
    true = np.stack([camera.pose()[:3, 3] for camera in cameras])
    # Similarity alignment (Umeyama 1991).
    a, b = centres - centres.mean(axis=0), true - true.mean(axis=0)
    u, s, v = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    turn, scale = u @ sign @ v, (s * np.diag(sign)).sum() / (a**2).sum()
    errors = np.linalg.norm(scale * a @ turn.T - b, axis=1)
    assert errors.max() < 0.01 * np.linalg.norm(b, axis=1).max()
    cosine = np.sum((ways @ turn.T) * -np.stack([camera.pose()[:3, 2] for camera in cameras]), axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.5
    lens = next(iter(found.cameras.values()))
    assert lens.mean_focal_length() == pytest.approx(cameras[0].fx, rel=0.02)


def test_pictures_without_overlap_are_told(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for number in range(3):
        picture = np.kron(rng.integers(0, 255, (16, 16, 3), np.uint8), np.ones((6, 6, 1), np.uint8))
        Image.fromarray(picture).save(tmp_path / f"{number}.png")
    with pytest.raises(UserError, match="of 3 pictures could be placed"):
        find_poses(tmp_path)
