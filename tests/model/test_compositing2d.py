"""The 2D network: shapes, identity before training, its mask and gains in closed form, attention against a slow one."""

import math

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from multilight.model.configs.stage2d import NETWORKS, NetworkConfig
from multilight.model.networks.attention import Block, WindowAttention, from_windows, shift_mask, windows_of
from multilight.model.networks.compositing2d import (
    DARK,
    LEAST_LOG_GAIN,
    LEAST_OFFSET,
    STATISTICS,
    Compositing2D,
    apply_gains,
    statistics,
)
from multilight.model.networks.input_features import linear_to_srgb, soft_mask, srgb_to_linear

TINY = NetworkConfig(body="attention", width=16, heads=2, groups=1, blocks=2, window=4, pooled=2)


def pictures(height: int, width: int, count: int = 1, seed: int = 0) -> tuple[Tensor, Tensor, Tensor]:
    """A background, a brighter rectangle pasted on it, and a sloping depth: composite, background, depth."""
    rng = torch.Generator().manual_seed(seed)
    background = 0.2 + 0.3 * torch.rand(count, 3, height, width, generator=rng)
    composite = background.clone()
    part = (..., slice(height // 4, height // 2), slice(width // 4, width // 2))
    composite[part] = 0.6 + 0.3 * torch.rand(composite[part].shape, generator=rng)
    depth = torch.linspace(0.3, 1.0, height)[None, None, :, None].expand(count, 1, height, width).clone()
    return composite, background, depth


def shaken(config: NetworkConfig, seed: int = 0) -> Compositing2D:
    """A network that is not the identity any more."""
    torch.manual_seed(seed)
    network = Compositing2D(config).eval()
    with torch.no_grad():
        for parameter in network.head.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    return network


@pytest.mark.parametrize("head", ["light", "gain", "residual"])
@pytest.mark.parametrize("body", ["pyramid", "attention"])
@pytest.mark.parametrize("size", [(64, 64), (33, 50), (96, 72)])
def test_untrained_network_returns_the_composite(head: str, body: str, size: tuple[int, int]) -> None:
    composite, background, depth = pictures(*size, count=2)
    network = Compositing2D(TINY.model_copy(update={"head": head, "body": body})).eval()
    with torch.no_grad():
        assert torch.allclose(network(composite, background, depth), composite, atol=1e-5)


@pytest.mark.parametrize("head", ["light", "gain", "residual", "direct"])
@pytest.mark.parametrize("stride", [1, 2, 4, 8])
def test_shapes_at_every_stride(head: str, stride: int) -> None:
    inputs = pictures(41, 54, count=2)
    network = shaken(TINY.model_copy(update={"head": head, "stride": stride}))
    with torch.no_grad():
        image = network(*inputs)
    assert image.shape == inputs[0].shape
    assert image.min() >= 0
    assert image.max() <= 1
    assert (image - inputs[0]).abs().max() > 1e-3


def test_presets_have_their_size() -> None:
    counts = {name: sum(p.numel() for p in Compositing2D(config).parameters()) for name, config in NETWORKS.items()}
    assert 1e6 <= counts["slim"] <= 2e6
    assert round(counts["paper"] / 1e6, 2) == 2.74  # as published


def test_pictures_of_a_batch_do_not_touch() -> None:
    composite, background, depth = pictures(48, 48, count=3)
    network = shaken(TINY)
    with torch.no_grad():
        together = network(composite, background, depth)
        apart = torch.cat([network(*(x[i : i + 1] for x in (composite, background, depth))) for i in range(3)])
    assert torch.allclose(together, apart, atol=1e-5)


def test_mask_is_zero_outside_and_the_coverage_on_the_rim() -> None:
    y, x = torch.meshgrid(torch.arange(40.0), torch.arange(40.0), indexing="ij")
    coverage = (12.0 - ((x - 20) ** 2 + (y - 18) ** 2).sqrt()).clamp(0, 1)[None, None]
    background = torch.full((1, 3, 40, 40), 0.3)
    composite = coverage * torch.tensor([0.9, 0.5, 0.1]).view(1, 3, 1, 1) + (1 - coverage) * background
    mask = soft_mask(composite, background)
    assert torch.all(mask[coverage == 0] == 0)
    assert (mask - coverage).abs().max() < 0.1
    composite[..., 18, 20] = 0.3  # a pixel of the object that looks like the background
    assert soft_mask(composite, background)[0, 0, 18, 20] == 1


def test_gains_act_in_linear_light_on_the_object_alone() -> None:
    composite, background, _ = pictures(32, 32)
    mask = (composite != background).any(dim=1, keepdim=True).float()
    maps = torch.zeros(1, 12, 4, 4)
    maps[:, :3] = torch.tensor([0.5, 1.0, 0.25]).log().view(1, 3, 1, 1)
    image = apply_gains(maps, composite, background, mask)
    expected = linear_to_srgb(srgb_to_linear(composite) * torch.tensor([0.5, 1.0, 0.25]).view(1, 3, 1, 1))
    assert torch.allclose(image, torch.where(mask > 0, expected, composite), atol=1e-6)
    maps[:, 6:9] = -1.0  # a shadow on the surroundings leaves the object alone
    darker = apply_gains(maps, composite, background, mask)
    assert torch.allclose(darker[:, :, 8:16, 8:16], image[:, :, 8:16, 8:16], atol=1e-6)
    assert torch.all(darker[:, :, :8] < composite[:, :, :8])


def test_gains_on_a_half_covered_pixel_relight_its_half() -> None:
    """Half red object, half blue floor: a gain on the object must not brighten the floor's half."""
    red, blue = torch.tensor([0.4, 0.0, 0.0]).view(1, 3, 1, 1), torch.tensor([0.0, 0.0, 0.4]).view(1, 3, 1, 1)
    background = linear_to_srgb(blue.expand(1, 3, 4, 4))
    composite = linear_to_srgb(0.5 * red + 0.5 * blue).expand(1, 3, 4, 4)
    maps = torch.zeros(1, 12, 2, 2)
    maps[:, :3] = torch.tensor(2.0).log()
    image = srgb_to_linear(apply_gains(maps, composite, background, torch.full((1, 1, 4, 4), 0.5)))
    assert torch.allclose(image, (0.5 * 2 * red + 0.5 * blue).expand(1, 3, 4, 4), atol=1e-5)


def test_a_shadow_reaches_the_object_and_none_of_it_the_other() -> None:
    """Maps that are told for the surroundings alone, and for the object alone, hold up to its very outline."""
    background = torch.full((1, 3, 32, 32), 0.5)
    mask = torch.zeros(1, 1, 32, 32)
    mask[..., 8:24, 8:24] = 1.0
    composite = torch.where(mask > 0, 0.25, background)
    cells = functional.adaptive_avg_pool2d(mask, (8, 8))
    maps = torch.zeros(1, 12, 8, 8)
    maps[:, :3] = cells * math.log(2.0)
    maps[:, 6:9] = (1.0 - cells) * math.log(0.5)
    found = srgb_to_linear(apply_gains(maps, composite, background, mask)) / srgb_to_linear(composite)
    torch.testing.assert_close(found, torch.where(mask > 0, 2.0, 0.5).expand_as(found), rtol=0.02, atol=0.0)


def test_gradients_of_the_gains_are_those_of_finite_differences() -> None:
    composite, background, _ = (x.double() for x in pictures(8, 8))
    mask = torch.rand(1, 1, 8, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    maps = 0.3 * torch.randn(1, 12, 4, 4, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    maps.requires_grad_()
    assert torch.autograd.gradcheck(lambda m: apply_gains(m, composite, background, mask), (maps,))


def test_black_pixels_have_finite_gradients() -> None:
    network = shaken(TINY).train()
    composite = torch.zeros(1, 3, 32, 32)
    network(composite, composite, torch.ones(1, 1, 32, 32)).square().sum().backward()
    assert all(torch.isfinite(p.grad).all() for p in network.parameters() if p.grad is not None)


def test_windows_come_back() -> None:
    x = torch.rand(2, 8, 12, 5)
    assert torch.equal(from_windows(windows_of(x, 4), 8, 12, 4), x)
    assert torch.equal(windows_of(x, 4)[1, 1, 5], x[1, 1, 5])  # window in row 0, column 1; token in row 1, column 1


def slow_attention(layer: WindowAttention, x: Tensor, shift: int) -> Tensor:
    """Attend token by token: each looks at the tokens of its window that lie in the picture, and at the pooled ones."""
    _, h, w, c = x.shape
    n, heads = layer.window, layer.heads
    q, k, v = layer.to_qkv(x).chunk(3, dim=-1)
    pool = layer.pooled
    pooled = [t.reshape(1, pool, h // pool, pool, w // pool, c).mean(dim=(2, 4)).reshape(-1, c) for t in (k, v)]
    result = torch.zeros_like(x)
    for y in range(h):
        for z in range(w):
            tops = [(i - shift) // n for i in (y, z)]
            cells = [(a, b) for a in range(h) for b in range(w) if [(a - shift) // n, (b - shift) // n] == tops]
            offsets = [(y - a + n - 1) * (2 * n - 1) + z - b + n - 1 for a, b in cells]
            keys = torch.cat((torch.stack([k[0, a, b] for a, b in cells]), pooled[0]))
            values = torch.cat((torch.stack([v[0, a, b] for a, b in cells]), pooled[1]))
            for head in range(heads):
                part = slice(head * c // heads, (head + 1) * c // heads)
                logits = keys[:, part] @ q[0, y, z, part] / (c // heads) ** 0.5
                logits[: len(cells)] += layer.bias[offsets, head]
                result[0, y, z, part] = logits.softmax(dim=0) @ values[:, part]
    return layer.out(result)


@pytest.mark.parametrize("shifted", [False, True])
def test_attention_equals_a_slow_one(shifted: bool) -> None:
    torch.manual_seed(0)
    layer = WindowAttention(TINY)
    torch.nn.init.normal_(layer.bias)
    x = torch.randn(1, 8, 12, TINY.width)
    allowed = shift_mask(8, 12, TINY.window, x.device) if shifted else None
    with torch.no_grad():
        assert torch.allclose(layer(x, allowed), slow_attention(layer, x, 2 if shifted else 0), atol=1e-5)


def test_a_block_keeps_its_shape_and_mixes_windows_only_through_the_summary() -> None:
    torch.manual_seed(0)
    block = Block(TINY.model_copy(update={"pooled": 0}))
    x = torch.randn(1, 8, 8, TINY.width)
    changed = x.clone()
    changed[:, 0, 0] += 1.0
    with torch.no_grad():
        attended = block.attention(changed, None) - block.attention(x, None)
    assert block(x, None).shape == x.shape
    assert attended[:, :4, :4].abs().min() > 0
    assert torch.all(attended[:, 4:] == 0)
    assert torch.all(attended[:, :, 4:] == 0)


def test_statistics_say_how_object_and_surroundings_are_lit() -> None:
    """A grey square on a wall that is brighter on the left, at two sizes of the picture."""
    background = torch.full((1, 3, 128, 128), 0.5)
    background[..., :64] = 0.8
    mask = torch.zeros(1, 1, 128, 128)
    mask[..., 48:80, 80:112] = 1.0
    composite = torch.where(mask > 0, torch.tensor(0.3), background)
    found = statistics(composite, background, mask)
    assert found.shape == (1, STATISTICS)
    share, of_object, spread, around = found[0, 0], found[0, 1:4], found[0, 4:7], found[0, 7:10]
    everywhere, spread_everywhere = found[0, 19:22], found[0, 22:25]
    dim, bright = ((srgb_to_linear(torch.tensor(level)) + DARK).log() for level in (0.5, 0.8))
    torch.testing.assert_close(share, torch.tensor(1 / 16).log())
    torch.testing.assert_close(of_object, (srgb_to_linear(torch.tensor(0.3)) + DARK).log().expand(3), atol=1e-4, rtol=0)
    assert (spread < 2e-3).all()
    torch.testing.assert_close(around, dim.expand(3), atol=1e-3, rtol=0)  # the square's own half is the dim one
    torch.testing.assert_close(everywhere, ((dim + bright) / 2).expand(3), atol=1e-3, rtol=0)
    torch.testing.assert_close(spread_everywhere, ((bright - dim) / 2).expand(3), atol=1e-3, rtol=0)
    larger = (functional.interpolate(x, scale_factor=2.0) for x in (composite, background, mask))
    torch.testing.assert_close(statistics(*larger), found, atol=1e-4, rtol=0)


def test_faint_changes_far_from_the_object_are_none() -> None:
    """In use, that is; in training they are the way to larger ones."""
    composite, background, depth = pictures(64, 64)
    mask = soft_mask(composite, background)
    network = Compositing2D(TINY)
    bias = network.head.get_parameter("bias")
    with torch.no_grad():
        bias[6:9] = 0.9 * LEAST_LOG_GAIN
        bias[9:] = -0.9 * LEAST_OFFSET
        assert (network.train()(composite, background, depth, mask) != composite).any()
        torch.testing.assert_close(network.eval()(composite, background, depth, mask), composite, atol=1e-5, rtol=0)
        bias[6:9] = 3 * LEAST_LOG_GAIN
        outside = (mask == 0).expand_as(composite)
        assert (network.eval()(composite, background, depth, mask) > composite + 1e-3)[outside].float().mean() > 0.9
