"""Objects put into captures: planes, occlusion, harmonizing, Gaussians and video, held against closed forms."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from multilight.datagen.cli import main
from multilight.datagen.errors import UserError
from multilight.datagen.report import silent
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.model.captures.assets import load_asset
from multilight.model.captures.capture import Capture
from multilight.model.captures.confidence import repaired
from multilight.model.captures.insert import harmonize_capture, insert_object
from multilight.model.captures.objects import AMBIENT, FROM_CAMERA, PlacedObject
from multilight.model.captures.orbit import GAP, orbit_cameras
from multilight.model.captures.placing import placed, upright
from multilight.model.captures.planes import find_plane, free_place, scene_centre, scene_up
from multilight.model.captures.request import Wish
from multilight.model.cli import COMMANDS
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.configs.stage3d import SLIM3D
from multilight.model.inference.depth import depth_from_metres
from multilight.model.inference.harmonize import harmonize
from multilight.model.inference.pictures import read_picture
from multilight.model.networks.checkpoint import save_network
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import Compositing3D
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, project, unproject
from multilight.scenes.gaussians.ply import read_gaussians
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Camera, Rectangle, Sphere
from tests.datagen.test_video import decoded

pytest.importorskip("pycolmap")

SMALL = {"body": "attention", "width": 16, "groups": 1, "blocks": 2, "heads": 2, "window": 4, "pooled": 2}
NETWORK = NetworkConfig(head="gain", **SMALL)


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball of radius 0.5, of one plain grey."""
    path = tmp_path_factory.mktemp("asset") / "ball.glb"
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    mesh.visual = TextureVisuals(material=PBRMaterial(baseColorFactor=[128, 128, 128, 255]))
    mesh.export(path)
    return path


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


def random_network() -> Compositing2D:
    torch.manual_seed(0)
    made = Compositing2D(NETWORK)
    torch.nn.init.normal_(made.head.weight, std=0.05)
    torch.nn.init.normal_(made.head.get_parameter("bias"), std=0.1)
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
    result = harmonize_capture(capture, inserted, random_network(), side=64, report=silent)
    assert inserted.coverage.max(axis=(1, 2)).min() == 1.0, "every view sees it"
    inside = inserted.coverage == 1.0
    before, after = (disagreement(capture, inserted.z_depths, v, inside) for v in (result.single, result.views))
    assert np.abs(result.single - inserted.composites).max() > 0.05
    assert after < 0.7 * before
    assert len(result.gaussians) == 64 * 64
    assert np.isfinite(result.views).all()


def test_all_views_have_one_set_of_lights(capture: Capture, ball: Path) -> None:
    """A network that guesses lights, other ones in every view: under one set the views of a matt ball agree."""
    asset = load_asset(str(ball))
    inserted = insert_object(capture, PlacedObject(asset, placed(capture, asset, Wish())))
    torch.manual_seed(0)
    network = Compositing2D(NetworkConfig(head="light", **SMALL)).eval()
    torch.nn.init.normal_(network.light.last.weight, std=0.5)
    result = harmonize_capture(capture, inserted, network, side=64, report=silent)
    assert result.views is result.single
    alone = np.stack(
        [
            harmonize(network, composite, background, depth_from_metres(depth), mask=mask)
            for composite, background, depth, mask in zip(
                inserted.composites, capture.images, inserted.z_depths, inserted.coverage, strict=True
            )
        ]
    )
    inside = inserted.coverage == 1.0
    apart, alike = (disagreement(capture, inserted.z_depths, views, inside) for views in (alone, result.views))
    assert alike < 0.7 * apart
    assert len(result.gaussians) == 64 * 64


def test_an_untrained_network_changes_nothing(capture: Capture, ball: Path) -> None:
    asset = load_asset(str(ball))
    inserted = insert_object(capture, PlacedObject(asset, placed(capture, asset, Wish())))
    network = Compositing2D(NETWORK).eval()
    result = harmonize_capture(capture, inserted, network, side=64, report=silent)
    np.testing.assert_allclose(result.single, inserted.composites, atol=1e-5)
    changed = np.abs(result.views - inserted.composites).max(axis=-1)
    assert (changed < 1e-3).mean() > 0.85
    far = inserted.coverage.max(axis=0) == 0
    assert np.median(changed[:, far]) < 1e-5


def test_pixels_of_low_confidence_change_as_those_around_them() -> None:
    single = np.full((1, 20, 20, 3), 0.5, np.float32)
    views, coverage = single.copy(), np.zeros((1, 20, 20), np.float32)
    coverage[:, :, 10:] = 1.0
    views[:, :, 10:] = 0.6
    wrong = views.copy()
    wrong[:, 5, 11] = 0.05  # a hole in the object, beside its outline
    confidence = np.ones((1, 20, 20), np.float32)
    confidence[:, 5, 11] = 0.0
    np.testing.assert_allclose(repaired(single, wrong, confidence, coverage), views, atol=1e-5)


def test_out_of_view_and_hidden_are_told(capture: Capture, ball: Path) -> None:
    asset, up = load_asset(str(ball)), np.array([0.0, 0.0, 1.0])
    with pytest.raises(UserError, match="out of all 3 pictures"):
        insert_object(capture, PlacedObject(asset, upright(np.array([0.0, 0.0, 80.0]), up, 0.0, 0.1)))
    below = scene_centre(capture) + 0.5 * (scene_centre(capture) - capture.eyes[0])
    with pytest.raises(UserError, match="hides it in all"):
        insert_object(capture, PlacedObject(asset, upright(below, up, 0.0, 0.1)))


@pytest.mark.parametrize("kind", ["nerfstudio", "colmap"])
def test_command_writes_pictures_gaussians_and_video(
    kind: str, capture_folders: dict[str, Path], ball: Path, tmp_path: Path
) -> None:
    save_network(tmp_path / "w2.safetensors", random_network(), NETWORK, {})
    save_network(tmp_path / "w3.safetensors", Compositing3D(SLIM3D), SLIM3D, {})
    words = ["insert", str(capture_folders[kind]), "--asset", str(ball), "--out", str(tmp_path / "out"), "--side", "32"]
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
    capture_folders: dict[str, Path], ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_network(tmp_path / "w.safetensors", random_network(), NETWORK, {})
    words = [
        "insert",
        str(capture_folders["nerfstudio"]),
        "--weights",
        str(tmp_path / "w.safetensors"),
        "--frames",
        "0",
    ]
    words += ["--out", str(tmp_path / "out")]
    bad = tmp_path / "bad.glb"
    bad.write_bytes(b"no model")
    for more, said in (
        (["--asset", str(tmp_path / "none.glb")], "none.glb does not exist"),
        (["--asset", str(bad)], "bad.glb cannot be read: it is damaged, or not what its name says"),
        (["--asset", str(ball), "--side", "33"], "--side 33 must be a power of two"),
        (["--asset", str(ball), "--scale", "-1"], "--scale -1.0 must be above 0"),
        (["--asset", str(ball), "--pose", str(tmp_path / "none.json")], "none.json does not exist"),
        (["--asset", str(ball), "--every", "0"], "--every 0"),
    ):
        assert main([*words, *more], COMMANDS) == 1
        assert said in capsys.readouterr().err
