"""The small scenes of the backend contract, and what they must look like, worked out without any backend.

Colours differ in every channel, so that a swapped channel shows.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from scipy import ndimage

from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.lights.spec import (
    AreaLight,
    EmissiveLight,
    EnvironmentLight,
    Light,
    LightRig,
    PointLight,
    SpotLight,
    SunLight,
)
from multilight.scenes.assets.builtin.textures.gobos import make_gobo
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, matrix4, pixel_rays
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Body, Camera, Material, Rectangle, SceneSpec, Sphere

SIZE = 48
SETTINGS = RenderSettings(spp=16, max_bounces=2, threads=2)


def tint(value: float) -> tuple[float, float, float]:
    return (value, value / 2, value / 4)


def placed(x: float, y: float, z: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = x, y, z
    return pose


def body(name: str, shape: Sphere | Rectangle, pose: np.ndarray, colour: Rgb = (0.5, 0.5, 0.5), **more: Any) -> Body:
    # An index of refraction of 1 leaves a principled surface purely diffuse.
    material = Material(base_color=colour, roughness=1.0, ior=1.0)
    fields = {"role": "object", "category": "test", "insertable": False} | more
    return Body(name=name, geometry=shape, materials=(material,), world_from_body=matrix4(pose), **fields)


GROUND = body("ground", Rectangle(width=4.0, height=3.0), np.eye(4), (0.6, 0.5, 0.4), role="support")
BALLS = (
    body("near", Sphere(radius=0.25), placed(-0.2, -0.3, 0.25), (0.7, 0.2, 0.1), insertable=True),
    body("far", Sphere(radius=0.2), placed(0.15, 0.2, 0.2), (0.1, 0.3, 0.6), insertable=True),
    body("under", Sphere(radius=0.2), placed(0.0, 0.0, -0.4), (0.9, 0.9, 0.9), insertable=True),
    body("bulb", Sphere(radius=0.15), placed(0.5, -0.4, 0.15), (0.0, 0.0, 0.0)),
)
EYE = (0.5, -2.2, 0.9)


def oblique_camera() -> Camera:
    """Look over the ground's far edge, so that a strip of environment shows."""
    return camera_from_fov(look_at(EYE, (0.0, 0.2, 0.25)), width=SIZE + 8, height=SIZE, fov=math.radians(52))


def overhead_camera() -> Camera:
    """Look straight down from two metres, +X to the right, +Y up in the picture."""
    pose = look_at((0, 0, 2.0), (0, 0, 0), up=(0, 1, 0))
    return camera_from_fov(pose, width=SIZE, height=SIZE, fov=math.radians(40))


def still_life(*, without: str | None = None) -> SceneSpec:
    bodies = tuple(b for b in (*BALLS, GROUND) if b.name != without)
    return SceneSpec(kind="spheres", index=0, bodies=bodies, cameras=(oblique_camera(), overhead_camera()))


def plate_scene(*more: Body) -> SceneSpec:
    """A ground alone under a camera that sees nothing else."""
    return SceneSpec(kind="spheres", index=1, bodies=(GROUND, *more), cameras=(overhead_camera(),))


SKY = EnvironmentLight(name="sky", radiance=(0.2, 0.3, 0.4))
SUN = SunLight(name="sun", direction=(-0.5, 0.4, -1.0), irradiance=tint(2.0), angle=0.0)
POINT = PointLight(name="point", position=(0.4, -0.8, 1.2), intensity=tint(0.8))
SPOT = SpotLight(
    name="spot", position=(-0.8, -0.5, 1.2), direction=(0.6, 0.5, -1.2), intensity=(0.3, 0.6, 0.9),
    half_angle=0.4, blend=0.3,
)  # fmt: skip
GLOW = EmissiveLight(name="glow", body="bulb", radiance=tint(4.0))
RIG = LightRig(lights=(SKY, SUN, POINT, SPOT, GLOW))


def job(variant: str = "all", *, scene: SceneSpec | None = None, rig: LightRig = RIG, view: int = 0) -> RenderJob:
    return RenderJob(scene or still_life(), rig, SETTINGS, view, variant)


@dataclass(frozen=True)
class Reference:
    """What the rays through pixel centres of the still life hit, by the quadratic formula."""

    ids: np.ndarray
    z_depth: np.ndarray
    inner: np.ndarray
    """Pixels whose neighbourhood shows the same body: away from every edge."""


def reference(scene: SceneSpec, camera: Camera) -> Reference:
    origins, rays = pixel_rays(camera)
    nearest, ids = np.full(rays.shape[:2], np.inf), np.zeros(rays.shape[:2], int)
    for item in scene.bodies:
        centre = np.array(item.world_from_body)[:3, 3]
        if isinstance(item.geometry, Sphere):
            b = np.sum(rays * (origins - centre), axis=-1)
            c = np.sum((origins - centre) ** 2, axis=-1) - item.geometry.radius**2
            root = b * b - c
            distance = np.where(root > 0, -b - np.sqrt(np.abs(root)), np.inf)
        else:
            distance = (centre - origins)[..., 2] / rays[..., 2]
            hit = np.abs(origins + distance[..., None] * rays)
            inside = (hit[..., 0] < item.geometry.width / 2) & (hit[..., 1] < item.geometry.height / 2)
            distance = np.where(inside & (distance > 0), distance, np.inf)
        closer = distance < nearest
        nearest[closer], ids[closer] = distance[closer], scene.instance_id(item.name)
    axis = -camera.pose()[:3, 2]
    z_depth = np.where(ids > 0, np.where(ids > 0, nearest, 0.0) * (rays @ axis), 0.0)
    inner = ndimage.maximum_filter(ids, 5) == ndimage.minimum_filter(ids, 5)
    return Reference(ids, z_depth, inner)


