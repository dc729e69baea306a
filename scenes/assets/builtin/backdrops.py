"""A photographer's seamless backdrop: paper that runs over the floor and curves up into a wall."""

from dataclasses import dataclass

import numpy as np

from multilight.scenes.assets.builtin.primitives import Surface, from_grid, merge, rounded_box, tube
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Material

SWEEP_ID, ROLL_ID = "builtin/sweep-01", "builtin/sweep-roll-01"
TABLE_SWEEP_IDS = ("builtin/sweep-table-01", "builtin/sweep-table-02")


@dataclass(frozen=True)
class SweepSize:
    """A sweep's width, depth and height, and the radius of its bend [m]."""

    width: float
    depth: float
    height: float
    radius: float


STUDIO = SweepSize(9.0, 6.0, 4.0, 0.8)
ROLL = SweepSize(2.72, 3.2, 2.6, 0.45)
"""The usual wide paper roll, hung from a bar."""


def sweep(size: SweepSize = STUDIO) -> Surface:
    """Make the paper, centred in x and y, its floor at z = 0 and its wall at +Y; uv in metres.

    It faces up and towards -Y.
    """
    angle = np.linspace(0.0, np.pi / 2, 49)
    front, wall = -size.depth / 2, size.depth / 2
    y = np.r_[front, wall - size.radius * (1 - np.sin(angle)), wall]
    z = np.r_[0.0, size.radius * (1 - np.cos(angle)), size.height]
    tilt = np.r_[0.0, angle, np.pi / 2]
    along = np.r_[0.0, np.cumsum(np.hypot(np.diff(y), np.diff(z)))]
    x = np.array([-size.width / 2, size.width / 2])
    points = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)
    normals = np.stack(np.broadcast_arrays(np.zeros((2, 1)), -np.sin(tilt), np.cos(tilt)), axis=-1)
    uv = np.stack(np.broadcast_arrays(x[:, None], along), axis=-1)
    return from_grid(points, normals, uv)


_PAPER = Material(name="paper", base_color=(0.8, 0.8, 0.8), roughness=0.85)


def seamless_paper(_: Rng) -> list[tuple[Surface, Material]]:
    """Make the sweep of a studio, 9 m wide, 6 m deep, 4 m high; the same whatever the generator."""
    return [(sweep(), _PAPER)]


def paper_roll(_: Rng) -> list[tuple[Surface, Material]]:
    """Make the sweep of a paper roll, 2.72 m wide, and the bar it hangs from; the same whatever the generator."""
    ends = [(-ROLL.width / 2 - 0.1, 0.0, 0.0), (ROLL.width / 2 + 0.1, 0.0, 0.0)]
    bar = tube(np.array(ends), 0.03).moved((0.0, ROLL.depth / 2 + 0.031, ROLL.height))
    return [(sweep(ROLL), _PAPER), (bar, Material(name="bar", base_color=(0.3, 0.3, 0.3), roughness=0.5))]


def table_sweep(rng: Rng) -> list[tuple[Surface, Material]]:
    """Make a product table, 1.3 to 1.8 m wide, its top about 0.75 m high: a sweep on a frame."""
    size, height = table_size(float(rng.uniform(1.3, 1.8))), float(rng.uniform(0.7, 0.8))
    x, y = size.width / 2 - 0.03, size.depth / 2
    board = rounded_box((size.width, size.depth - size.radius, 0.02), 0.003)
    frame = [board.moved((0.0, -size.radius / 2, height - 0.021))]
    for side in (-1, 1):
        for end in (-y + 0.04, y - size.radius - 0.04):
            frame.append(tube(np.array([(side * x, end, 0.02), (side * x, end, height - 0.04)]), 0.016))
        post = np.array([(side * x, y + 0.02, 0.02), (side * x, y + 0.02, height + size.height)])
        foot = np.array([(side * x, y - size.radius - 0.04, 0.2), (side * x, y + 0.02, 0.2)])
        frame += [tube(post, 0.016), tube(foot, 0.012)]
    bar = np.array([(-x, y + 0.018, height + size.height), (x, y + 0.018, height + size.height)])
    steel = Material(name="frame", base_color=(0.3, 0.3, 0.3), roughness=0.4, metallic=1.0)
    return [(sweep(size).moved((0.0, 0.0, height)), _PAPER), (merge([*frame, tube(bar, 0.016)]), steel)]


def table_size(width: float) -> SweepSize:
    """Return the size of the sweep of a product table of that width [m]."""
    return SweepSize(width, 0.9 * width, 0.8 * width, 0.22 * width)
