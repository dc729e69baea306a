"""Light on a depth map, against closed form: a ball's shadow on a plane, its shading, lenses, and the head's lights."""

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from multilight.model.networks.light_head import CHANNELS, LIGHTS, OF_LIGHT, OF_SET, Guess, LightHead, Lights, apparent
from multilight.model.networks.shading import FOCAL, irradiance, normals, points, visibility
from multilight.model.training.losses import seen_by_plain_lens

RADIUS = 0.3
UP = torch.tensor([0.0, math.cos(math.radians(35)), math.sin(math.radians(35))])
FOOT = torch.tensor([0.0, 0.0, -2.0])
PICTURE = torch.full((1, 3, 32, 32), 0.5)
SUNS = [(0.5, 0.8, 0.33), (-0.7, 0.6, 0.2), (0.4, 0.5, 0.7)]


def ball(size: int, focal: float = FOCAL) -> tuple[Tensor, Tensor]:
    """A ball on a plane that leans towards the camera: relative depth and mask, (1, 1, size, size)."""
    rays = points(torch.ones(1, 1, size, size), focal)[0].permute(1, 2, 0)
    plane = (FOOT @ UP) / (rays @ UP)
    plane = torch.where(plane > 0, plane, 20.0)
    centre = FOOT + RADIUS * UP
    along, square = rays @ centre, (rays * rays).sum(-1)
    inside = along**2 - square * (centre @ centre - RADIUS**2)
    front = (along - inside.clamp(min=0).sqrt()) / square
    hit = (inside > 0) & (front < plane)
    depth = torch.where(hit, front, plane)[None, None]
    return depth / 20.0, hit[None, None].float()


def true_shadow(places: Tensor, mask: Tensor, sun: Tensor) -> Tensor:
    """Where the ball hides the sun: (size, size) bool; `places` in metres."""
    offset = (FOOT + RADIUS * UP)[:, None, None] - places[0]
    along = torch.einsum("chw,c->hw", offset, sun)
    return ((offset**2).sum(0) - along**2 < RADIUS**2) & (along > 0) & (mask[0, 0] < 0.5)


@pytest.mark.parametrize("sun", SUNS)
@pytest.mark.parametrize("size", [48, 96])
def test_a_balls_shadow_is_that_of_the_closed_form(sun: tuple[float, float, float], size: int) -> None:
    direction = functional.normalize(torch.tensor(sun), dim=0)
    depth, mask = ball(size)
    seen = visibility(points(depth), mask, direction[None, None], torch.full((1, 1), 0.005))[0, 0]
    found, truth = (seen < 0.5) & (mask[0, 0] < 0.5), true_shadow(20.0 * points(depth), mask, direction)
    assert truth.sum() > 0.02 * mask.sum()
    assert (found & truth).sum() > 0.9 * (found | truth).sum()


def test_a_wide_light_has_a_soft_shadow_of_the_same_size() -> None:
    """Penumbrae widen with the light; what is taken in all stays about the same."""
    depth, mask = ball(96)
    sun = functional.normalize(torch.tensor(SUNS[0]), dim=0)[None, None].expand(1, 2, 3)
    hard, soft = visibility(points(depth), mask, sun, torch.tensor([[0.005, 0.3]]))[0]
    between = [((s > 0.1) & (s < 0.9) & (mask[0, 0] < 0.5)).sum() for s in (hard, soft)]
    assert between[1] > 2.5 * between[0]
    outside = 1.0 - mask[0, 0]
    assert ((1 - soft) * outside).sum() == pytest.approx(float(((1 - hard) * outside).sum()), rel=0.35)


@pytest.mark.parametrize("focal", [0.7, 2.0])
def test_shadows_do_not_depend_on_the_lens(focal: float) -> None:
    """Taken for one of `FOCAL`, another lens only maps space linearly, and lights' directions with it."""
    direction = functional.normalize(torch.tensor(SUNS[1]), dim=0)[None, None]
    depth, mask = ball(112, focal)
    intrinsics = torch.tensor([[[112 * focal, 0, 56], [0, 112 * focal, 56], [0, 0, 1]]])
    mapped = seen_by_plain_lens(direction, intrinsics, 112)
    assert not torch.allclose(mapped, direction, atol=0.05)
    seen = visibility(points(depth), mask, mapped, torch.full((1, 1), 0.005))[0, 0]
    truth = true_shadow(20.0 * points(depth, focal), mask, direction[0, 0])
    found = (seen < 0.5) & (mask[0, 0] < 0.5)
    assert (found & truth).sum() > 0.8 * (found | truth).sum()


def test_a_ball_is_shaded_as_its_normals_say() -> None:
    depth, mask = ball(128)
    places = points(depth)
    facing = normals(places)
    true = functional.normalize(20.0 * places - (FOOT + RADIUS * UP)[None, :, None, None], dim=1)
    inner = -functional.max_pool2d(-mask, 5, 1, 2) > 0.5  # the outline's normals are seen edge-on
    assert ((facing * true).sum(1, keepdim=True)[inner]).quantile(0.1) > 0.99
    sun, colour, ambient = functional.normalize(torch.tensor(SUNS[0]), dim=0), torch.tensor([2.0, 1.0, 0.5]), 0.25
    lit = irradiance(facing, sun[None, None], colour[None, None], torch.full((1, 3), ambient), None)
    wanted = ambient + colour[None, :, None, None] * (true * sun[None, :, None, None]).sum(1, keepdim=True).clamp(min=0)
    assert (lit - wanted).abs().mean(1, keepdim=True)[inner].median() < 0.02


