"""Light on what a depth map shows: where its points lie, which way they face, and the shadow that an object casts.

All in the camera's OpenGL axes (+X right, +Y up, looks along -Z), for a lens of `FOCAL` picture sides: another lens, or
a principal point elsewhere, only maps space linearly, under which rays stay rays and shadows fall where they fell.

Shape letters: B pictures, K lights, h w pixels, V levels of blur, one below the other.
"""

import functools
import math
from collections.abc import Iterable

import torch
from torch import Tensor
from torch.nn import functional

FOCAL = 1.1  # of the longer side: 35 mm on full frame is 0.97, 50 mm is 1.39
STEPS = 12  # along a ray, on its way past the object
BLUR, LEVELS = 0.5, 4  # pixels of the sharpest level's standard deviation, and levels; each is `WIDER` times as blurred
WIDER = 2.5
LEAST_DEPTH = 1e-3  # relative depth


def points(depth: Tensor, focal: float | Tensor = FOCAL) -> Tensor:
    """Return what pixels show: depth (B, 1, h, w) along the optical axis → (B, 3, h, w)."""
    h, w = depth.shape[-2:]
    z = depth.clamp(min=LEAST_DEPTH)
    x = (torch.arange(w, device=depth.device) + 0.5 - w / 2) / (focal * max(h, w))
    y = (torch.arange(h, device=depth.device) + 0.5 - h / 2) / (focal * max(h, w))
    return torch.cat((x[None, None, None, :] * z, -y[None, None, :, None] * z, -z), dim=1)


def normals(places: Tensor) -> Tensor:
    """Return the unit normals of places (B, 3, h, w), on the camera's side: (B, 3, h, w).

    Of the differences to both neighbours the one with less depth is taken, so that outlines do not bend them.
    """

    def slope(dim: int) -> Tensor:
        step = places.diff(dim=dim)
        first, last = (step.narrow(dim, at, 1) for at in (0, step.shape[dim] - 1))
        ahead, back = torch.cat((step, last), dim), torch.cat((first, step), dim)
        return torch.where(ahead[:, 2:].abs() < back[:, 2:].abs(), ahead, back)

    return functional.normalize(torch.linalg.cross(slope(2), slope(3), dim=1), dim=1)


def visibility(
    places: Tensor, mask: Tensor, directions: Tensor, softness: Tensor, focal: float | Tensor = FOCAL
) -> Tensor:
    """Return how much of each light the object leaves to each place: (B, K, h, w) in [0, 1].

    places (B, 3, h, w) as `points` gives them; mask (B, 1, h, w), where the object is; directions (B, K, 3), unit,
    towards the lights; softness (B, K), the tangent of half a light's angular diameter. Along each place's ray, on its
    stretch past the object, what the picture shows there is looked up: the light is blocked behind the object's front,
    as far as the object is deep (as deep as it is wide, thinner towards its outline, like a sphere). The further the
    object, the more is it blurred.
    """
    shape = _Shape.of(places, mask, focal)
    h, w = places.shape[-2:]
    middle = torch.einsum("bchw,bkc->bkhw", shape.centre[:, :, None, None] - places, directions)
    near = (middle - shape.radius).clamp(min=0.0)
    length = (middle + shape.radius - near).clamp(min=0.0)

    def hidden(part: float | Tensor) -> Tensor:
        """Return what the object hides at a part of the stretches: (B, K, h, w)."""
        along = near + length * part
        x, y, z = (places[:, None, axis] + along * directions[:, :, axis, None, None] for axis in range(3))
        ahead = (-z).clamp(min=LEAST_DEPTH)
        across = focal * max(h, w) / ahead  # pixels a length
        x, y = w / 2 + x * across, h / 2 - y * across
        cover, front = shape.seen(x, y, (0.5 / BLUR) * softness[:, :, None, None] * along * across)
        edge = 0.05 * shape.width
        depth_there = (2 * (shape.middle - front)).clamp(min=0.3 * shape.width)
        behind = ((ahead - front) / edge).sigmoid() * ((front + depth_there - ahead) / edge).sigmoid()
        return cover * behind * ((x > 0) & (x < w) & (y > 0) & (y < h) & (along > 0))

    with torch.no_grad():  # what hides most has the only gradient
        most, where = torch.zeros_like(middle), torch.zeros_like(middle)
        for step in range(STEPS):
            part = (step + 0.5) / STEPS
            found = hidden(part)
            where = torch.where(found > most, part, where)
            most = torch.maximum(found, most)
    return 1.0 - hidden(where)


