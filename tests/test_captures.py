"""Captures of many views: readers, planes, occlusion, poses, Gaussians and video, held against closed forms."""

import json
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from datagen.cli import main
from datagen.errors import UserError
from datagen.source import open_dataset
from model.captures.assets import load_asset
from model.captures.capture import Capture, check_alignment, scaled_camera
from model.captures.colmap import find_poses
from model.captures.depths import aligned_depth, depth_of_gaussians, with_depth
from model.captures.insert import harmonize_capture, insert_object
from model.captures.lenses import Lens, undistorted
from model.captures.objects import AMBIENT, FROM_CAMERA, PlacedObject
from model.captures.placing import Wish, placed, upright
from model.captures.planes import find_plane, free_place, scene_centre, scene_up
from model.captures.read import read_capture
from model.captures.trust import repaired
from model.captures.video import GAP, orbit_cameras, write_video
from model.checkpoint import save_network
from model.cli import COMMANDS
from model.compositing2d import Compositing2D
from model.compositing3d import Compositing3D
from model.config import NetworkConfig
from model.config3d import SLIM3D
from model.pictures import read_picture
from scenes.cameras import camera_from_fov, look_at, matrix4, project, unproject
from scenes.gaussian_ply import read_gaussians, write_gaussians
from scenes.gaussians import gaussians_from_views
from scenes.spec import Camera, Rectangle, Sphere

pytest.importorskip("pycolmap")

SMALL = {"width": 16, "groups": 1, "blocks": 2, "heads": 2, "window": 4, "pooled": 2}
NETWORK = NetworkConfig(head="gain", **SMALL)


@pytest.fixture(scope="module")
def folders(spheres_dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    found = {}
    for kind in ("nerfstudio", "colmap"):
        out = tmp_path_factory.mktemp(kind)
        words = ["export", kind, str(spheres_dataset), "--out", str(out), "--conditions", "1", "--points", "500"]
        assert main([*words, "--where", "index = 0"]) == 0
        found[kind] = next((out / "scene_000000").iterdir())
    return found


@pytest.fixture(scope="module")
def capture(folders: dict[str, Path]) -> Capture:
    return read_capture(folders["nerfstudio"])


@pytest.fixture
def edited(folders: dict[str, Path], tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], None]], Path]:
    """A copy of the nerfstudio capture with its transforms.json changed."""

    def edit(change: Callable[[dict[str, Any]], None]) -> Path:
        copy = tmp_path / "capture"
        for file in (f for f in folders["nerfstudio"].rglob("*") if f.is_file()):
            to = copy / file.relative_to(folders["nerfstudio"])
            to.parent.mkdir(parents=True, exist_ok=True)
            to.write_bytes(file.read_bytes())
        content = json.loads((copy / "transforms.json").read_text())
        change(content)
        (copy / "transforms.json").write_text(json.dumps(content))
        return copy

    return edit


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of radius 0.5, of one plain grey."""
    path = tmp_path_factory.mktemp("asset") / "ball.glb"
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    mesh.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[128, 128, 128, 255]))
    mesh.export(path)
    return path


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_readers_give_the_scene_back(kind: str, folders: dict[str, Path], spheres_dataset: Path) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    found = read_capture(folders[kind])
    assert found.z_depths is not None
    for number, (camera, true) in enumerate(zip(found.cameras, record.scene.cameras, strict=True)):
        np.testing.assert_allclose(camera.pose(), true.pose(), atol=1e-9)
        np.testing.assert_allclose(camera.intrinsics(), true.intrinsics(), atol=1e-9)
        depth = source.view(record, number).geometry.z_depth
        np.testing.assert_allclose(found.z_depths[number], np.where(depth < 65.5, depth, 0), atol=0.00051)
        image = np.asarray(Image.open(folders[kind] / "images" / f"{number:02d}.png"))
        np.testing.assert_array_equal(np.rint(found.images[number] * 255), image)
    assert len(found.points) == 500
    if kind == "colmap":
        assert found.seen is not None
        for camera, seen in zip(found.cameras, found.seen, strict=True):
            pixels, _ = project(camera, found.points[seen])
            assert ((pixels > -1e-6) & (pixels < [camera.width + 1e-6, camera.height + 1e-6])).all()


def test_smaller_pictures_keep_their_rays(folders: dict[str, Path], capture: Capture) -> None:
    small = read_capture(folders["nerfstudio"], max_side=32, every=2)
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


def turned(capture: Capture, turn: Rotation, scale: float) -> Capture:
    """The same capture in a frame and a unit of its own, as COLMAP's are."""
    cameras = []
    for camera in capture.cameras:
        pose = camera.pose()
        pose[:3, :3] = turn.as_matrix() @ pose[:3, :3]
        pose[:3, 3] = scale * turn.apply(pose[:3, 3])
        cameras.append(camera.model_copy(update={"c2w": matrix4(pose)}))
    assert capture.z_depths is not None
    return replace(capture, cameras=tuple(cameras), z_depths=capture.z_depths * np.float32(scale))


