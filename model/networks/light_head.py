"""The head that knows light: a few lights and an ambient term, guessed from the picture, that shade and cast shadows.

Two sets of lights are guessed: those of the background, and those that the object came lit by. The object is multiplied
by what surfaces facing as its do get of the one over what they get of the other; its surroundings by what the object
leaves them of the first. Maps of the network correct both.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from multilight.model.networks.shading import irradiance, normals, points, visibility

LIGHTS = 3
BASE_DIRECTIONS = ((-0.6, 0.7, 0.4), (0.6, 0.7, 0.4), (0.0, 0.9, -0.4))
BASE_SOFTNESS = (0.05, 0.15, 0.6)  # tangent of half the angular diameter: a lamp, a window, a sky
OF_LIGHT = 7  # direction, colour, softness
OF_SET = LIGHTS * OF_LIGHT + 3  # lights and the ambient term
LARGEST = 3.0  # of a guessed logarithm
KEPT = -3.0  # logit of the fraction of the object's light that is its own glow, before learning
APPARENT, RIDGE = 9, 0.02  # numbers of `apparent`, and the variance of normals below which it tells little
DARK = 0.02  # linear light below which slopes are not relative any more
CHANNELS = 4  # of the network's maps: how much of the shadow falls, and how much of the object's light is its glow


class Lights(NamedTuple):
    """Guessed lights: directions (B, K, 3) unit, towards them; colours (B, K, 3) and ambient (B, 3), what surfaces get
    of each that face it and of the rest, relative to each other; softness (B, K), tangent of half the diameter.
    """

    directions: Tensor
    colours: Tensor
    ambient: Tensor
    softness: Tensor


class Guess(NamedTuple):
    """What the head took the picture for: the background's lights, and the fraction of the object's light that is its
    own glow, (B, 1, h, w) as a logit; and the numbers (B, N) that stand for the lights, and for all else that is the
    same for the whole picture.
    """

    lights: Lights
    glow: Tensor
    numbers: Tensor


class LightHead(nn.Module):
    """From what is known of the picture to the lights, and on to logarithms of gains."""

    base: Tensor

    def __init__(self, known: int, width: int = 128) -> None:
        super().__init__()
        self.last = nn.Linear(width, 2 * OF_SET + 6 + 3)
        self.guess = nn.Sequential(
            nn.Linear(known + 2 * APPARENT, width), nn.GELU(), nn.Linear(width, width), nn.GELU()
        )
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        self.register_buffer("base", functional.normalize(torch.tensor(BASE_DIRECTIONS), dim=1), persistent=False)
        self.register_buffer("base_softness", torch.tensor(BASE_SOFTNESS), persistent=False)

    def numbers(self, known: Tensor, composite: Tensor, background: Tensor, depth: Tensor, mask: Tensor) -> Tensor:
        """Guess: known (B, F), linear pictures (B, 3, h, w), depth and mask (B, 1, h, w) → (B, N).

        The numbers stand for both sets of lights, and for all else that is the same for the whole picture.
        """
        facing = normals(points(depth))
        ground = (1.0 - mask) * (depth < 1.0)
        known = torch.cat((known, apparent(composite, facing, mask), apparent(background, facing, ground)), dim=1)
        return self.last(self.guess(known))

    def forward(self, numbers: Tensor, maps: Tensor, depth: Tensor, mask: Tensor) -> tuple[Tensor, Guess]:
        """Light: numbers (B, N), maps (B, 12 + 4, h, w), depth and mask (B, 1, h, w).

        Returns gain maps (B, 12, h, w) and what they follow from. Of the maps, the first twelve are log-gains and
        offsets, of the object and of its surroundings, to which the lights' are added.
        """
        places = points(depth)
        facing = normals(places)
        here, there = (self._lights(part) for part in numbers[:, : 2 * OF_SET].chunk(2, dim=1))
        overall, strength = numbers[:, 2 * OF_SET : -3, None, None], numbers[:, -3:, None, None]
        inner, outer, fraction = maps.split((6, 6, CHANNELS), dim=1)
        lit, came = (irradiance(facing, s.directions, s.colours, s.ambient, None) for s in (here, there))
        seen = visibility(places, mask, here.directions, here.softness)
        left = irradiance(facing, here.directions, here.colours, here.ambient, seen)
        shadow = (left / lit).log() * strength * 2.0 * fraction[:, :3].sigmoid() * (depth < 1.0)
        gain, offset = (inner + overall).chunk(2, dim=1)
        logit = fraction[:, 3:] + KEPT
        glow = logit.sigmoid()
        gain = (glow + (1.0 - glow) * (gain + (lit / came).log()).clamp(-4.0, 4.0).exp()).log()
        return torch.cat((gain, (1.0 - glow) * offset, outer[:, :3] + shadow, outer[:, 3:]), dim=1), Guess(
            here, logit, numbers
        )

    def of_one_scene(self, numbers: Tensor, rotations: Tensor) -> Tensor:
        """Agree on one set of lights for V views of a scene: numbers (V, N), rotations (V, 3, 3) camera to world.

        Returns numbers (V, N): directions are averaged in the world's axes, all else as it is.
        """
        agreed = numbers.mean(dim=0).expand_as(numbers).clone()
        for start in (0, OF_SET):
            part = slice(start, start + LIGHTS * OF_LIGHT)
            own = numbers[:, part].unflatten(1, (LIGHTS, OF_LIGHT))[..., :3]
            towards = functional.normalize(self.base + own, dim=2)  # (V, K, 3)
            mean = torch.einsum("vij,vkj->vki", rotations, towards).mean(dim=0)
            agreed[:, part].unflatten(1, (LIGHTS, OF_LIGHT))[..., :3] = (
                torch.einsum("vji,kj->vki", rotations, mean) - self.base
            )
        return agreed

    def _lights(self, told: Tensor) -> Lights:
        each, ambient = told.split((LIGHTS * OF_LIGHT, 3), dim=1)
        direction, colour, softness = each.unflatten(1, (LIGHTS, OF_LIGHT)).split((3, 3, 1), dim=2)
        return Lights(
            functional.normalize(self.base + direction, dim=2),
            colour.clamp(-LARGEST, LARGEST).exp(),
            ambient.clamp(-LARGEST, LARGEST).exp(),
            self.base_softness * softness[..., 0].clamp(-LARGEST, LARGEST).exp(),
        )


def apparent(picture: Tensor, facing: Tensor, weight: Tensor) -> Tensor:
    """Return how brightness leans on normals: (B, 9), the least-squares slopes by x, y, z, over the mean, a channel.

    picture (B, 3, h, w) linear; facing (B, 3, h, w) unit normals; weight (B, 1, h, w). Under one light and on one
    albedo that is the light's direction, as far as it is not in the ambient term.
    """
    weight = weight.flatten(2) / (weight.sum((2, 3))[..., None] + 1e-3)

    def centred(x: Tensor) -> tuple[Tensor, Tensor]:
        mean = (x.flatten(2) * weight).sum(2, keepdim=True)
        return x.flatten(2) - mean, mean

    (normal, _), (colour, mean) = centred(facing), centred(picture)
    spread, both = (torch.einsum("bin,bjn->bij", normal * weight, x) for x in (normal, colour))
    slopes = torch.linalg.solve(spread + RIDGE * torch.eye(3, device=spread.device), both)
    return (slopes / (mean.transpose(1, 2) + DARK)).flatten(1).clamp(-5.0, 5.0)
