"""A light meter among a scene's objects: what stands before the lights, and how much light reaches the table."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from PIL import Image

from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import luminance
from multilight.scenes.geometry.rays import SceneRays, body_triangles, part_triangles
from multilight.scenes.meshes import read_only, triangle_crosses
from multilight.scenes.numbers import smoothstep
from multilight.scenes.poses import apply_pose
from multilight.scenes.spec import SceneSpec

SKY_ROWS = 32
"""Environment maps are averaged to this many rows before they are integrated."""
GLOW_DISTANCE = 0.2
"""Where the glow of an emissive body is measured: on the table, this far [m] from its centre."""

_ANGLES = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
_RING = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(8)], axis=-1)
"""Eight directions around, (8, 3)."""
Weight = Callable[[Float64], Float64]
"""Weighs light by the cosine of its direction to the vertical."""


@dataclass(frozen=True)
class LightMeter:
    """A light meter among the objects of a scene, with rays through all of it; world frame, metres.

    `foot` (3,) is the centre of the objects on the surface they stand on, `top` their greatest height [m],
    `radius` [m] that of the group seen from above; `camera` is the mean azimuth [rad] of the cameras.
    """

    scene: SceneSpec
    library: AssetLibrary
    foot: Float64
    top: float
    radius: float
    camera: float

    @classmethod
    def of(cls, scene: SceneSpec, library: AssetLibrary) -> "LightMeter":
        """Measure a scene."""
        objects = [body for body in scene.bodies if body.role == "object"]
        corners = np.concatenate([body_triangles(body, library)[0] for body in objects])
        low, high = corners.min(axis=0), corners.max(axis=0)
        foot = np.array([*(low + high)[:2] / 2, low[2]])
        eyes = np.array([camera.pose()[:3, 3] for camera in scene.cameras]) - foot
        mean = (eyes / np.linalg.norm(eyes, axis=1, keepdims=True)).mean(axis=0)
        radius = float(np.linalg.norm(corners[:, :2] - foot[:2], axis=1).max())
        return cls(scene, library, foot, float(high[2] - low[2]), radius, float(np.arctan2(mean[1], mean[0])))

    @cached_property
    def rays(self) -> SceneRays:
        """Rays through every body of the scene."""
        return SceneRays(self.scene.bodies, self.library)

    @cached_property
    def fixed_rays(self) -> SceneRays:
        """Rays through every body but the objects."""
        return SceneRays([body for body in self.scene.bodies if body.role != "object"], self.library)

    @property
    def aim(self) -> Float64:
        """Where lamps point: above the foot, at a third of the greatest height, (3,)."""
        return self.foot + np.array([0.0, 0.0, self.top / 3])

    @cached_property
    def probes(self) -> Float64:
        """Points just above the still life and around it on the table, that a lamp must mostly see, (N, 3)."""
        around = self.foot + 0.6 * self.radius * _RING + np.array([0.0, 0.0, 0.02])
        above = self.foot + 0.4 * self.radius * _RING + np.array([0.0, 0.0, self.top + 0.02])
        return np.concatenate([around, above])

    def open_fraction(self, directions: Float64) -> Float64:
        """Return for directions (N, 3) the fraction of the probes from which nothing stands in that direction."""
        probes = self.probes
        origins = np.repeat(probes[None], len(directions), axis=0).reshape(-1, 3)
        hit, _ = self.rays.first_hit(origins, np.repeat(directions, len(probes), axis=0))
        return np.asarray((hit < 0).reshape(len(directions), len(probes)).mean(axis=1))

    def seen_fraction(self, position: Float64) -> float:
        """Return the fraction of the probes that a lamp at `position` (3,) reaches."""
        return float(self.rays.sees(position, self.probes).mean())

    def table_irradiance(self, light: Light) -> float:
        """Return the irradiance [W/m², luminance-weighted] of a light on the table at `foot`, facing up.

        The objects' own shadows are left out; walls count for the environment. For emissive bodies it is the
        mean over a circle of `GLOW_DISTANCE` about the body, on the surface.
        """
        return self._metered(light, lambda cosine: np.maximum(cosine, 0.0))

    def dome_irradiance(self, light: Light) -> float:
        """Return what a photographer's dome meter reads at `foot`, in the unit of `table_irradiance`.

        It weighs light from an angle to the vertical by (1 + cos) / 2 (a cardioid, as incident-light meters have),
        so that a low sun counts for the upright surfaces that it lights.
        """
        return self._metered(light, lambda cosine: (1.0 + cosine) / 2.0)

    def _metered(self, light: Light, weight_of: Weight) -> float:
        match light:
            case EnvironmentLight():
                return self._sky_irradiance(light, weight_of)
            case SunLight():
                direction = np.array(light.direction)
                return light.grey * float(weight_of(-direction[2] / np.linalg.norm(direction)))
            case PointLight() | SpotLight():
                offset = np.array(light.position) - self.foot
                distance = float(np.linalg.norm(offset))
                intensity = light.grey * self._relative_intensity(light, -offset / distance)
                return intensity * float(weight_of(offset[2] / distance)) / distance**2
            case AreaLight():
                return self._area_irradiance(light, weight_of)
            case EmissiveLight():
                return self._glow_irradiance(light)

    def _relative_intensity(self, light: PointLight | SpotLight, leaving: Float64) -> float:
        """Return a lamp's intensity in a direction over its greatest; a gobo counts with its mean."""
        offset = np.array(light.direction)
        angle = float(np.arccos(np.clip(leaving @ offset / np.linalg.norm(offset), -1.0, 1.0)))
        if isinstance(light, PointLight):
            profile = light.profile or (1.0, 1.0)
            return float(np.interp(angle, np.linspace(0.0, np.pi, len(profile)), profile))
        mean = 1.0 if light.gobo is None else image_mean(self.library, light.gobo)
        edge = np.cos(light.half_angle)
        t = np.clip((np.cos(angle) - edge) / max((1.0 - edge) * light.blend, 1e-9), 0.0, 1.0)
        return mean * float(smoothstep(t))

    def _sky_irradiance(self, light: EnvironmentLight, weight_of: Weight) -> float:
        """Sum radiance times cosine over the directions in which nothing but objects stands."""
        sky = np.ones((SKY_ROWS, 2 * SKY_ROWS, 3)) if light.map is None else small_map(self.library, light.map)
        directions, solid_angle = map_directions(light.rotation)
        weight = weight_of(directions[..., 2]) * solid_angle[:, None]
        flat = directions.reshape(-1, 3)
        origin = np.broadcast_to(self.foot + np.array([0.0, 0.0, 0.01]), flat.shape)
        hit, _ = self.fixed_rays.first_hit(origin, flat)
        open_sky = (hit < 0).reshape(weight.shape)
        return float((luminance(sky * np.array(light.radiance)) * weight * open_sky).sum())

    def _area_irradiance(self, light: AreaLight, weight_of: Weight) -> float:
        """Treat the lamp as 8 x 8 small ones (ellipses: those inside)."""
        pose = np.array(light.world_from_light)
        grid = (np.arange(8) + 0.5) / 8 - 0.5
        x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
        keep = np.hypot(x, y) <= 0.5 if light.shape == "disk" else np.full(x.shape, True)
        flat = np.column_stack([x * light.width, y * light.height, np.zeros(64)])[keep]
        offset = self.foot - apply_pose(pose, flat)
        distance = np.linalg.norm(offset, axis=1)
        emitted = np.maximum(offset @ -pose[:3, 2] / distance, 0.0)
        received = weight_of(-offset[:, 2] / distance)
        return float(light.grey * light.area * (emitted * received / distance**2).mean())

    def _glow_irradiance(self, light: EmissiveLight) -> float:
        """Sum over the triangles of the glowing part, as if nothing stood in between."""
        triangles = self.glowing_triangles(light)
        a, b, c = np.moveaxis(triangles, 1, 0)
        centre = (a + b + c) / 3
        normal = triangle_crosses(triangles) / 2
        below = np.array([*centre.mean(axis=0)[:2], self.foot[2]])
        offset = (below + GLOW_DISTANCE * _RING)[:, None] - centre
        distance = np.linalg.norm(offset, axis=-1)
        emitted = np.maximum((offset * normal).sum(axis=-1), 0.0) / distance
        received = np.maximum(-offset[..., 2], 0.0) / distance
        return float(light.grey * (emitted * received / distance**2).sum(axis=1).mean())

    def glowing_triangles(self, light: EmissiveLight) -> Float64:
        """Return the triangles (F, 3, 3) of the part that glows, in the world."""
        return part_triangles(self.scene.body(light.body), light.part, self.library)