def ground(spheres_dataset: Path) -> float:
    bodies = open_dataset(spheres_dataset).scene(0).scene.bodies
    return next(b.world_from_body[2][3] for b in bodies if isinstance(b.geometry, Rectangle))


@pytest.mark.parametrize(("angles", "scale"), [((0, 0, 0), 1.0), ((140, -60, 35), 0.3)])
def test_plane_is_found_in_any_frame(
    angles: tuple[float, float, float], scale: float, capture: Capture, spheres_dataset: Path
) -> None:
    turn = Rotation.from_euler("xyz", angles, degrees=True)
    moved = turned(capture, turn, scale)
    up = turn.apply([0.0, 0.0, 1.0])
    assert np.degrees(np.arccos(min(1.0, scene_up(moved) @ up))) < 3.0
    plane = find_plane(moved, np.random.default_rng(0))
    assert np.degrees(np.arccos(min(1.0, plane.normal @ up))) < 0.2
    assert plane.offset == pytest.approx(scale * ground(spheres_dataset), abs=0.002 * scale)


def test_object_stands_where_there_is_room(capture: Capture, spheres_dataset: Path) -> None:
    plane = find_plane(capture, np.random.default_rng(0))
    place, free = free_place(capture, plane, 0.08, 0.2)
    assert free
    assert plane.height(place) == pytest.approx(0.0, abs=1e-9)
    for body in open_dataset(spheres_dataset).scene(0).scene.bodies:
        if isinstance(body.geometry, Sphere):
            pose = np.array(body.world_from_body)
            radius = body.geometry.radius * np.linalg.norm(pose[:3, 0])
            # What no view sees of a ball, its back and its underside, keeps nobody away: hence half of its radius.
            assert np.linalg.norm(place[:2] - pose[:2, 3]) > 0.08 + 0.5 * radius - 0.02


def test_no_plane_is_told(capture: Capture) -> None:
    rng = np.random.default_rng(1)
    cloud = rng.normal(size=(4000, 3)) * 0.2 + scene_centre(capture)
    with pytest.raises(UserError, match="no plane that faces up"):
        find_plane(replace(capture, z_depths=None, points=cloud), rng)
    wall = cloud.copy()
    wall[:, 0] = 0.0  # upright
    with pytest.raises(UserError, match="no plane that faces up"):
        find_plane(replace(capture, z_depths=None, points=wall), rng)


def facing_camera(distance: float) -> Camera:
    return camera_from_fov(look_at([0, -distance, 0.5], [0, 0, 0.5]), width=96, height=80, fov=0.6)


def test_a_ball_is_seen_as_a_disc_and_hidden_by_what_is_nearer(ball: Path) -> None:
    camera = facing_camera(4.0)
    placed_ball = PlacedObject(load_asset(str(ball)), np.eye(4))  # stands on z = 0, so its centre is at 0.5
    depth = np.full((80, 96), 9.0, np.float32)
    seen = placed_ball.seen(camera, depth)
    radius = camera.fx * 0.5 / np.sqrt(4.0**2 - 0.5**2)
    assert seen.coverage.sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    assert seen.z_depth[40, 48] == pytest.approx(3.5, abs=0.002)
    assert seen.radiance[40, 48] == pytest.approx(0.2158605 * (AMBIENT + FROM_CAMERA), rel=0.02) or seen.radiance[
        40, 48
    ] == pytest.approx(128 / 255 * (AMBIENT + FROM_CAMERA), rel=0.02)
    depth[:, :48] = 3.0  # something stands before the left half
    half = placed_ball.seen(camera, depth)
    assert half.coverage[:, :48].max() == 0
    np.testing.assert_array_equal(half.coverage[:, 48:], seen.coverage[:, 48:])
    np.testing.assert_array_equal(half.z_depth[:, 48:], seen.z_depth[:, 48:])
    depth[:, :48] = 0.0  # unknown hides nothing
    np.testing.assert_array_equal(placed_ball.seen(camera, depth).coverage, seen.coverage)
    background = np.full((80, 96, 3), 0.25, np.float32)
    over = half.over(background)
    np.testing.assert_allclose(over[:, :48], 0.25, atol=1e-6)
    assert over[40, 60, 0] == pytest.approx(1.055 * seen.radiance[40, 60, 0] ** (1 / 2.4) - 0.055, abs=1e-5)


