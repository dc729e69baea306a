"""Blending weights against a slow renderer written pixel by pixel, and closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.gaussians.from_views import Gaussians
from multilight.scenes.gaussians.splatting import CAP, LOW_PASS, blending_weights
from multilight.scenes.spec import Camera


def camera(width: int = 24, height: int = 16) -> Camera:
    return camera_from_fov(look_at([0.3, -3.0, 1.0], [0.0, 0.0, 0.2]), width=width, height=height, fov=0.8)


def cloud(rng: np.random.Generator, count: int = 60) -> Gaussians:
    quats = rng.normal(size=(count, 4))
    return Gaussians(
        means=rng.uniform(-0.7, 0.7, (count, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.02, 0.3, (count, 3)).astype(np.float32),
        opacities=rng.uniform(0.1, 1.0, count).astype(np.float32),
        colors=rng.random((count, 3)).astype(np.float32),
    )


def slow_render(view: Camera, g: Gaussians) -> np.ndarray:
    """Render pixel by pixel, Gaussian by Gaussian, with a numerical Jacobian of the projection."""
    world_to_view = np.linalg.inv(view.pose())

    def to_pixel(point: np.ndarray) -> np.ndarray:
        x, y, z, _ = world_to_view @ [*point, 1.0]
        return np.array([view.cx + view.fx * x / -z, view.cy - view.fy * y / -z])

    splats = []
    for mean, quat, scale, opacity, color in zip(g.means, g.quats, g.scales, g.opacities, g.colors, strict=True):
        mean = mean.astype(float)
        depth = -(world_to_view @ [*mean, 1.0])[2]
        if depth <= 0.01:
            continue
        rotation = Rotation.from_quat(quat[[1, 2, 3, 0]].astype(float)).as_matrix()
        covariance = rotation @ np.diag(scale.astype(float) ** 2) @ rotation.T
        step = 1e-5
        jacobian = np.stack([(to_pixel(mean + e) - to_pixel(mean - e)) / (2 * step) for e in step * np.eye(3)], 1)
        flat = jacobian @ covariance @ jacobian.T + LOW_PASS * np.eye(2)
        splats.append((depth, to_pixel(mean), np.linalg.inv(flat), float(opacity), color))
    splats.sort(key=lambda s: s[0])
    image = np.zeros((view.height, view.width, 3))
    for y in range(view.height):
        for x in range(view.width):
            through = 1.0
            for _, centre, inverse, opacity, color in splats:
                d = np.array([x + 0.5, y + 0.5]) - centre
                alpha = min(CAP, opacity * np.exp(-0.5 * d @ inverse @ d))
                if alpha < 1 / 255 or through <= 1e-4:
                    continue
                image[y, x] += through * alpha * color
                through *= 1 - alpha
    return image


@pytest.mark.parametrize("seed", range(3))
def test_weights_render_as_the_slow_renderer_does(seed: int) -> None:
    view, gaussians = camera(), cloud(np.random.default_rng(seed))
    picture = (blending_weights(view, gaussians) @ gaussians.colors).reshape(view.height, view.width, 3)
    np.testing.assert_allclose(picture, slow_render(view, gaussians), atol=2e-4)


def test_rows_sum_to_coverage_and_white_stays_white() -> None:
    weights = blending_weights(camera(), cloud(np.random.default_rng(5), 400))
    sums = np.asarray(weights.sum(axis=1)).ravel()
    assert sums.min() >= 0
    assert sums.max() <= 1 + 1e-5
    assert weights.data.min() > 0


def test_one_gaussian_has_the_closed_form() -> None:
    view = camera_from_fov(np.eye(4), width=33, height=33, fov=0.9)  # looks along -Z
    sigma, depth, opacity = 0.1, 2.0, 0.8
    one = np.ones((1, 3), np.float32)
    gaussians = Gaussians(
        means=np.array([[0, 0, -depth]], np.float32),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        scales=sigma * one,
        opacities=np.array([opacity], np.float32),
        colors=one,
    )
    weights = blending_weights(view, gaussians).toarray().reshape(33, 33)
    variance = (view.fx * sigma / depth) ** 2 + LOW_PASS
    y, x = np.mgrid[:33, :33] - 16.0
    expected = opacity * np.exp(-0.5 * (x**2 + y**2) / variance)
    np.testing.assert_allclose(weights, np.where(expected >= 1 / 255, expected, 0), atol=1e-5)


def test_what_lies_behind_an_opaque_one_is_hidden() -> None:
    view = camera_from_fov(np.eye(4), width=9, height=9, fov=0.9)
    gaussians = Gaussians(
        means=np.array([[0, 0, -3], [0, 0, -1], [0, 0, 1]], np.float32),  # behind, in front, behind the camera
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (3, 1)),
        scales=np.full((3, 3), 0.5, np.float32),
        opacities=np.ones(3, np.float32),
        colors=np.eye(3, dtype=np.float32),
    )
    centre = blending_weights(view, gaussians).toarray()[4 * 9 + 4]
    np.testing.assert_allclose(centre, [CAP * (1 - CAP), CAP, 0.0], atol=1e-6)
