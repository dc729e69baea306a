"""Refined Gaussians: the differentiable splatting against the NumPy one, its gradients, and what refining is worth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from multilight.datagen.errors import UserError
from multilight.model.commands.evaluate import Evaluate
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.configs.stage3d import SceneNetworkConfig
from multilight.model.evaluation.cases import Group, dataset_groups
from multilight.model.evaluation.method3d import SceneMethod
from multilight.model.evaluation.settings import CaseSettings
from multilight.model.gaussians.refine import Pairs, Parameters, refine, refined_scene, render
from multilight.model.gaussians.splat_scene import splat_scene
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import scene_network
from multilight.scenes.arrays import Float32, Mask
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.gaussians.from_views import Gaussians, gaussians_from_views
from multilight.scenes.gaussians.splatting import blending_weights
from multilight.scenes.spec import Camera

SIDE = 32
TINY = {"body": "attention", "stride": 2, "width": 16, "groups": 1, "blocks": 2, "heads": 2, "window": 4, "pooled": 2}


@pytest.fixture(scope="module")
def group(spheres_dataset: Path) -> Group:
    """Three views of one scene with an object under other light."""
    settings = CaseSettings(splits=("train", "val", "test", "test_ood"), groups=8, size=48)
    groups = [load() for load in dataset_groups(spheres_dataset, settings)]
    return next(each for each in groups if len(each.cases) == 3)


def pictures(group: Group) -> Float32:
    return np.stack([case.composite for case in group.cases])


def laid(group: Group, views: int = 3) -> Gaussians:
    """Gaussians on the first views' depth, in the colours of those."""
    depths = np.stack(group.z_depth[:views])
    made = gaussians_from_views(group.cameras[:views], depths, np.zeros(depths.shape, np.int64), [], side=SIDE)
    colors = pictures(group)[:views].reshape(views, -1, 3)[made.sources[:, 0], made.sources[:, 1]]
    return replace(made.gaussians, colors=colors)