BULB_ABOVE = body("bulb", Sphere(radius=0.2), placed(1.8, 0.0, 1.2), (0.0, 0.0, 0.0))
AREA = AreaLight(
    name="panel", width=0.8, height=0.3, world_from_light=matrix4(placed(0.2, 0.1, 2.5)), radiance=tint(3.0)
)
# A lopsided distribution, dark straight ahead and straight back, so that a flipped or shifted axis shows.
PROFILE = tuple(math.sin(math.pi * (i / 36) ** 0.6) for i in range(37))
SHAPED = POINT.model_copy(update={"direction": (0.1, 0.2, -1.0), "profile": PROFILE})
GOBO = SPOT.model_copy(update={"gobo": "builtin/gobo-foliage-large", "roll": 0.5, "blend": 0.0, "half_angle": 0.5})
CLOSED_FORMS: dict[str, tuple[Light, tuple[Body, ...]]] = {
    "environment": (SKY, ()),
    "sun": (SUN, ()),
    "point": (POINT, ()),
    "spot": (SPOT, ()),
    "hard_spot": (SPOT.model_copy(update={"blend": 0.0}), ()),
    "profile": (SHAPED, ()),
    "profile_aside": (SHAPED.model_copy(update={"direction": (-1.0, 2.0, 0.3)}), ()),
    "profile_up": (SHAPED.model_copy(update={"direction": (0.0, 0.0, 1.0)}), ()),
    "gobo": (GOBO, ()),
    "emissive": (GLOW, (BULB_ABOVE,)),
    "area": (AREA, ()),
    "disk": (AREA.model_copy(update={"shape": "disk"}), ()),
}


def gobo_transmission(light: SpotLight, points: np.ndarray) -> np.ndarray:
    """What a built-in gobo lets through towards points of the ground, averaged over each overhead pixel.

    Written out for itself: right, up and the image's rows from the spec's words alone.
    """
    gobo = np.asarray(make_gobo((light.gobo or "").removeprefix("builtin/")), np.float64)
    image = np.pad(gobo / 255, 1, mode="edge")
    axis = np.array(light.direction) / math.hypot(*light.direction)
    level = np.cross(axis, (0, 0, 1.0)) / np.linalg.norm(np.cross(axis, (0, 0, 1.0)))
    steep = np.cross(level, axis)
    right = math.cos(light.roll) * level + math.sin(light.roll) * steep
    up = math.cos(light.roll) * steep - math.sin(light.roll) * level
    total, size = np.zeros(points.shape[:2]), len(image) - 2
    step = np.linalg.norm(points[0, 1] - points[0, 0]) / 4
    for dx, dy in product((-1.5, -0.5, 0.5, 1.5), repeat=2):
        way = points + np.array([dx * step, dy * step, 0]) - np.array(light.position)
        reach = (way @ axis) * math.tan(light.half_angle)
        column = (1 + way @ right / reach) / 2 * size + 0.5
        row = (1 - way @ up / reach) / 2 * size + 0.5
        total += ndimage.map_coordinates(image, [row, column], order=1, mode="nearest")
    return total / 16


def irradiance(light: Light, points: np.ndarray) -> np.ndarray:
    """Irradiance (H, W, 3) on points of the plane z = 0 facing up, from the light's own definition."""
    match light:
        case EnvironmentLight():
            return np.broadcast_to(math.pi * np.array(light.radiance), points.shape)
        case SunLight():
            cosine = -light.direction[2] / math.hypot(*light.direction)
            return np.broadcast_to(cosine * np.array(light.irradiance), points.shape)
        case PointLight() | SpotLight():
            offset = np.array(light.position) - points
            distance = np.linalg.norm(offset, axis=-1)
            strength = offset[..., 2] / distance**3
            if isinstance(light, SpotLight):
                axis = np.array(light.direction) / math.hypot(*light.direction)
                edge = math.cos(light.half_angle)
                x = (-(offset @ axis) / distance - edge) / max((1 - edge) * light.blend, 1e-9)
                x = np.clip(x, 0, 1)
                strength = strength * x * x * (3 - 2 * x)
                strength = strength * (1.0 if light.gobo is None else gobo_transmission(light, points))
            elif light.profile is not None:
                angle = np.arccos(-offset @ np.array(light.direction) / math.hypot(*light.direction) / distance)
                strength = strength * np.interp(angle, np.linspace(0, math.pi, len(light.profile)), light.profile)
            return strength[..., None] * np.array(light.intensity)
        case EmissiveLight():
            offset = np.array(BULB_ABOVE.world_from_body)[:3, 3] - points
            distance = np.linalg.norm(offset, axis=-1)
            factor = offset[..., 2] / distance**3 * BULB_ABOVE.geometry.radius**2
            return math.pi * factor[..., None] * np.array(light.radiance)
        case AreaLight():
            grid = (np.arange(40) + 0.5) / 40 - 0.5
            u, v = (g.ravel() for g in np.meshgrid(grid, grid))
            inside = (u**2 + v**2 <= 0.25) | (light.shape == "rectangle")
            cell = light.width * light.height / 1600
            centre = np.array(light.world_from_light)[:3, 3]
            total = np.zeros(points.shape[:2])
            for x, y in zip(u[inside] * light.width, v[inside] * light.height, strict=True):
                offset = centre - points + np.array([x, y, 0.0])
                total += cell * offset[..., 2] ** 2 / np.sum(offset**2, axis=-1) ** 2
            return total[..., None] * np.array(light.radiance)
    raise AssertionError(light)