def test_ball_cut_by_a_plane_in_depth(ball: Path) -> None:
    """A wall through the ball's centre hides what is behind it: of the near half everything is seen, and no more."""
    camera = facing_camera(4.0)
    seen = PlacedObject(load_asset(str(ball)), np.eye(4)).seen(camera, np.full((80, 96), 3.7, np.float32))
    limit = 3.7 * 1.01  # z = 4 - sqrt(0.5² - rho²) up to there, rho the distance from the axis
    rho = np.sqrt(0.5**2 - (4.0 - limit) ** 2)
    assert seen.coverage.sum() == pytest.approx(np.pi * (camera.fx * rho / limit) ** 2, rel=0.02)
    assert seen.z_depth.max() <= limit


def test_textures_lie_as_painted(tmp_path: Path) -> None:
    """An upright picture of four colours: glTF's uv origin is at the top left, ours at the bottom left."""
    colours = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    corners = [[-0.5, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [-0.5, 1, 0]]  # Y-up, faces +Z, which becomes -Y
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    material = PBRMaterial(baseColorTexture=Image.fromarray(colours), baseColorFactor=[255, 255, 255, 255])
    mesh.visual = TextureVisuals(uv=[[0, 0], [1, 0], [1, 1], [0, 1]], material=material)
    mesh.export(tmp_path / "sign.glb")
    camera = facing_camera(4.0)
    seen = PlacedObject(load_asset(str(tmp_path / "sign.glb")), np.eye(4)).seen(camera, np.zeros((80, 96), np.float32))
    places = {(0, 0): (-0.25, 0.75), (0, 1): (0.25, 0.75), (1, 0): (-0.25, 0.25), (1, 1): (0.25, 0.25)}
    for (row, column), (x, z) in places.items():
        at = np.floor(project(camera, np.array([[x, 0.0, z]]))[0][0]).astype(int)
        shown = seen.radiance[at[1], at[0]] / (AMBIENT + FROM_CAMERA)
        np.testing.assert_allclose(shown, colours[row, column] / 255.0, atol=0.02)


def test_poses_from_files(capture: Capture, ball: Path, tmp_path: Path) -> None:
    asset, path = load_asset(str(ball)), tmp_path / "pose.json"
    pose = upright(np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 1.0]), 90.0, 2.0)
    np.testing.assert_allclose(pose @ [1, 0, 0, 1], [1, 4, 3, 1], atol=1e-12)
    path.write_text(json.dumps({"position": [1, 2, 3], "yaw": 90, "scale": 2, "up": [0, 0, 5]}))
    np.testing.assert_allclose(placed(capture, asset, Wish(path)), pose, atol=1e-12)
    for text in (json.dumps(pose.tolist()), json.dumps({"matrix": pose.tolist()}), " ".join(map(str, pose.ravel()))):
        path.write_text(text)
        np.testing.assert_allclose(placed(capture, asset, Wish(path)), pose, atol=1e-12)
    pose[:3, 0] *= 2.0
    for text in (json.dumps(pose.tolist()), "[[1, 2], [3, 4]]", "here", "{}"):
        path.write_text(text)
        with pytest.raises(UserError, match=r"pose\.json"):
            placed(capture, asset, Wish(path))


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

    shape = [1, 3, "height", "width"]
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