def test_brightness_leans_towards_the_light() -> None:
    """On a ball of one albedo, lit from where all that is seen is lit, the slopes point to the light."""
    depth, mask = ball(96)
    facing = normals(points(depth))
    sun = functional.normalize(torch.tensor([0.3, 0.2, 0.9]), dim=0)
    lit = irradiance(facing, sun[None, None], torch.ones(1, 1, 3), torch.full((1, 3), 0.5), None)
    slopes = apparent(lit, facing, mask).reshape(3, 3)
    assert functional.cosine_similarity(slopes[:, 0], sun, dim=0) > 0.97
    torch.testing.assert_close(slopes[:, 0], slopes[:, 2])


def lit(head: LightHead, known: Tensor, maps: Tensor, depth: Tensor, mask: Tensor) -> tuple[Tensor, Guess]:
    found: tuple[Tensor, Guess] = head(head.numbers(known, PICTURE, PICTURE, depth, mask), maps, depth, mask)
    return found


def test_the_head_changes_nothing_before_it_has_learnt_and_its_gradients_are_finite() -> None:
    torch.manual_seed(0)
    head = LightHead(5)
    depth, mask = ball(32)
    known, maps = torch.randn(1, 5), torch.zeros(1, 12 + CHANNELS, 32, 32)
    found, guess = lit(head, known, maps, depth, mask)
    torch.testing.assert_close(found, torch.zeros_like(found), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(guess.lights.directions.norm(dim=2), torch.ones(1, 3))
    torch.nn.init.normal_(head.last.weight, std=0.3)
    maps = torch.randn(1, 12 + CHANNELS, 32, 32, requires_grad=True)
    flat, nothing = torch.full_like(depth, 0.5), torch.zeros_like(mask)
    for where, what in ((depth, mask), (flat, mask), (depth, nothing), (torch.ones_like(depth), mask)):
        found, guess = lit(head, known, maps, where, what)
        head.zero_grad()
        (found.square().sum() + guess.lights.softness.sum()).backward()
        assert torch.isfinite(found).all()
        for parameter in (*head.parameters(), maps):
            assert parameter.grad is not None
            assert torch.isfinite(parameter.grad).all()


def test_a_glowing_object_keeps_its_glow() -> None:
    """Where the map says that an object's light is its own, no light of the head reaches it."""
    head = LightHead(5)
    torch.nn.init.normal_(head.last.weight, std=1.0)
    depth, mask = ball(32)
    maps = torch.zeros(1, 12 + CHANNELS, 32, 32)
    maps[:, 15] = 20.0
    found, _ = lit(head, torch.randn(1, 5), maps, depth, mask)
    torch.testing.assert_close(found[:, :6], torch.zeros(1, 6, 32, 32), atol=1e-4, rtol=0.0)


def test_a_light_that_is_found_is_worth_more_than_one_that_is_not() -> None:
    from multilight.model.training.losses import light_loss
    from tests.model.test_training import a_batch

    batch = a_batch(count=1)
    towards = functional.normalize(torch.tensor(SUNS), dim=1)[None]
    plain = torch.tensor([[[FOCAL * 32, 0, 16], [0, FOCAL * 32, 16], [0, 0, 1]]])
    batch = type(batch)(**vars(batch) | {"K": plain, "light_towards": towards, "light_fraction": torch.ones(1, 3) / 3})
    guess = Lights(towards, torch.ones(1, 3, 3), torch.ones(1, 3), torch.ones(1, 3))
    assert light_loss(guess, batch) < light_loss(guess._replace(directions=-towards), batch) - 5


def test_views_of_one_scene_agree_on_its_lights() -> None:
    """Views that tell one world direction in their own axes keep it; where they differ, the mean counts."""
    head = LightHead(known=2)
    torch.manual_seed(0)
    rotations = torch.linalg.qr(torch.randn(4, 3, 3))[0]
    rotations = rotations * torch.linalg.det(rotations)[:, None, None]
    world = functional.normalize(torch.randn(LIGHTS, 3), dim=1)
    numbers = torch.randn(4, 2 * OF_SET + 9)
    for start in (0, OF_SET):
        lights = numbers[:, start : start + LIGHTS * OF_LIGHT].unflatten(1, (LIGHTS, OF_LIGHT))
        lights[..., :3] = torch.einsum("vji,kj->vki", rotations, world) - head.base
    agreed = head.of_one_scene(numbers, rotations)
    for told in (numbers, agreed):
        for start in (0, OF_SET):
            towards = head._lights(told[:, start : start + OF_SET]).directions
            torch.testing.assert_close(torch.einsum("vij,vkj->vki", rotations, towards), world.expand(4, -1, -1))
    torch.testing.assert_close(agreed[:, -9:], numbers[:, -9:].mean(dim=0).expand(4, 9))
    torch.testing.assert_close(agreed[:, 3:7], numbers[:, 3:7].mean(dim=0).expand(4, 4))
