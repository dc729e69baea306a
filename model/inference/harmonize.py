"""Harmonize single pictures of any size with a trained network."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import interpolate

from multilight.datagen.errors import UserError
from multilight.model.device import chosen_device
from multilight.model.networks.checkpoint import load_network
from multilight.model.networks.compositing2d import GAIN_HEADS, Compositing2D, apply_gains, soft_mask
from multilight.scenes.arrays import Float32, Float64

Harmonizer = Callable[[Float32, Float32, Float32, Float32], Float32]
"""Composite and background (H, W, 3), display-encoded, depth and mask (H, W), all in [0, 1] → picture (H, W, 3)."""

LIT = 128
"""Longest side in pixels at which guessed lights shade and cast shadows."""
WHOLE = 512
"""Longest side in pixels of the tiles of other networks."""
OVERLAP = 64
"""Pixels that neighbouring tiles share; across them, one fades into the other."""


def network_harmonizer(weights: Path, device: str = "auto") -> Harmonizer:
    """Load trained weights, a file or ready-made ones by name, as a function from pictures to the harmonized one."""
    network = load_network(weights).to(chosen_device(device))
    return lambda composite, background, depth, mask: harmonize(network, composite, background, depth, mask=mask)


@torch.inference_mode()
def harmonize(
    network: Compositing2D,
    composite: Float32,
    background: Float32,
    depth: Float32,
    *,
    mask: Float32 | None = None,
    numbers: Tensor | None = None,
) -> Float32:
    """Harmonize a picture of any size: (H, W, 3) and (H, W) float32 → (H, W, 3) float32 in [0, 1].

    Beyond `network.size` pixels, a network that predicts gains looks at the picture made smaller, its lights shade and
    cast shadows on `LIT` pixels, and gains, which are smooth, are applied at full size; any other network works tile by
    tile beyond `WHOLE` pixels. `mask` (H, W), where given, replaces the one that the network makes of the difference of
    composite and background; `numbers` (1, N), where given, are those of a guess of the lights that was made before.
    Raises `UserError` where memory runs out or the result is not finite.
    """
    device = next(network.parameters()).device
    pictures = [_tensor(p, device) for p in (composite, background, depth)]
    given = None if mask is None else _tensor(mask, device)
    pictures = list(network.shown(pictures[0], pictures[1], pictures[2], given))
    try:
        gains = network.config.head in GAIN_HEADS
        if max(composite.shape[:2]) <= (network.size if gains else WHOLE):
            result = network(*pictures, given, numbers=numbers)
        else:
            # Of the whole picture: at a tile's border it would differ from its neighbour's.
            given = soft_mask(pictures[0], pictures[1]) if given is None else given
            result = (
                _from_reduced(network, pictures, given, numbers) if gains else _from_tiles(network, pictures, given)
            )
    except RuntimeError as error:
        if not isinstance(error, torch.OutOfMemoryError) and "allocate memory" not in str(error):
            raise
        height, width = composite.shape[:2]
        raise UserError(
            f"{height} x {width} pixels do not fit in the memory of device {device}: {str(error).splitlines()[0]}; "
            "try --device cpu, or smaller pictures"
        ) from None
    found = result[0].permute(1, 2, 0).float().cpu().numpy()
    if not np.isfinite(found).all():
        raise UserError("the network's output holds NaN: the weights are damaged or their training diverged")
    return found


@torch.inference_mode()
def lights_of_views(
    network: Compositing2D,
    composites: Sequence[Float32],
    backgrounds: Sequence[Float32],
    depths: Sequence[Float32],
    masks: Sequence[Float32],
    rotations: Float64,
) -> list[Tensor | None]:
    """Guess one set of lights for V views of a scene.

    Pictures are such as `harmonize` takes, rotations (V, 3, 3) lead from the camera's axes (OpenGL) to the world's.
    Returns for each view what to give `harmonize` as `numbers`: None where the object is not seen, and everywhere for a
    network whose head guesses no lights.
    """
    device = next(network.parameters()).device
    seen = [number for number, mask in enumerate(masks) if mask.max() > 0]
    found: list[Tensor | None] = [None] * len(masks)
    if network.config.head != "light" or not seen:
        return found
    guesses = []
    for number in seen:
        views = (composites[number], backgrounds[number], depths[number], masks[number])
        _, guess = network(*_reduced([_tensor(view, device) for view in views], network.size), told=True)
        guesses.append(guess.numbers)
    turned = torch.from_numpy(np.asarray(rotations, np.float32)[seen]).to(device)
    agreed = network.light.of_one_scene(torch.cat(guesses), turned)
    for number, view in zip(seen, agreed, strict=True):
        found[number] = view[None]
    return found


def _from_reduced(network: Compositing2D, pictures: list[Tensor], mask: Tensor, numbers: Tensor | None) -> Tensor:
    composite, background, depth = pictures
    small = _reduced([*pictures, mask], network.size)
    fine = None
    if network.config.head == "light":
        size = _size_within(depth, LIT)
        fine = (interpolate(depth, size=size, mode="nearest-exact"), interpolate(mask, size=size, mode="area"))
    maps, _ = network.predict(small[0], small[1], small[2], small[3], numbers=numbers, fine=fine)
    return apply_gains(maps, composite, background, mask).clamp(0.0, 1.0)


def _reduced(pictures: Sequence[Tensor], longest: int) -> list[Tensor]:
    """Average pictures (1, C, H, W) of one size down to sides of at most `longest` pixels."""
    size = _size_within(pictures[0], longest)
    return [interpolate(picture, size=size, mode="area") for picture in pictures]


def _size_within(picture: Tensor, longest: int) -> tuple[int, int]:
    """Return height and width of a picture (1, C, H, W) whose sides are made at most `longest` pixels."""
    height, width = picture.shape[-2:]
    scale = min(1.0, longest / max(height, width))
    return max(1, round(height * scale)), max(1, round(width * scale))


def _from_tiles(network: Compositing2D, pictures: list[Tensor], mask: Tensor) -> Tensor:
    height, width = pictures[0].shape[-2:]
    total, weight = torch.zeros_like(pictures[0]), torch.zeros_like(pictures[0][:, :1])
    for top in _starts(height):
        for left in _starts(width):
            window = (..., slice(top, top + WHOLE), slice(left, left + WHOLE))
            tile = [picture[window] for picture in pictures]
            fade = _fade(tile[0].shape[-2:]).to(total)
            total[window] += fade * network(*tile, mask[window])
            weight[window] += fade
    return total / weight


def _starts(length: int) -> list[int]:
    """Return where tiles begin: evenly spread, the last one ending with the picture."""
    if length <= WHOLE:
        return [0]
    count = -(-(length - OVERLAP) // (WHOLE - OVERLAP))
    return [round(k * (length - WHOLE) / (count - 1)) for k in range(count)]


def _fade(size: torch.Size) -> Tensor:
    """Return a tile's weights (h, w): rising from its border over the overlap, never zero."""
    ramps = []
    for length in size:
        place = torch.arange(length) + 0.5
        ramps.append((torch.minimum(place, length - place) / OVERLAP).clamp(max=1.0))
    return torch.minimum(ramps[0][:, None], ramps[1][None, :])


def _tensor(picture: Float32, device: torch.device) -> Tensor:
    planes = picture[None] if picture.ndim == 2 else picture.transpose(2, 0, 1)
    return torch.from_numpy(np.array(planes, np.float32))[None].to(device)