def test_orbit_keeps_its_distance_and_stays_where_cameras_were() -> None:
    centre, up = np.array([0.3, -0.2, 1.0]), np.array([0.0, 0.0, 1.0])

    def ring(angles: np.ndarray) -> tuple[Camera, ...]:
        eyes = [centre + [2 * np.cos(a), 2 * np.sin(a), 1.0] for a in angles]
        return tuple(camera_from_fov(look_at(eye, centre), width=65, height=49, fov=0.7) for eye in eyes)

    for angles, whole in ((np.arange(8) * np.pi / 4, True), (np.linspace(0.2, 1.2, 5), False)):
        orbit = orbit_cameras(ring(angles), centre, up, 36)
        offsets = np.stack([c.pose()[:3, 3] for c in orbit]) - centre
        np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), np.sqrt(5.0))
        for camera in orbit:
            assert (camera.width, camera.height) == (64, 48)
            forward = -camera.pose()[:3, 2]
            np.testing.assert_allclose(forward, (centre - camera.pose()[:3, 3]) / np.sqrt(5.0), atol=1e-9)
        seen = np.sort(np.mod(np.arctan2(offsets[:, 1], offsets[:, 0]), 2 * np.pi))
        if whole:
            assert np.diff(seen).max() < 2 * np.pi / 35
        else:
            assert seen.min() > 0.2 - 1e-6
            assert seen.max() < 1.2 + 1e-6
            assert 2 * np.pi - np.ptp(seen) > GAP


def decoded(path: Path, size: tuple[int, int]) -> tuple[str, np.ndarray]:
    """Decode a video: what ffmpeg says of it, and its frames (N, H, W, 3) in [0, 1]."""
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(command, capture_output=True, check=True)
    return done.stderr.decode(), np.frombuffer(done.stdout, np.uint8).reshape(-1, size[1], size[0], 3) / 255.0


def test_video_can_be_read_back(tmp_path: Path) -> None:
    colours = np.linspace(0.1, 0.9, 12)[:, None] * [1.0, 0.5, 0.2]
    frames = (np.broadcast_to(colour, (48, 64, 3)).astype(np.float32) for colour in colours)
    write_video(tmp_path / "v.mp4", frames, (64, 48))
    told, read = decoded(tmp_path / "v.mp4", (64, 48))
    assert "64x48" in told
    assert "24 fps" in told
    assert len(read) == 12
    np.testing.assert_allclose(read.mean(axis=(1, 2)), colours, atol=0.04)
    with pytest.raises(UserError, match="cannot be written"):
        write_video(tmp_path / "no" / "v.mp4", iter([np.zeros((48, 64, 3), np.float32)]), (64, 48))


def random_network() -> Compositing2D:
    torch.manual_seed(0)
    made = Compositing2D(NETWORK)
    torch.nn.init.normal_(made.head.weight, std=0.05)
    torch.nn.init.normal_(made.head.bias, std=0.1)
    return made.eval()


def disagreement(capture: Capture, z_depths: np.ndarray, images: np.ndarray, object_: np.ndarray) -> float:
    """Mean difference of colour where a view's object pixels come to lie in the next view, unhidden."""
    differences = []
    for a in range(len(images)):
        b = (a + 1) % len(images)
        at, z = project(capture.cameras[b], unproject(capture.cameras[a], z_depths[a])[object_[a]])
        inside = (z > 0) & ((at > 0) & (at < [capture.images.shape[2], capture.images.shape[1]])).all(axis=1)
        x, y = np.where(inside[:, None], at, 0).astype(int).T
        same = inside & (np.abs(z_depths[b][y, x] / np.where(z > 0, z, 1) - 1) < 0.01) & object_[b][y, x]
        differences.append(np.abs(images[a][object_[a]] - images[b][y, x])[same])
    return float(np.concatenate(differences).mean())


def test_all_views_are_harmonized_alike(capture: Capture, ball: Path) -> None:
    """A network that says something else in every view: afterwards the views agree, and far pixels are untouched."""
    asset = load_asset(str(ball))
    inserted = insert_object(capture, PlacedObject(asset, placed(capture, asset, Wish())))
    result = harmonize_capture(capture, inserted, random_network(), side=64, report=lambda done, count: None)
    assert inserted.coverage.max(axis=(1, 2)).min() == 1.0, "every view sees it"
    inside = inserted.coverage == 1.0
    before, after = (disagreement(capture, inserted.z_depths, v, inside) for v in (result.single, result.views))
    assert np.abs(result.single - inserted.composites).max() > 0.05
    assert after < 0.7 * before
    assert len(result.gaussians) == 64 * 64
    assert np.isfinite(result.views).all()


