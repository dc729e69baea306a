"""Gaussians from depth: where they lie, how they are ordered, and that rendering them gives the views back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, project
from multilight.scenes.gaussians.curves import box_cells, fold, hilbert_index
from multilight.scenes.gaussians.from_views import Gaussians, SceneGaussians, gaussians_from_views, normals_from_depth
from multilight.scenes.gaussians.ply import C0, read_gaussians, write_gaussians
from multilight.scenes.spec import Camera

SIZE = 48
RADIUS = 0.5


def _camera(azimuth: float, height: float = 1.2) -> Camera:
    eye = (2.2 * np.cos(azimuth), 2.2 * np.sin(azimuth), height)
    return camera_from_fov(look_at(eye, (0.0, 0.0, 0.2)), width=SIZE, height=SIZE, fov=0.7)


def _trace(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ball (id 2) on a disc of floor (id 1), in closed form: z depth, ids, normals, colours by place."""
    pose = camera.pose()
    x = (np.arange(SIZE) + 0.5 - camera.cx) / camera.fx
    y = (camera.cy - np.arange(SIZE) - 0.5) / camera.fy
    rays = np.stack(np.broadcast_arrays(x[None], y[:, None], -1.0), axis=-1) @ pose[:3, :3].T
    eye, centre = pose[:3, 3], np.array([0.0, 0.0, RADIUS])
    a, b = (rays**2).sum(-1), rays @ (eye - centre)
    root = b**2 - a * (((eye - centre) ** 2).sum() - RADIUS**2)
    ball = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    floor = -eye[2] / rays[..., 2]
    floor = np.where(
        (floor > 0) & (np.linalg.norm((eye + floor[..., None] * rays)[..., :2], axis=-1) < 2), floor, np.inf
    )
    depth = np.minimum(ball, floor)
    hit = np.isfinite(depth)
    depth = np.where(hit, depth, 0.0)
    points = eye + depth[..., None] * rays
    ids = np.where(hit, np.where(ball < floor, 2, 1), 0)
    normals = np.where((ids == 2)[..., None], (points - centre) / RADIUS, [0.0, 0.0, 1.0]) * hit[..., None]
    colors = (0.5 + 0.4 * np.sin(4.0 * points)) * hit[..., None]
    return depth, ids, normals, colors