def small_map(library: AssetLibrary, environment: str) -> Float64:
    """Read an environment map, averaged to `SKY_ROWS` x 2 `SKY_ROWS` pixels: (rows, columns, 3) float64."""
    return _small_map(library.environment_path(environment))


@lru_cache(maxsize=256)
def _small_map(path: Path) -> Float64:
    image = read_environment(path).astype(np.float64)
    rows = np.array_split(image, SKY_ROWS, axis=0)
    columns = [np.array_split(row.mean(axis=0), 2 * SKY_ROWS, axis=0) for row in rows]
    return read_only(np.array([[cell.mean(axis=0) for cell in row] for row in columns]))


def map_directions(rotation: float) -> tuple[Float64, Float64]:
    """Return the world directions (rows, columns, 3) of a small map's pixels and their solid angles (rows,) [sr].

    The convention is that of `lights.spec.EnvironmentLight`.
    """
    edges = np.pi / 2 - np.pi * np.arange(SKY_ROWS + 1) / SKY_ROWS
    latitude = (edges[:-1] + edges[1:]) / 2
    longitude = np.pi - np.pi * (np.arange(2 * SKY_ROWS) + 0.5) / SKY_ROWS + rotation
    ring = np.stack([np.cos(longitude), np.sin(longitude)], axis=-1)
    flat = np.cos(latitude)[:, None, None] * ring
    height = np.broadcast_to(np.sin(latitude)[:, None, None], (*flat.shape[:2], 1))
    solid_angle = (np.sin(edges[:-1]) - np.sin(edges[1:])) * np.pi / SKY_ROWS
    return np.concatenate([flat, height], axis=-1), solid_angle


def image_mean(library: AssetLibrary, image: str) -> float:
    """Return the mean of a gobo's linear transmission."""
    with Image.open(library.texture_path(image)) as picture:
        return float(np.asarray(picture.convert("L"), np.float64).mean() / 255.0)