def test_an_untrained_network_changes_nothing(capture: Capture, ball: Path) -> None:
    asset = load_asset(str(ball))
    inserted = insert_object(capture, PlacedObject(asset, placed(capture, asset, Wish())))
    network = Compositing2D(NETWORK).eval()
    result = harmonize_capture(capture, inserted, network, side=64, report=lambda done, count: None)
    np.testing.assert_allclose(result.single, inserted.composites, atol=1e-5)
    changed = np.abs(result.views - inserted.composites).max(axis=-1)
    assert (changed < 1e-3).mean() > 0.85
    far = inserted.coverage.max(axis=0) == 0
    assert np.median(changed[:, far]) < 1e-5


def test_distrusted_pixels_change_as_those_around_them() -> None:
    single = np.full((1, 20, 20, 3), 0.5, np.float32)
    views, coverage = single.copy(), np.zeros((1, 20, 20), np.float32)
    coverage[:, :, 10:] = 1.0
    views[:, :, 10:] = 0.6
    wrong = views.copy()
    wrong[:, 5, 11] = 0.05  # a hole in the object, beside its outline
    trusted = np.ones((1, 20, 20), np.float32)
    trusted[:, 5, 11] = 0.0
    np.testing.assert_allclose(repaired(single, wrong, trusted, coverage), views, atol=1e-5)


def test_out_of_view_and_hidden_are_told(capture: Capture, ball: Path) -> None:
    asset, up = load_asset(str(ball)), np.array([0.0, 0.0, 1.0])
    with pytest.raises(UserError, match="out of all 3 pictures"):
        insert_object(capture, PlacedObject(asset, upright(np.array([0.0, 0.0, 80.0]), up, 0.0, 0.1)))
    below = scene_centre(capture) + 0.5 * (scene_centre(capture) - capture.eyes[0])
    with pytest.raises(UserError, match="hides it in all"):
        insert_object(capture, PlacedObject(asset, upright(below, up, 0.0, 0.1)))


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_command_writes_pictures_gaussians_and_video(
    kind: str, folders: dict[str, Path], ball: Path, tmp_path: Path
) -> None:
    save_network(tmp_path / "w2.safetensors", random_network(), NETWORK, {})
    save_network(tmp_path / "w3.safetensors", Compositing3D(SLIM3D), SLIM3D, {})
    words = ["insert", str(folders[kind]), "--asset", str(ball), "--out", str(tmp_path / "out"), "--side", "32"]
    words += ["--frames", "5", "--weights", str(tmp_path / "w2.safetensors")]
    assert main([*words, "--weights-3d", str(tmp_path / "w3.safetensors"), "--traceback"], COMMANDS) == 0
    out = tmp_path / "out"
    for name in ("composites", "single", "harmonized", "masks"):
        assert sorted(p.name for p in (out / name).iterdir()) == ["00.png", "01.png", "02.png"]
        assert read_picture(out / name / "00.png").shape == (48, 64, 3)
    gaussians = read_gaussians(out / "scene.ply")
    assert len(gaussians) == 32 * 32
    independent = trimesh.load(out / "scene.ply")
    np.testing.assert_allclose(np.asarray(independent.vertices), gaussians.means, atol=1e-5)
    assert len(decoded(out / "orbit.mp4", (64, 48))[1]) == 5
    pose = np.array(json.loads((out / "placement.json").read_text())["world_from_asset"])
    assert pose.shape == (4, 4)
    assert main([*words, "--weights-3d", str(tmp_path / "w2.safetensors")], COMMANDS) == 1


def test_command_says_what_is_wrong(
    folders: dict[str, Path], ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_network(tmp_path / "w.safetensors", random_network(), NETWORK, {})
    words = ["insert", str(folders["nerfstudio"]), "--weights", str(tmp_path / "w.safetensors"), "--frames", "0"]
    words += ["--out", str(tmp_path / "out")]
    bad = tmp_path / "bad.glb"
    bad.write_bytes(b"no model")
    for more, said in (
        (["--asset", str(tmp_path / "none.glb")], "none.glb does not exist"),
        (["--asset", str(bad)], "bad.glb cannot be read"),
        (["--asset", str(ball), "--side", "33"], "--side must be a power of two"),
        (["--asset", str(ball), "--scale", "-1"], "--scale -1.0 must be above 0"),
        (["--asset", str(ball), "--pose", str(tmp_path / "none.json")], "none.json cannot be read"),
        (["--asset", str(ball), "--every", "0"], "--every 0"),
    ):
        assert main([*words, *more], COMMANDS) == 1
        assert said in capsys.readouterr().err


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