@pytest.fixture(scope="module")
def views() -> tuple[list[Camera], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    cameras = [_camera(azimuth) for azimuth in (0.0, 0.6, 1.2)]
    depths, ids, normals, colors = (np.stack(parts) for parts in zip(*map(_trace, cameras), strict=True))
    return cameras, depths, ids, normals, colors


@pytest.fixture(scope="module")
def scene(views: tuple) -> SceneGaussians:
    cameras, depths, ids, normals, _ = views
    return gaussians_from_views(cameras, depths, ids, [2], side=64, normals=normals)


def at_sources(scene: SceneGaussians, images: np.ndarray) -> np.ndarray:
    return images.reshape(len(images), -1, 3)[scene.sources[:, 0], scene.sources[:, 1]]


def coloured(scene: SceneGaussians, images: np.ndarray) -> Gaussians:
    return replace(scene.gaussians, colors=at_sources(scene, images).astype(np.float32))


def render(gaussians: Gaussians, camera: Camera, opacity: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Slow reference: EWA splatting (Zwicker et al. 2001), front to back; returns colours and what is left open."""
    pose = camera.pose()
    local = (gaussians.means - pose[:3, 3]) @ pose[:3, :3] * [1, -1, -1]
    z = local[:, 2]
    w, x, y, k = gaussians.quats.astype(np.float64).T
    rotations = np.array(
        [
            [1 - 2 * (y * y + k * k), 2 * (x * y - w * k), 2 * (x * k + w * y)],
            [2 * (x * y + w * k), 1 - 2 * (x * x + k * k), 2 * (y * k - w * x)],
            [2 * (x * k - w * y), 2 * (y * k + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    axes = (pose[:3, :3] * [1, -1, -1]).T @ rotations * gaussians.scales[:, None]
    jacobian = np.zeros((len(z), 2, 3))
    jacobian[:, 0, 0], jacobian[:, 0, 2] = camera.fx / z, -camera.fx * local[:, 0] / z**2
    jacobian[:, 1, 1], jacobian[:, 1, 2] = camera.fy / z, -camera.fy * local[:, 1] / z**2
    flat = jacobian @ axes
    inverse = np.linalg.inv(flat @ flat.transpose(0, 2, 1) + 0.3 * np.eye(2))
    centres = local[:, :2] / z[:, None] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    alphas = gaussians.opacities if opacity is None else np.full(len(z), opacity)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    image, left = np.zeros((camera.height, camera.width, 3)), np.ones((camera.height, camera.width))
    for i in np.argsort(z):
        offset = np.stack([columns - centres[i, 0], rows - centres[i, 1]], axis=-1)
        power = np.einsum("hwi,ij,hwj->hw", offset, inverse[i], offset)
        alpha = np.minimum(alphas[i] * np.exp(-0.5 * power), 0.99)
        image += (left * alpha)[..., None] * gaussians.colors[i]
        left *= 1.0 - alpha
    return image, left


def test_means_project_onto_their_source_pixels(scene: SceneGaussians, views: tuple) -> None:
    cameras, depths, ids, _, _ = views
    for number, camera in enumerate(cameras):
        here = scene.sources[:, 0] == number
        assert here.any()
        pixels, depth = project(camera, scene.gaussians.means[here])
        rows, columns = np.divmod(scene.sources[here, 1], SIZE)
        np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1) + 0.5, atol=1e-3)
        np.testing.assert_allclose(depth, depths[number, rows, columns], rtol=1e-5)
        np.testing.assert_array_equal(scene.objects[here], np.where(ids[number, rows, columns] == 2, 0, -1))


def test_order_is_the_curves_and_the_map_its_fold(scene: SceneGaussians) -> None:
    index = hilbert_index(box_cells(scene.gaussians.means, 10), 10)
    # Means are stored as float32, so a few fall into the next cell.
    assert (np.diff(index) < 0).mean() < 0.01
    np.testing.assert_array_equal(scene.cells, fold(64))
    values = np.arange(64 * 64)
    np.testing.assert_array_equal(scene.to_map(values)[scene.cells[:, 0], scene.cells[:, 1]], values)


def test_thinning_is_even_over_objects_and_views(scene: SceneGaussians, views: tuple) -> None:
    _, depths, ids, _, _ = views
    share = 64 * 64 / (depths > 0).sum()
    assert share < 1
    assert (scene.objects == 0).sum() == pytest.approx(share * (ids == 2).sum(), abs=2)
    for number in range(3):
        assert (scene.sources[:, 0] == number).sum() == pytest.approx(share * (depths[number] > 0).sum(), abs=4)
    assert len(np.unique(scene.sources, axis=0)) == 64 * 64


def test_discs_lie_on_the_surface(scene: SceneGaussians, views: tuple) -> None:
    g = scene.gaussians
    np.testing.assert_allclose(np.linalg.norm(g.quats, axis=1), 1.0, atol=1e-6)
    w, x, y, z = g.quats.astype(np.float64).T
    normal = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    true = at_sources(scene, views[3])
    assert np.abs(np.sum(normal * true, axis=-1)).min() > 0.999
    assert (g.scales[:, 2] < 0.2 * g.scales[:, :2].min(axis=1)).all()


def test_rendering_gives_the_views_back(scene: SceneGaussians, views: tuple) -> None:
    cameras, _, ids, _, colors = views
    picture, left = render(coloured(scene, colors), cameras[2])
    inside = _away_from_outlines(ids[2])
    assert (left[inside & (ids[2] > 0)] < 0.1).mean() > 0.99, "the surface has holes"
    assert (left[inside & (ids[2] == 0)] > 0.9).mean() > 0.99, "Gaussians stick out of the surface"
    assert _psnr(picture, colors[2], inside & (ids[2] > 0)) > 29.0


def test_rendering_an_unseen_view(scene: SceneGaussians, views: tuple) -> None:
    camera = _camera(0.9, height=1.3)
    _, ids, _, colors = _trace(camera)
    picture, left = render(coloured(scene, views[4]), camera)
    # What no view saw is open: behind the ball, and outside of all pictures.
    closed = _away_from_outlines(ids) & (ids > 0) & (left < 0.05)
    assert closed.sum() > 0.8 * (_away_from_outlines(ids) & (ids > 0)).sum()
    assert _psnr(picture, colors, closed) > 26.0


def test_normals_from_depth_meet_the_closed_form(views: tuple) -> None:
    cameras, depths, ids, normals, _ = views
    found = normals_from_depth(cameras[0], depths[0])
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-9)
    floor = (ids[0] == 1) & ~_beside(ids[0] != 1)
    np.testing.assert_allclose(found[floor], normals[0][floor], atol=1e-6)
    inside = (ids[0] == 2) & ~_beside(ids[0] != 2)
    assert np.degrees(np.arccos(np.clip(np.sum(found * normals[0], axis=-1)[inside], -1, 1))).max() < 12


def test_fewer_points_than_cells_repeat(views: tuple) -> None:
    cameras, depths, ids, _, _ = views
    scene = gaussians_from_views(cameras, depths, ids, [2], side=128)
    assert len(scene.gaussians) == 128 * 128 > (depths > 0).sum()
    assert len(np.unique(scene.sources, axis=0)) == (depths > 0).sum()
    assert all(np.isfinite(values).all() for values in vars(scene.gaussians).values())
    assert (scene.gaussians.scales > 0).all()


def test_same_input_same_gaussians(views: tuple) -> None:
    cameras, depths, ids, normals, _ = views
    one, two = (gaussians_from_views(cameras, depths, ids, [2], side=16, normals=normals) for _ in range(2))
    for name, values in vars(one.gaussians).items():
        assert values.dtype == np.float32, name
        np.testing.assert_array_equal(values, getattr(two.gaussians, name))


def test_what_cannot_be_is_refused(views: tuple) -> None:
    cameras, depths, ids, _, _ = views
    with pytest.raises(ValueError, match="nothing to put Gaussians on"):
        gaussians_from_views(cameras, np.zeros_like(depths), ids, [2], side=16)
    with pytest.raises(ValueError, match="2 cameras"):
        gaussians_from_views(cameras[:2], depths, ids, [2], side=16)
    with pytest.raises(ValueError, match="power of two"):
        gaussians_from_views(cameras, depths, ids, [2], side=20)


def test_ply_round_trip_and_layout(tmp_path: Path, scene: SceneGaussians, views: tuple) -> None:
    gaussians = coloured(scene, views[4])
    path = tmp_path / "scene.ply"
    write_gaussians(path, gaussians)
    back = read_gaussians(path)
    for name in ("means", "quats", "scales", "opacities", "colors"):
        np.testing.assert_allclose(getattr(back, name), getattr(gaussians, name), rtol=1e-5, atol=2e-6, err_msg=name)
    # An independent look: header lines by hand, values by their place.
    head, _, body = path.read_bytes().partition(b"end_header\n")
    names = [line.split()[2] for line in head.decode().splitlines() if line.startswith("property float ")]
    assert " ".join(names) == (
        "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
    )
    rows = np.frombuffer(body, "<f4").reshape(-1, 17)
    np.testing.assert_allclose(rows[:, 6:9] * C0 + 0.5, gaussians.colors, atol=1e-6)
    np.testing.assert_allclose(np.exp(rows[:, 10:13]), gaussians.scales, rtol=1e-5)


def test_ply_of_other_programs(tmp_path: Path, scene: SceneGaussians) -> None:
    """Other orders of the properties, harmonics of higher degree, doubles, big endian, unnormalised quaternions."""
    g = scene.gaussians
    fields = [f"rot_{i}" for i in range(4)] + ["f_rest_0", "opacity"] + [f"scale_{i}" for i in range(3)]
    fields += [f"f_dc_{i}" for i in range(3)] + ["x", "y", "z"]
    table = np.zeros(len(g), [(name, ">f8") for name in fields])
    for i in range(4):
        table[f"rot_{i}"] = 3.0 * g.quats[:, i]
    for i, axis in enumerate("xyz"):
        table[axis], table[f"scale_{i}"] = g.means[:, i], np.log(g.scales[:, i])
    head = ["ply", "format binary_big_endian 1.0", "comment by hand", f"element vertex {len(g)}"]
    head += [f"property double {name}" for name in fields] + ["end_header\n"]
    path = tmp_path / "other.ply"
    path.write_bytes("\n".join(head).encode() + table.tobytes())
    back = read_gaussians(path)
    np.testing.assert_allclose(back.quats, g.quats, atol=1e-6)
    np.testing.assert_allclose(back.means, g.means, atol=1e-6)
    assert back.opacities[0] == pytest.approx(0.5)
    assert back.colors[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda content: content[:-5], "truncated"),
        (lambda content: content.replace(b"opacity", b"opaqueX"), "no opacity"),
        (lambda content: content.replace(b"binary_little_endian", b"ascii"), "ascii"),
        (lambda content: b"solid " + content, "not a PLY"),
        (lambda content: content.replace(b"property float nx", b"property list uchar int nx"), "nx"),
    ],
)
def test_damaged_ply_is_named(tmp_path: Path, scene: SceneGaussians, damage: object, reason: str) -> None:
    path = tmp_path / "scene.ply"
    write_gaussians(path, scene.gaussians)
    path.write_bytes(damage(path.read_bytes()))  # type: ignore[operator]
    with pytest.raises(ValueError, match=reason) as caught:
        read_gaussians(path)
    assert str(path) in str(caught.value)


def _psnr(picture: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((picture - truth)[where] ** 2)))


def _away_from_outlines(ids: np.ndarray) -> np.ndarray:
    """Say which pixels have no other body within two pixels: at 48 pixels a disc is about one wide."""
    outlines = np.logical_or.reduce([_beside(ids == body) & (ids != body) for body in (0, 1, 2)])
    return ~_beside(outlines)


def _beside(mask: np.ndarray) -> np.ndarray:
    """Grow a mask by one pixel."""
    padded = np.pad(mask, 1)
    shifts = [
        padded[1 + i : 1 + i + mask.shape[0], 1 + j : 1 + j + mask.shape[1]] for i in (-1, 0, 1) for j in (-1, 0, 1)
    ]
    return np.logical_or.reduce(shifts)