class _Shape:
    """An object as the camera sees it: its front, blurred more and more, and a guess of what is behind."""

    def __init__(self, levels: Tensor, centre: Tensor, radius: Tensor, width: Tensor, middle: Tensor) -> None:
        self.levels = levels  # (B, 2, V h, w): coverage, and the front's depth, carried on past the outline
        self.centre = centre  # (B, 3)
        self.radius = radius  # (B, 1, 1, 1) of a ball about the centre that holds the object
        self.width = width  # (B, 1, 1, 1): half of it
        self.middle = middle  # (B, 1, 1, 1): depth at which it is as deep again as it is in front

    @classmethod
    def of(cls, places: Tensor, mask: Tensor, focal: float | Tensor) -> "_Shape":
        h, w = mask.shape[-2:]
        front = -places[:, 2:]
        total = mask.sum((2, 3), keepdim=True) + 1e-6
        area = (mask * (front / (focal * max(h, w))) ** 2).sum((2, 3), keepdim=True)
        width = (area / torch.pi + 1e-12).sqrt()
        mean = (mask * places).sum((2, 3), keepdim=True) / total
        middle = -mean[:, 2:] + 2 / 3 * width  # of a ball the visible side lies two thirds of its radius before it
        centre = torch.cat((mean[:, :2] * middle / (-mean[:, 2:]).clamp(min=LEAST_DEPTH), -middle), dim=1)
        spread = (((places - mean) ** 2).sum(1, keepdim=True) * mask).sum((2, 3), keepdim=True) / total
        radius = 2.0 * (spread + 1e-12).sqrt() + 0.5 * width
        both, levels = torch.cat((mask, mask * front), dim=1), []
        for number in range(LEVELS):
            blurred = blur(both, BLUR * WIDER**number)
            levels.append(torch.cat((blurred[:, :1], blurred[:, 1:] / (blurred[:, :1] + 1e-6)), dim=1))
        return cls(torch.cat(levels, dim=2), centre[:, :, 0, 0], radius, width, middle)

    def seen(self, x: Tensor, y: Tensor, blur: Tensor) -> Iterable[Tensor]:
        """Look up coverage and front at pixels x, y, `blur` times as blurred as the sharpest level; shapes alike."""
        width, height = self.levels.shape[3], self.levels.shape[2] // LEVELS
        level = (blur.clamp(min=1.0).log() / math.log(WIDER)).clamp(max=LEVELS - 1)
        sharper = level.detach().floor().clamp(max=LEVELS - 2)
        across = 2 * x / width - 1
        down = y.clamp(0.5, height - 0.5) + sharper * height
        found = []
        for further in range(2):  # levels one below the other: two dimensions are looked up sooner than three
            grid = torch.stack((across, (down + further * height) * (2 / (LEVELS * height)) - 1), dim=-1)
            seen = functional.grid_sample(self.levels, grid.flatten(1, 2), align_corners=False, padding_mode="border")
            found.append(seen.unflatten(2, x.shape[1:3]))
        sharp, blurred = found
        return torch.lerp(sharp, blurred, (level - sharper)[:, None]).unbind(1)


def blur(picture: Tensor, sigma: float) -> Tensor:
    """Blur (B, C, h, w) with a Gaussian of `sigma` pixels; beyond the border lies nothing."""
    kernel = _gaussian(sigma).to(picture)
    channels, reach = picture.shape[1], len(kernel) // 2
    for dims, padding in (((1, 1, 1, -1), (0, reach)), ((1, 1, -1, 1), (reach, 0))):
        weight = kernel.reshape(dims).expand(channels, -1, -1, -1)
        picture = functional.conv2d(picture, weight, padding=padding, groups=channels)
    return picture


@functools.cache
def _gaussian(sigma: float) -> Tensor:
    with torch.inference_mode(False):  # kept, so a training may use what an inference was the first to ask for
        reach = max(1, round(2.5 * sigma))
        weights = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / sigma) ** 2)
        return weights / weights.sum()


def irradiance(facing: Tensor, directions: Tensor, colours: Tensor, ambient: Tensor, seen: Tensor | None) -> Tensor:
    """Light surfaces: (B, 3, h, w), in the unit of what is told.

    facing (B, 3, h, w) unit normals; directions (B, K, 3) unit, towards the lights; colours (B, K, 3), what a surface
    gets that faces a light; ambient (B, 3), what all get; seen (B, K, h, w), how much of each arrives (None: all).
    """
    cosine = torch.einsum("bchw,bkc->bkhw", facing, directions).clamp(min=0.0)
    if seen is not None:
        cosine = cosine * seen
    return ambient[:, :, None, None] + torch.einsum("bkhw,bkc->bchw", cosine, colours)
