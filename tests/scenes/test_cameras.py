"""Cameras: inverses, conventions, rays, and depth carried from view to view."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.lights.spec import EmissiveLight, EnvironmentLight, LightRig
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, Framing, TrajectoryShares, camera_on, draw_path
from multilight.scenes.cameras.pinhole import (
    camera_from_fov,
    camera_from_lens,
    circle_of_confusion,
    focal_length_mm,
    look_at,
    opencv_from_opengl,
    pixel_rays,
    project,
    ray_distance_from_z_depth,
    reprojection_error,
    unproject,
    with_depth_of_field,
)
from multilight.scenes.cameras.trajectory import SEEN, in_frame
from multilight.scenes.geometry.rays import SceneRays, body_triangles, surface_points
from multilight.scenes.kinds.spheres import sample_spheres
from multilight.scenes.kinds.tabletop import sample_tabletop
from multilight.scenes.poses import matrix4
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Camera, Material, SceneSpec, Sphere
from multilight.scenes.still_life.sample import StillLifeSettings

Depths = tuple[list[np.ndarray], tuple[Camera, ...]]
StillLifes = tuple[str, list[SceneSpec]]

coordinate = st.floats(-5, 5)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    eye = np.array([draw(coordinate), draw(coordinate), draw(coordinate)])
    azimuth, elevation = draw(st.floats(-3.1, 3.1)), draw(st.floats(-1.4, 1.4))
    ahead = [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    camera = camera_from_fov(
        look_at(eye, eye + ahead),
        width=draw(st.integers(1, 12)),
        height=draw(st.integers(1, 12)),
        fov=draw(st.floats(0.2, 2.0)),
    )
    return camera.model_copy(update={"fy": camera.fy * 1.1, "cx": camera.cx + 0.7, "cy": camera.cy - 0.3})


@given(camera=cameras(), seed=st.integers(0, 99))
def test_project_undoes_unproject(camera: Camera, seed: int) -> None:
    depth = np.random.default_rng(seed).uniform(0.1, 20, (camera.height, camera.width))
    pixels, z_depth = project(camera, unproject(camera, depth).reshape(-1, 3))
    np.testing.assert_allclose(z_depth, depth.ravel(), rtol=1e-9)
    centres = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1) + 0.5
    np.testing.assert_allclose(pixels, centres.reshape(-1, 2), atol=1e-7)


@given(camera=cameras())
def test_rays_meet_unprojected_points_at_the_ray_distance(camera: Camera) -> None:
    depth = np.full((camera.height, camera.width), 3.0)
    origins, directions = pixel_rays(camera)
    distance = ray_distance_from_z_depth(camera, depth)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(origins + distance[..., None] * directions, unproject(camera, depth), atol=1e-9)
    assert (distance >= depth - 1e-12).all()


@given(camera=cameras())
def test_poses_are_rigid_and_opencv_conversion_is_its_own_inverse(camera: Camera) -> None:
    pose = camera.pose()
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    np.testing.assert_array_equal(opencv_from_opengl(opencv_from_opengl(pose)), pose)


@given(camera=cameras(), point=st.tuples(coordinate, coordinate, coordinate))
def test_projection_equals_k_times_the_opencv_pose(camera: Camera, point: tuple[float, float, float]) -> None:
    pixels, z_depth = project(camera, [point])
    x = np.linalg.inv(opencv_from_opengl(camera.pose())) @ [*point, 1.0]
    assert z_depth[0] == pytest.approx(x[2], abs=1e-9)
    if x[2] > 1e-3:
        u = camera.intrinsics() @ x[:3]
        np.testing.assert_allclose(pixels[0], u[:2] / u[2], rtol=1e-7, atol=1e-6)
    elif x[2] < -1e-9:
        assert np.isnan(pixels).all()


def test_axes_of_a_known_camera() -> None:
    camera = camera_from_fov(look_at((0, -2, 0), (0, 0, 0)), width=4, height=2, fov=math.pi / 2)
    assert (camera.fx, camera.fy) == pytest.approx((2.0, 2.0))
    # One metre to the right is +X in the world, and to the right in the picture; up is up.
    pixels, z_depth = project(camera, [(1, 0, 0), (0, 0, 1), (0, 0, 0)])
    np.testing.assert_allclose(pixels, [(3, 1), (2, 0), (2, 1)], atol=1e-12)
    np.testing.assert_allclose(z_depth, 2.0)


def test_field_of_view_spans_the_longer_side() -> None:
    pose = look_at((0, -1, 0), (0, 0, 0))
    wide = camera_from_fov(pose, width=300, height=100, fov=1.0)
    tall = camera_from_fov(pose, width=100, height=300, fov=1.0)
    assert wide.fx == tall.fx == pytest.approx(150 / math.tan(0.5))
    # 50 mm before a 36 mm sensor is 39.6 degrees.
    lens = camera_from_lens(pose, width=256, height=256, focal_length_mm=50)
    assert math.degrees(2 * math.atan(128 / lens.fx)) == pytest.approx(39.5978, abs=1e-4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: look_at((1, 1, 1), (1, 1, 1)), "must differ"),
        (lambda: look_at((0, 0, 1), (0, 0, 0)), "along up"),
        (lambda: camera_from_fov(np.eye(4), width=4, height=4, fov=4.0), r"4.0 rad is outside \(0, pi\)"),
        (lambda: camera_from_lens(np.eye(4), width=4, height=4, focal_length_mm=0), "must be above 0"),
        (lambda: camera_from_fov(np.eye(3), width=4, height=4, fov=1.0), "4x4"),
    ],
)
def test_impossible_cameras_are_refused(call: Callable[[], object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        call()


@pytest.fixture(scope="module")
def depths() -> Depths:
    scene = sample_spheres(Streams(3, 0), index=0, width=96, height=96, views=6)
    rig = LightRig(lights=(EnvironmentLight(name="sky"),))
    with AnalyticBackend() as backend:
        stacks = [backend.render(RenderJob(scene, rig, RenderSettings(spp=1), view)) for view in range(6)]
    return [stack.geometry.z_depth for stack in stacks], scene.cameras


def test_true_depth_agrees_from_every_view_to_every_other(depths: Depths) -> None:
    z, cameras = depths
    for i in range(6):
        for j in range(6):
            found = reprojection_error(z[i], cameras[i], z[j], cameras[j])
            assert found.compared > 300
            assert found.consistent > 0.999, (i, j, found)
            assert found.median_relative_error < 1e-4, (i, j, found)


def test_wrong_depth_or_pose_is_found(depths: Depths) -> None:
    z, cameras = depths
    ray = ray_distance_from_z_depth(cameras[0], z[0]).astype(np.float32)
    moved = look_at(cameras[0].pose()[:3, 3] + [0.0, 0.05, 0.0], (0.0, 0.05, 0.1))
    turned = camera_from_fov(moved, width=96, height=96, fov=0.7)
    for depth, camera in ((z[0] * 0.9, cameras[0]), (ray, cameras[0]), (z[0], turned)):
        found = reprojection_error(depth, camera, z[4], cameras[4])
        back = reprojection_error(z[4], cameras[4], depth, camera)
        assert min(found.consistent, back.consistent) < 0.95 or found.median_relative_error > 5e-3, found


def test_hidden_points_do_not_count_and_impossible_ones_do() -> None:
    camera = camera_from_fov(look_at((0, -2, 0), (0, 0, 0)), width=16, height=16, fov=1.0)
    far, near = np.full((16, 16), 3.0), np.full((16, 16), 1.0)
    assert reprojection_error(far, camera, near, camera).compared == 0
    assert math.isnan(reprojection_error(far, camera, near, camera).consistent)
    assert reprojection_error(near, camera, far, camera).consistent == 0.0
    assert reprojection_error(near, camera, np.zeros((16, 16)), camera).consistent == 0.0
    assert reprojection_error(far, camera, far, camera).median_relative_error == pytest.approx(0, abs=1e-12)


def test_detail_of_a_close_up_is_not_asked_of_a_wide_view() -> None:
    close, wide = (camera_from_fov(look_at((0, -d, 0), (0, 0, 0)), width=64, height=64, fov=1.0) for d in (1, 8))
    wall, relief = np.full((64, 64), 8.0), np.full((64, 64), 1.0)
    relief[10:12, ::2] = relief[30:32, ::2] = relief[50:52, ::2] = 0.9  # less than a pixel of the wide view
    assert reprojection_error(relief, close, wall, wide).consistent == 1.0
    assert reprojection_error(relief * 0.9, close, wall, wide).consistent == 0.0


def test_depth_of_the_wrong_shape_is_refused() -> None:
    camera = camera_from_fov(np.eye(4), width=8, height=4, fov=1.0)
    with pytest.raises(ValueError, match=r"\(8, 4\).*4 x 8"):
        unproject(camera, np.ones((8, 4)))
    with pytest.raises(ValueError, match=r"depth_b.*\(8, 4\)"):
        reprojection_error(np.ones((4, 8)), camera, np.ones((8, 4)), camera)


KINDS = ("approach", "orbit", "handheld", "random")


def only(kind: str) -> TrajectoryShares:
    return TrajectoryShares(**{name: float(name == kind) for name in KINDS})


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module", params=KINDS)
def still_lifes(request: pytest.FixtureRequest, library: AssetLibrary) -> StillLifes:
    cameras = CameraSettings(trajectories=only(request.param), depth_of_field=1.0)
    settings = StillLifeSettings(width=96, height=64, views=8, cameras=cameras)
    scenes = [sample_tabletop(Streams(21, i), library, index=i, settings=settings) for i in range(4)]
    return request.param, scenes


def around(scene: SceneSpec, library: AssetLibrary) -> np.ndarray:
    """Where the eyes are, seen from the middle of the insertable objects: azimuth [rad] and distance [m]."""
    bodies = [body for body in scene.bodies if body.insertable]
    middle = np.mean([body_triangles(body, library)[0].mean(axis=0) for body in bodies], axis=0)
    away = np.array([camera.pose()[:3, 3] - middle for camera in scene.cameras])
    return np.stack([np.unwrap(np.arctan2(away[:, 1], away[:, 0])), np.linalg.norm(away, axis=1)])


def test_every_insertable_is_seen_in_the_stated_share_of_views(still_lifes: StillLifes, library: AssetLibrary) -> None:
    _, scenes = still_lifes
    for scene in scenes:
        rays = SceneRays(scene.bodies, library)
        for number, body in enumerate(scene.bodies):
            if body.insertable:
                points = surface_points(body, library, np.random.default_rng(0), 300)
                shares = [rays.visible_share(c.pose()[:3, 3], number, points) for c in scene.cameras]
                shown = [s >= 0.9 * SEEN and in_frame(c, points) for s, c in zip(shares, scene.cameras, strict=True)]
                # 64 points stood for the object when it was checked, 300 do here: one view of eight may differ.
                assert sum(shown) >= 0.7 * len(scene.cameras) - 1, (scene.index, body.name)


def test_lenses_stay_in_range_and_objects_keep_their_size(still_lifes: StillLifes, library: AssetLibrary) -> None:
    _, scenes = still_lifes
    sizes: list[float] = []
    near: list[float] = []
    for scene in scenes:
        points = np.concatenate([body_triangles(b, library)[0] for b in scene.bodies if b.role == "object"])
        for number, camera in enumerate(scene.cameras):
            assert 23.9 <= focal_length_mm(camera) <= 85.1
            pixels, depth = project(camera, points)
            # The last two may have moved in on one object.
            found = near if number >= len(scene.cameras) - 2 else sizes
            found += [np.ptp(pixels, axis=0).max() / 64] if (depth > 0).all() else []
    assert min(sizes) > 0.15
    assert np.median(sizes) > 0.45
    assert max(sizes) < 2.0
    assert max(near, default=0.0) < 12.0


def test_kinds_move_as_their_name_says(still_lifes: StillLifes, library: AssetLibrary) -> None:
    kind, scenes = still_lifes
    for scene in scenes:
        azimuth, distance = around(scene, library)
        framed = np.array([d / focal_length_mm(c) for d, c in zip(distance, scene.cameras, strict=True)])
        turn, steps = np.degrees(np.ptp(azimuth)), np.degrees(np.abs(np.diff(azimuth)))
        if kind == "approach":
            assert framed[-1] < 0.75 * framed[0]
        elif kind == "orbit":
            assert turn > 25
            assert framed.max() < 1.5 * framed.min()
        elif kind == "handheld":
            assert 0.5 < turn < 40
            assert framed.max() < 1.5 * framed.min()
        else:
            assert np.ptp([focal_length_mm(c) for c in scene.cameras]) > 15
            assert steps.max() > 15


def test_handheld_wobble_is_smooth_and_random_is_not() -> None:
    framing = Framing(close=0.3, distant=0.6, front=0.0, opening=1.0)
    rng = np.random.default_rng(3)
    rough = {}
    for kind in ("handheld", "random"):
        paths = [draw_path(rng, kind, framing, views=33, lens_mm=(24, 85)) for _ in range(20)]
        rough[kind] = np.mean([np.abs(np.diff(p.azimuth, 2)).mean() / np.ptp(p.azimuth) for p in paths])
    assert rough["handheld"] < 0.03
    assert rough["random"] > 0.2


def test_distance_follows_the_lens() -> None:
    framing = Framing(close=0.3, distant=0.6, front=0.0, opening=np.pi)
    path = draw_path(np.random.default_rng(0), "random", framing, views=6, lens_mm=(24, 85))
    for view in range(6):
        camera = camera_on(path, view, (np.zeros(3), np.zeros(3)), (96, 64))
        aim = path.framed[view] * path.sway[view]
        eye = camera.pose()[:3, 3]
        # A sphere of the framed radius about the aim touches the upper edge of the picture.
        half = math.atan(32 / camera.fy)
        assert math.asin(path.framed[view] / np.linalg.norm(eye - aim)) == pytest.approx(half)


def test_trajectories_come_as_often_as_stated() -> None:
    settings = CameraSettings(trajectories=TrajectoryShares(approach=0.5, orbit=0.3, handheld=0.2, random=0))
    rng = np.random.default_rng(0)
    drawn: list[str] = [settings.trajectories.draw(rng) for _ in range(600)]
    assert [drawn.count(kind) / 600 for kind in KINDS] == pytest.approx([0.5, 0.3, 0.2, 0.0], abs=0.06)


def test_open_lenses_are_focused_on_an_insertable(still_lifes: StillLifes, library: AssetLibrary) -> None:
    _, scenes = still_lifes
    for scene in scenes:
        middles = [np.mean(np.stack([v.min(0), v.max(0)]), axis=0) for v in
                   (body_triangles(b, library)[0] for b in scene.bodies if b.insertable)]  # fmt: skip
        for camera in scene.cameras:
            assert camera.aperture_radius > 0
            assert 1.79 < focal_length_mm(camera) / 2000 / camera.aperture_radius < 8.01
            depth = project(camera, middles)[1]
            assert np.abs(depth - camera.focus_distance).min() < 0.08


def test_circle_of_confusion_of_a_known_lens() -> None:
    pinhole = camera_from_lens(np.eye(4), width=3600, height=2400, focal_length_mm=50)
    camera = with_depth_of_field(pinhole, f_number=2.0, focus_distance=2.0)
    assert camera.aperture_radius == pytest.approx(0.0125)
    # 25 mm of aperture, 5000 px of focal length; infinitely far: 0.025 * 5000 / 2.
    np.testing.assert_allclose(circle_of_confusion(camera, [2.0, 1.0, 4.0, 1e12]), [0, 62.5, 31.25, 62.5], atol=1e-6)
    assert circle_of_confusion(pinhole, 1.0) == 0
    with pytest.raises(ValueError, match="above 0"):
        with_depth_of_field(pinhole, f_number=0, focus_distance=1)


def test_cycles_spreads_a_spark_over_the_circle_of_confusion(library: AssetLibrary) -> None:
    blender = pytest.importorskip("multilight.datagen.backends.blender")
    spark = Body(
        name="spark",
        role="object",
        category="sphere",
        geometry=Sphere(radius=0.002),
        materials=(Material(),),
        world_from_body=matrix4(np.eye(4)),
        insertable=True,
    )
    pose = look_at((0, -2.0, 0), (0, 0, 0))
    pinhole = camera_from_fov(pose, width=48, height=48, fov=2 * math.atan(24 / 1000))
    views = (pinhole, pinhole.model_copy(update={"aperture_radius": 0.012, "focus_distance": 1.0}))
    scene = SceneSpec(kind="custom", index=0, bodies=(spark,), cameras=views)
    rig = LightRig(lights=(EmissiveLight(name="glow", body="spark", radiance=(5, 5, 5)),))
    with blender.BlenderBackend(library) as backend:
        sharp, soft, alone = (
            backend.render(RenderJob(scene, rig, RenderSettings(spp=256), view, variant))
            for view, variant in ((0, "all"), (1, "all"), (1, "foreground_spark"))
        )
    y, x = np.mgrid[:48, :48] + 0.5 - 24.0
    weight = soft.radiance[0, ..., 1]
    spread = float((weight * (x**2 + y**2)).sum() / weight.sum())
    # Variances add up: the disc of confusion's d² / 8, the spark's own 1 px disc, and the pixel's 1 / 6.
    diameter = math.sqrt(8 * (spread - 1.0**2 / 2 - 1 / 6))
    assert diameter == pytest.approx(float(circle_of_confusion(views[1], 2.0)), rel=0.03)
    assert weight.sum() == pytest.approx(sharp.radiance[0, ..., 1].sum(), rel=0.05)
    # The object alone is the same disc, none of it cut off; and geometry is that of the pinhole.
    np.testing.assert_allclose(alone.radiance, soft.radiance, atol=1e-5)
    np.testing.assert_array_equal(soft.geometry.instance_id, sharp.geometry.instance_id)
    np.testing.assert_array_equal(soft.geometry.z_depth, sharp.geometry.z_depth)
