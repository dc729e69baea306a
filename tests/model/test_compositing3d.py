"""The 3D stage: carrying colours to Gaussians and back, and the network on their map."""

from pathlib import Path

import numpy as np
import pytest
import torch

from multilight.datagen.storage.open_dataset import open_dataset
from multilight.model.configs.stage3d import Order, SceneNetworkConfig
from multilight.model.gaussians.splat_scene import SplatScene, map_order, splat_scene
from multilight.model.networks.compositing3d import Compositing3D, detailed, harmonize_scene
from multilight.scenes.cameras.pinhole import project
from multilight.scenes.gaussians.splatting import blending_weights

SIDE = 32
TINY = SceneNetworkConfig(stride=2, width=16, groups=1, blocks=2, heads=2, window=4, pooled=2)


@pytest.fixture(scope="module")
def scene(spheres_dataset: Path) -> SplatScene:
    source = open_dataset(spheres_dataset)
    record = source.scene(0)
    views = [source.view(record, number).geometry for number in range(3)]
    return splat_scene(record.scene.cameras, np.stack([view.z_depth for view in views]), side=SIDE)


def images(scene: SplatScene, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(scene.views, 3, scene.height, scene.width, generator=generator)


def test_rendering_is_the_blending_of_each_view(scene: SplatScene, spheres_dataset: Path) -> None:
    cameras = open_dataset(spheres_dataset).scene(0).scene.cameras
    colors = np.random.default_rng(0).random((SIDE * SIDE, 3)).astype(np.float32)
    shown = scene.render(torch.from_numpy(colors)).numpy()
    for view, camera in zip(shown, cameras, strict=True):
        expected = blending_weights(camera, scene.gaussians.gaussians) @ colors
        np.testing.assert_allclose(view, expected.reshape(camera.height, camera.width, 3).transpose(2, 0, 1), atol=1e-5)


def test_gradient_of_rendering_is_the_transpose(scene: SplatScene) -> None:
    colors = torch.rand(SIDE * SIDE, 2, requires_grad=True)
    weight = torch.rand(scene.views, 2, scene.height, scene.width)
    (scene.render(colors) * weight).sum().backward()
    flat = weight.permute(0, 2, 3, 1).reshape(-1, 2)
    assert colors.grad is not None
    torch.testing.assert_close(colors.grad, scene.matrix.to_dense().T @ flat, atol=1e-4, rtol=1e-4)


def test_carrying_averages_with_the_blending_weights(scene: SplatScene) -> None:
    pictures = images(scene)
    dense = scene.matrix.to_dense()
    flat = pictures.permute(0, 2, 3, 1).reshape(-1, 3)
    weight = dense.sum(0)
    expected = torch.where(weight[:, None] > 1e-3, dense.T @ flat / weight[:, None], flat[scene.sources])
    torch.testing.assert_close(scene.carry(pictures), expected, atol=1e-4, rtol=1e-4)
    grey = torch.full_like(pictures, 0.3)
    torch.testing.assert_close(scene.carry(grey), torch.full((SIDE * SIDE, 3), 0.3))


def test_sources_point_at_the_pixels_the_gaussians_lie_in(scene: SplatScene, spheres_dataset: Path) -> None:
    cameras = open_dataset(spheres_dataset).scene(0).scene.cameras
    place = torch.arange(scene.views * scene.height * scene.width).reshape(scene.views, 1, scene.height, scene.width)
    taken = scene.gather(place.float())[:, 0].long().numpy()
    for number in (0, 200, 700):
        view, pixel = divmod(int(taken[number]), scene.height * scene.width)
        row, column = divmod(pixel, scene.width)
        found, _ = project(cameras[view], scene.gaussians.gaussians.means[number : number + 1])
        np.testing.assert_allclose(found[0], [column + 0.5, row + 0.5], atol=1e-2)


def test_smoothing_keeps_what_is_smooth_and_views_apart(scene: SplatScene) -> None:
    levels = torch.tensor([0.2, 0.5, 0.8]).reshape(3, 1, 1, 1).expand(3, 3, scene.height, scene.width)
    covered = scene.covered()
    shown = scene.smooth(levels)
    torch.testing.assert_close(
        torch.where(covered > 0.05, shown, levels), levels.contiguous(), atol=2e-3, rtol=0
    )  # no view's grey leaks into another's


def test_map_is_a_permutation(scene: SplatScene) -> None:
    colors = torch.rand(SIDE * SIDE, 3)
    torch.testing.assert_close(scene.from_map(scene.to_map(colors)), colors, rtol=0, atol=0)
    assert len(set(scene.cells.tolist())) == SIDE * SIDE


def test_neighbours_on_the_map_are_neighbours_in_space(scene: SplatScene) -> None:
    means = torch.from_numpy(scene.gaussians.gaussians.means)
    folded = scene.to_map(means)[0]
    near = (folded[:, :, 1:] - folded[:, :, :-1]).norm(dim=0).median()
    shuffled = means[torch.randperm(len(means), generator=torch.Generator().manual_seed(0))]
    assert near < 0.25 * (shuffled[1:] - shuffled[:-1]).norm(dim=1).median()


def test_untrained_network_returns_the_carried_colours(scene: SplatScene) -> None:
    harmonized = images(scene, 1) * 0.5 + 0.2
    for carry, expected in (("average", scene.carry(harmonized)), ("pixel", scene.gather(harmonized))):
        network = Compositing3D(TINY.model_copy(update={"carry": carry})).eval()
        colors, _ = harmonize_scene(network, scene, images(scene), harmonized, images(scene))
        torch.testing.assert_close(colors, expected, atol=1e-5, rtol=1e-5)


def test_detail_survives_where_the_views_agree(scene: SplatScene) -> None:
    # What all views show alike on the surfaces: a colour that depends on the place alone, and sharply.
    means = torch.from_numpy(scene.gaussians.gaussians.means)
    colors = 0.5 + 0.3 * torch.sin(12.0 * means)
    views = scene.render(colors) + 0.3 * (1.0 - scene.covered())
    shown = detailed(scene, scene.carry(views), views)
    plain = scene.render(scene.carry(views)) + 0.3 * (1.0 - scene.covered())
    assert ((shown - views) ** 2).mean() < 0.5 * ((plain - views) ** 2).mean()


def test_disagreeing_views_are_drawn_together(scene: SplatScene) -> None:
    base = torch.full((3, 3, scene.height, scene.width), 0.5)
    tinted = base + torch.tensor([-0.1, 0.0, 0.1]).reshape(3, 1, 1, 1)
    shown = detailed(scene, scene.carry(tinted), tinted)
    seen = scene.covered().expand_as(shown) > 0.9
    assert (shown - base)[seen].abs().mean() < 0.75 * (tinted - base)[seen].abs().mean()


def test_what_no_view_changed_stays(scene: SplatScene) -> None:
    """Views that disagree, as reflections do, and a patch of the first that the 2D stage made darker."""
    backgrounds = images(scene, 1) * 0.5 + 0.2
    harmonized = backgrounds.clone()
    untouched = harmonize_scene(Compositing3D(TINY).eval(), scene, harmonized, harmonized, backgrounds)[1]
    assert torch.equal(untouched, backgrounds)
    at = scene.height // 2
    harmonized[0, :, at - 4 : at + 4, at - 4 : at + 4] *= 0.5
    views = harmonize_scene(Compositing3D(TINY).eval(), scene, harmonized, harmonized, backgrounds)[1]
    assert (views[0, :, at - 4 : at + 4, at - 4 : at + 4] < backgrounds[0, :, at - 4 : at + 4, at - 4 : at + 4]).all()
    assert ((views - backgrounds).abs().amax(1) > 1e-3).float().mean() < 0.25


def test_network_learns_a_tint(scene: SplatScene) -> None:
    torch.manual_seed(0)
    network = Compositing3D(TINY).train()
    composites = images(scene) * 0.5 + 0.2
    target = composites * torch.tensor([1.0, 0.8, 0.6]).reshape(1, 3, 1, 1)
    optimizer = torch.optim.Adam(network.parameters(), lr=5e-3)
    losses = []
    for _ in range(40):
        colors, _ = harmonize_scene(network, scene, composites, composites, composites)
        loss = ((colors - scene.carry(target)) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.1 * losses[0]


@pytest.mark.parametrize("order", ["morton", "arbitrary"])
def test_order_rearranges_the_map_only(spheres_dataset: Path, order: Order) -> None:
    source = open_dataset(spheres_dataset)
    record = source.scene(1)
    depths = np.stack([source.view(record, number).geometry.z_depth for number in range(2)])
    cameras = record.scene.cameras[:2]
    plain, other = splat_scene(cameras, depths, side=16), splat_scene(cameras, depths, side=16, order=order)
    colors = torch.rand(256, 3)
    torch.testing.assert_close(plain.render(colors), other.render(colors))
    torch.testing.assert_close(other.from_map(other.to_map(colors)), colors)
    first = map_order(plain.gaussians.gaussians.means, order)
    assert first is not None
    assert other.cells[first[0]] == plain.cells[0]  # the one named first lies where the first one lay
    assert not torch.equal(other.cells, plain.cells)
