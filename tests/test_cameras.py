"""Cameras: inverses, conventions, rays, and depth carried from view to view."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datagen.backends import RenderJob, RenderSettings
from datagen.backends.analytic import AnalyticBackend
from lights.spec import EnvironmentLight, LightRig
from scenes.cameras import (
    camera_from_fov,
    camera_from_lens,
    look_at,
    opencv_from_opengl,
    pixel_rays,
    project,
    ray_distance_from_z_depth,
    reprojection_error,
    unproject,
    z_depth_from_ray_distance,
)
from scenes.spec import Camera
from scenes.spheres import sample_spheres
from scenes.streams import Streams

coordinate = st.floats(-5, 5)


@st.composite
def cameras(draw) -> Camera:
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
def test_project_undoes_unproject(camera, seed):
    depth = np.random.default_rng(seed).uniform(0.1, 20, (camera.height, camera.width))
    pixels, z_depth = project(camera, unproject(camera, depth).reshape(-1, 3))
    np.testing.assert_allclose(z_depth, depth.ravel(), rtol=1e-9)
    centres = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1) + 0.5
    np.testing.assert_allclose(pixels, centres.reshape(-1, 2), atol=1e-7)


@given(camera=cameras())
def test_rays_meet_unprojected_points_at_the_ray_distance(camera):
    depth = np.full((camera.height, camera.width), 3.0)
    origins, directions = pixel_rays(camera)
    distance = ray_distance_from_z_depth(camera, depth)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    np.testing.assert_allclose(origins + distance[..., None] * directions, unproject(camera, depth), atol=1e-9)
    np.testing.assert_allclose(z_depth_from_ray_distance(camera, distance), depth)
    assert (distance >= depth - 1e-12).all()


@given(camera=cameras())
def test_poses_are_rigid_and_opencv_conversion_is_its_own_inverse(camera):
    pose = camera.pose()
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-9)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)
    np.testing.assert_array_equal(opencv_from_opengl(opencv_from_opengl(pose)), pose)


@given(camera=cameras(), point=st.tuples(coordinate, coordinate, coordinate))
def test_projection_equals_k_times_the_opencv_pose(camera, point):
    pixels, z_depth = project(camera, [point])
    x = np.linalg.inv(opencv_from_opengl(camera.pose())) @ [*point, 1.0]
    assert z_depth[0] == pytest.approx(x[2], abs=1e-9)
    if x[2] > 1e-3:
        u = camera.intrinsics() @ x[:3]
        np.testing.assert_allclose(pixels[0], u[:2] / u[2], rtol=1e-7, atol=1e-6)
    elif x[2] < -1e-9:
        assert np.isnan(pixels).all()


def test_axes_of_a_known_camera():
    camera = camera_from_fov(look_at((0, -2, 0), (0, 0, 0)), width=4, height=2, fov=math.pi / 2)
    assert (camera.fx, camera.fy) == pytest.approx((2.0, 2.0))
    # One metre to the right is +X in the world, and to the right in the picture; up is up.
    pixels, z_depth = project(camera, [(1, 0, 0), (0, 0, 1), (0, 0, 0)])
    np.testing.assert_allclose(pixels, [(3, 1), (2, 0), (2, 1)], atol=1e-12)
    np.testing.assert_allclose(z_depth, 2.0)


def test_field_of_view_spans_the_longer_side():
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
def test_impossible_cameras_are_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


@pytest.fixture(scope="module")
def depths():
    scene = sample_spheres(Streams(3, 0), index=0, width=96, height=96, views=6)
    rig = LightRig(lights=(EnvironmentLight(name="sky"),))
    with AnalyticBackend() as backend:
        stacks = [backend.render(RenderJob(scene, rig, RenderSettings(spp=1), view)) for view in range(6)]
    return [stack.geometry.z_depth for stack in stacks], scene.cameras


def test_true_depth_agrees_from_every_view_to_every_other(depths):
    z, cameras = depths
    for i in range(6):
        for j in range(6):
            found = reprojection_error(z[i], cameras[i], z[j], cameras[j])
            assert found.compared > 300
            assert found.consistent > 0.999, (i, j, found)
            assert found.median_relative_error < 1e-4, (i, j, found)


def test_wrong_depth_or_pose_is_found(depths):
    z, cameras = depths
    ray = ray_distance_from_z_depth(cameras[0], z[0]).astype(np.float32)
    moved = look_at(cameras[0].pose()[:3, 3] + [0.0, 0.05, 0.0], (0.0, 0.05, 0.1))
    turned = camera_from_fov(moved, width=96, height=96, fov=0.7)
    for depth, camera in ((z[0] * 0.9, cameras[0]), (ray, cameras[0]), (z[0], turned)):
        found = reprojection_error(depth, camera, z[4], cameras[4])
        back = reprojection_error(z[4], cameras[4], depth, camera)
        assert min(found.consistent, back.consistent) < 0.95 or found.median_relative_error > 5e-3, found


def test_hidden_points_do_not_count_and_impossible_ones_do():
    camera = camera_from_fov(look_at((0, -2, 0), (0, 0, 0)), width=16, height=16, fov=1.0)
    far, near = np.full((16, 16), 3.0), np.full((16, 16), 1.0)
    assert reprojection_error(far, camera, near, camera).compared == 0
    assert math.isnan(reprojection_error(far, camera, near, camera).consistent)
    assert reprojection_error(near, camera, far, camera).consistent == 0.0
    assert reprojection_error(near, camera, np.zeros((16, 16)), camera).consistent == 0.0
    assert reprojection_error(far, camera, far, camera).median_relative_error == pytest.approx(0, abs=1e-12)


def test_depth_of_the_wrong_shape_is_refused():
    camera = camera_from_fov(np.eye(4), width=8, height=4, fov=1.0)
    with pytest.raises(ValueError, match=r"\(8, 4\).*4 x 8"):
        unproject(camera, np.ones((8, 4)))
    with pytest.raises(ValueError, match=r"depth_b.*\(8, 4\)"):
        reprojection_error(np.ones((4, 8)), camera, np.ones((8, 4)), camera)
