"""A photographer's seamless backdrop: paper that runs over the floor and curves up into a wall."""

import numpy as np

from scenes.primitives import Surface, from_grid
from scenes.spec import Material

SWEEP_ID = "builtin/sweep-01"
SWEEP_WIDTH, SWEEP_DEPTH, SWEEP_HEIGHT, SWEEP_RADIUS = 9.0, 6.0, 4.0, 0.8


def sweep(*, steps: int = 48) -> Surface:
    """Make the paper, centred in x and y, its floor at z = 0 and its wall at +Y; uv in metres.

    9 m wide, 6 m deep, 4 m high, a bend of 0.8 m radius; it faces up and towards -Y.
    """
    angle = np.linspace(0.0, np.pi / 2, steps + 1)
    front, wall = -SWEEP_DEPTH / 2, SWEEP_DEPTH / 2
    y = np.r_[front, wall - SWEEP_RADIUS * (1 - np.sin(angle)), wall]
    z = np.r_[0.0, SWEEP_RADIUS * (1 - np.cos(angle)), SWEEP_HEIGHT]
    tilt = np.r_[0.0, angle, np.pi / 2]
    along = np.r_[0.0, np.cumsum(np.hypot(np.diff(y), np.diff(z)))]
    x = np.array([-SWEEP_WIDTH / 2, SWEEP_WIDTH / 2])
    points = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)
    normals = np.stack(np.broadcast_arrays(np.zeros((2, 1)), -np.sin(tilt), np.cos(tilt)), axis=-1)
    uv = np.stack(np.broadcast_arrays(x[:, None], along), axis=-1)
    return from_grid(points, normals, uv)


def seamless_paper(_: np.random.Generator) -> list[tuple[Surface, Material]]:
    """Make the sweep of plain paper; the same whatever the generator."""
    return [(sweep(), Material(name="paper", base_color=(0.8, 0.8, 0.8), roughness=0.85))]
