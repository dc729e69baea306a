"""The simplest scene: diffuse spheres on a ground, for the closed-form renderer."""

import colorsys
import math

import numpy as np

from multilight.scenes.cameras.pinhole import camera_from_fov, look_at
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import direction_from, matrix4, translation
from multilight.scenes.random_streams import Rng, Streams
from multilight.scenes.spec import Body, Camera, Material, Rectangle, SceneSpec, Sphere

FIELD_OF_VIEW = math.radians(36.0)
GROUND_SIZE = 6.0
"""Metres; large enough that its edge is far behind the spheres."""
INSERTABLE = 3
_ARCS = 24
_GAP = 0.015
"""Smallest gap between two spheres, metres."""


def sample_spheres(streams: Streams, *, index: int, width: int, height: int, views: int) -> SceneSpec:
    """Draw 4 to 7 diffuse spheres of varied size and colour that rest on a ground without touching.

    The first three are insertable. The cameras run on an arc from distant to close, all spheres in frame.
    """
    rng = streams("spheres")
    spheres = _place(rng, int(rng.integers(4, 8)))
    bodies = tuple(
        Body(
            name=f"sphere_{i}",
            role="object",
            category="sphere",
            geometry=Sphere(radius=radius),
            # Of any hue, neither black nor brighter than paint.
            materials=(_diffuse(colorsys.hsv_to_rgb(rng.uniform(), rng.uniform(0.2, 0.85), rng.uniform(0.35, 0.85))),),
            world_from_body=matrix4(translation((x, y, radius))),
            insertable=i < INSERTABLE,
        )
        for i, (x, y, radius) in enumerate(spheres)
    )
    grey = float(rng.uniform(0.25, 0.6))
    ground = Body(
        name="ground",
        role="support",
        category="ground",
        geometry=Rectangle(width=GROUND_SIZE, height=GROUND_SIZE),
        materials=(_diffuse((grey, grey, grey)),),
        world_from_body=matrix4(np.eye(4)),
    )
    cameras = _arc(streams("cameras"), np.array(spheres), width=width, height=height, views=views)
    return SceneSpec(kind="spheres", index=index, bodies=(*bodies, ground), cameras=cameras)


def _place(rng: Rng, count: int) -> list[tuple[float, float, float]]:
    """Draw (x, y, radius) in metres, largest distances between neighbours a few centimetres."""
    placed: list[tuple[float, float, float]] = []
    spread = 0.15
    while len(placed) < count:
        radius = float(rng.uniform(0.04, 0.11))
        x, y = (float(v) for v in rng.uniform(-spread, spread, 2))
        # Two spheres on the ground touch where the distance between their feet is 2 sqrt(r1 r2).
        if all(math.hypot(x - u, y - v) >= 2.0 * math.sqrt(radius * r) + _GAP for u, v, r in placed):
            placed.append((x, y, radius))
        else:
            spread += 0.005  # each refusal widens the field a little, so that the loop ends
    return placed


def _diffuse(colour: Rgb) -> Material:
    """Return a plain diffuse material: an index of refraction of 1 leaves the principled model no gloss."""
    return Material(name="diffuse", base_color=colour, roughness=1.0, ior=1.0)


def _arc(rng: Rng, spheres: np.ndarray, *, width: int, height: int, views: int) -> tuple[Camera, ...]:
    """Place the cameras on the one of several random arcs whose views hide the least of any sphere."""
    arcs = [_random_arc(rng, spheres, width=width, height=height, views=views) for _ in range(_ARCS)]
    return max(arcs, key=lambda arc: min(_clearness(camera, spheres) for camera in arc))


def _random_arc(rng: Rng, spheres: np.ndarray, *, width: int, height: int, views: int) -> tuple[Camera, ...]:
    """Draw an arc: azimuth, height and distance run evenly from a far view to the closest that shows all."""
    feet, radii = spheres[:, :2], spheres[:, 2]
    flat = (np.min(feet - radii[:, None], axis=0) + np.max(feet + radii[:, None], axis=0)) / 2
    centre = np.array([*flat, radii.mean()])
    reach = float(np.max(np.linalg.norm(spheres - centre, axis=1) + radii))
    narrow = math.atan(math.tan(FIELD_OF_VIEW / 2) * min(width, height) / max(width, height))
    close = 1.03 * reach / math.sin(narrow)
    start, sweep = rng.uniform(0.0, 2.0 * math.pi), rng.choice([-1.0, 1.0]) * rng.uniform(1.2, 2.4)
    cameras = []
    for t in np.linspace(0.0, 1.0, views):
        azimuth, elevation = start + sweep * t, math.radians(40.0 - 14.0 * t)
        pose = look_at(centre + close * (2.0 - t) * direction_from(azimuth, elevation), centre)
        cameras.append(camera_from_fov(pose, width=width, height=height, fov=FIELD_OF_VIEW))
    return tuple(cameras)


def _clearness(camera: Camera, spheres: np.ndarray) -> float:
    """Return how far the worst hidden sphere's centre lies outside the one before it, in radii of the hidden one.

    A sphere that rests on the ground has its centre at (x, y, radius): each row of `spheres` is its own centre.
    """
    offsets = spheres - camera.pose()[:3, 3]
    distance = np.linalg.norm(offsets, axis=1)
    size = np.arcsin(spheres[:, 2] / distance)
    directions = offsets / distance[:, None]
    apart = np.arccos(np.clip(directions @ directions.T, -1.0, 1.0))
    before = distance[None, :] < distance[:, None]
    clear = (apart - size[None, :]) / size[:, None]
    return float(np.min(clear[before], initial=1.0))