def cloud(seed: int, count: int) -> Gaussians:
    """Gaussians all over the picture of `camera`, beyond its edges, and behind it."""
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    return Gaussians(
        means=rng.uniform(-4.0, 4.0, (count, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.02, 0.6, (count, 3)).astype(np.float32),
        opacities=rng.uniform(0.1, 1.0, count).astype(np.float32),
        colors=rng.random((count, 3)).astype(np.float32),
    )


def camera(width: int = 40, height: int = 24) -> Camera:
    return camera_from_fov(look_at([0.3, -3.0, 1.0], [0.0, 0.0, 0.2]), width=width, height=height, fov=0.8)


def shown(view: Camera, gaussians: Gaussians) -> Float32:
    """Colours and covered share as `scenes.gaussians.splatting` has them, (H, W, 4)."""
    both = np.concatenate((gaussians.colors, np.ones((len(gaussians), 1), np.float32)), axis=1)
    return (blending_weights(view, gaussians) @ both).reshape(view.height, view.width, 4)


def psnr(view: Camera, gaussians: Gaussians, picture: Float32, where: Mask) -> float:
    error = np.square(shown(view, gaussians)[..., :3] - picture)[where]
    return float(-10.0 * np.log10(error.mean(dtype=np.float64)))


@pytest.mark.parametrize("seed", range(3))
def test_renders_what_numpy_renders(seed: int) -> None:
    view, gaussians = camera(), cloud(seed, 500)
    made = render(view, Parameters.of(gaussians), Pairs.of(view, gaussians)).numpy()
    np.testing.assert_allclose(made, shown(view, gaussians), atol=2e-5)
    assert made[..., 3].max() > 0.9


def test_renders_a_scene_as_numpy_does(group: Group) -> None:
    gaussians = laid(group)
    for view in group.cameras:
        made = render(view, Parameters.of(gaussians), Pairs.of(view, gaussians)).numpy()
        np.testing.assert_allclose(made, shown(view, gaussians), atol=2e-5)


def test_gradients_are_those_of_finite_differences() -> None:
    view = camera(10, 7)
    gaussians = cloud(3, 40)
    gaussians = replace(gaussians, opacities=np.minimum(gaussians.opacities, np.float32(0.9)))  # below the cap
    pairs, free = Pairs.of(view, gaussians), Parameters.of(gaussians, dtype=torch.float64)
    names = ("means", "quats", "logs", "logits", "colors")
    leaves = [getattr(free, name).requires_grad_() for name in names]

    def picture(*values: torch.Tensor) -> torch.Tensor:
        return render(view, Parameters(*values), pairs)

    assert len(pairs.numbers) > 10
    assert torch.autograd.gradcheck(picture, leaves)


def test_what_is_capped_has_no_gradient() -> None:
    view = camera_from_fov(np.eye(4), width=9, height=9, fov=0.9)
    one = replace(
        cloud(0, 1), means=np.array([[0, 0, -1]], np.float32), scales=np.full((1, 3), 9, np.float32),
        opacities=np.ones(1, np.float32),
    )  # fmt: skip
    free = Parameters.of(one)
    free.logits.requires_grad_()
    made = render(view, free, Pairs.of(view, one))
    made.sum().backward()
    np.testing.assert_allclose(made[..., 3].detach(), 0.99, rtol=1e-6)
    assert free.logits.grad is not None
    assert free.logits.grad.item() == 0.0


def test_disturbed_gaussians_find_back(group: Group) -> None:
    true = laid(group)
    rng = np.random.default_rng(0)
    factors = np.exp(rng.normal(0.0, 0.5, true.scales.shape))
    disturbed = replace(
        true,
        scales=(true.scales * factors).astype(np.float32),
        colors=np.clip(true.colors + rng.normal(0.0, 0.15, true.colors.shape), 0, 1).astype(np.float32),
    )
    given = np.stack([shown(view, true)[..., :3] for view in group.cameras])
    seen = np.stack(group.z_depth) > 0
    found = refine(disturbed, group.cameras, given, seen, steps=120)
    for view, picture, where in zip(group.cameras, given, seen, strict=True):
        assert psnr(view, found, picture, where) > psnr(view, disturbed, picture, where) + 3.0
    np.testing.assert_array_equal(found.means, true.means)
    np.testing.assert_allclose(np.linalg.norm(found.quats, axis=1), 1.0, atol=1e-5)
    assert found.opacities.max() <= 1.0
    assert np.isfinite(found.scales).all()


def test_a_view_not_refined_on_gains(group: Group) -> None:
    start = laid(group, views=2)
    given, seen = pictures(group), np.stack(group.z_depth) > 0
    found = refine(start, group.cameras[:2], given[:2], seen[:2], steps=100)
    third = group.cameras[2]
    shared = seen[2] & (shown(third, start)[..., 3] > 0.9)
    assert shared.sum() > 300
    assert psnr(third, found, given[2], shared) > psnr(third, start, given[2], shared)


def test_coverage_recedes_from_where_nothing_is(group: Group) -> None:
    view, made = group.cameras[0], laid(group, views=1)
    start = replace(made, opacities=np.full(len(made), 0.8, np.float32))
    seen = np.ones((1, 48, 48), bool)
    seen[:, :, 24:] = False
    found = refine(start, [view], pictures(group)[:1], seen, steps=100)
    before, after = (shown(view, each)[..., 3] for each in (start, found))
    assert after[~seen[0]].mean() < 0.8 * before[~seen[0]].mean()
    assert after[seen[0]].mean() > 0.98 * before[seen[0]].mean()


def test_same_seed_same_bits(group: Group) -> None:
    seen = np.stack(group.z_depth) > 0
    first, again, other = (
        refine(laid(group), group.cameras, pictures(group), seen, steps=5, seed=seed) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.scales, again.scales)
    np.testing.assert_array_equal(first.colors, again.colors)
    assert not np.array_equal(first.scales, other.scales)


def test_scene_keeps_its_map(group: Group) -> None:
    depths = np.stack(group.z_depth)
    scene = splat_scene(group.cameras, depths, side=SIDE, order="morton")
    found = refined_scene(scene, group.cameras, pictures(group), depths, steps=20)
    assert torch.equal(found.cells, scene.cells)
    assert torch.equal(found.sources, scene.sources)
    made = found.gaussians.gaussians
    assert not np.array_equal(made.scales, scene.gaussians.gaussians.scales)
    colors = torch.from_numpy(made.colors)
    views = found.render(colors).permute(0, 2, 3, 1).numpy()
    for camera, view in zip(group.cameras, views, strict=True):
        np.testing.assert_allclose(view, shown(camera, made)[..., :3], atol=1e-5)
    assert found.transposed.shape == (SIDE * SIDE, 3 * 48 * 48)
    torch.testing.assert_close(found.transposed.to_dense(), found.matrix.to_dense().T)


def test_no_iterations_change_nothing(group: Group) -> None:
    start = laid(group)
    found = refine(start, group.cameras, pictures(group), np.stack(group.z_depth) > 0, steps=0)
    np.testing.assert_allclose(found.scales, start.scales, rtol=1e-5)
    np.testing.assert_allclose(found.opacities, start.opacities, atol=2e-6)


def test_pictures_of_another_size_are_refused(group: Group) -> None:
    seen = np.stack(group.z_depth) > 0
    with pytest.raises(ValueError, match="pictures of shape"):
        refine(laid(group), group.cameras, pictures(group)[:, :-1], seen, steps=1)


def test_evaluated_on_refined_gaussians(group: Group) -> None:
    torch.manual_seed(0)
    stage2d = Compositing2D(NetworkConfig.model_validate(TINY)).eval()
    changes = TINY | {"head": "residual", "cues": False}
    stage3d = scene_network(SceneNetworkConfig.model_validate(changes)).eval()
    outputs = []
    for steps in (0, 30):
        method = SceneMethod(stage2d, stage3d, side=SIDE, refine_iterations=steps)
        method.begin(group)
        outputs.append(np.stack([method(case) for case in group.cases]))
    assert np.isfinite(outputs[1]).all()
    assert not np.array_equal(outputs[0], outputs[1])
    assert np.abs(outputs[1] - outputs[0]).mean() < 0.02  # untrained: carried colours come back, on either


@pytest.mark.parametrize("weights", [None, Path("3d.safetensors")])
def test_iterations_that_cannot_be_are_refused(tmp_path: Path, weights: Path | None) -> None:
    command = Evaluate("dataset", out=tmp_path, weights_3d=weights, refine_iterations=(250, 0))
    with pytest.raises(UserError, match="--weights-3d, and numbers from 1 up"):
        command.run()
