"""What a stored rig is like: direction, size, illuminance and colour of each light, and the key-to-fill ratio."""

from dataclasses import dataclass

import numpy as np

from multilight.lights.photometry.angular_size import angular_diameter
from multilight.lights.photometry.colour import temperature_of
from multilight.lights.photometry.irradiance import LightMeter, map_directions, small_map
from multilight.lights.photometry.radiometry import photometric_from_watts
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, Light, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.colour import luminance
from multilight.scenes.frozen import Rgb, triple


@dataclass(frozen=True)
class LightMeasure:
    """One light as seen from the centre of the scene's objects.

    `azimuth` [rad] from the cameras' mean, in (-pi, pi], and `elevation` [rad] of its centre (of an environment: of
    its mean light from above); `angular_size` [rad] the diameter of a disc of the same solid angle or spread: the
    smaller, the harder its shadows. `illuminance` [lx] on level ground there, `dome` [lx] as a dome meter reads it.
    `temperature` [K] correlated, and `saturation`, the distance from white light of that temperature in CIE 1976 u'v'
    (0 white, 0.05 a pale tint, above 0.08 a strong gel).
    """

    name: str
    kind: str
    azimuth: float
    elevation: float
    angular_size: float
    illuminance: float
    dome: float
    temperature: float
    saturation: float
    shaped: bool


def measure_light(light: Light, meter: LightMeter) -> LightMeasure:
    """Measure one light from the centre of the scene's objects."""
    towards, size = _extent(light, meter)
    temperature, saturation = temperature_of(_colour(light, meter))
    azimuth = float(np.arctan2(towards[1], towards[0])) - meter.camera
    return LightMeasure(
        name=light.name,
        kind=light.kind,
        azimuth=float(np.angle(np.exp(1j * azimuth))),
        elevation=float(np.arcsin(np.clip(towards[2], -1.0, 1.0))),
        angular_size=size,
        illuminance=photometric_from_watts(meter.table_irradiance(light)),
        dome=photometric_from_watts(meter.dome_irradiance(light)),
        temperature=temperature,
        saturation=saturation,
        shaped=light.is_shaped,
    )


def _extent(light: Light, meter: LightMeter) -> tuple[Float64, float]:
    """Return the unit vector (3,) towards a light and its angular diameter [rad]."""
    match light:
        case EnvironmentLight():
            return _spread(light, meter)
        case SunLight() | PointLight() | SpotLight() | AreaLight():
            size = angular_diameter(light, meter.foot)
            assert size is not None
            towards = -np.array(light.direction) if isinstance(light, SunLight) else light.position - meter.foot
            return np.asarray(towards / np.linalg.norm(towards)), size
        case EmissiveLight():
            points = meter.glowing_triangles(light).reshape(-1, 3)
            offset = points.mean(axis=0) - meter.aim
            distance = max(float(np.linalg.norm(offset)), 1e-6)
            reach = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
            return offset / distance, 2.0 * float(np.arctan(reach / distance))


def _spread(light: EnvironmentLight, meter: LightMeter) -> tuple[Float64, float]:
    """Return the mean direction of an environment's light from above, and the disc that spreads as far.

    The directions of an even disc of half-angle a have a mean of length (1 + cos a) / 2.
    """
    directions, solid_angle = map_directions(light.rotation)
    weight = (directions[..., 2] > 0.0) * solid_angle[:, None]
    if light.map is not None:
        weight = weight * luminance(small_map(meter.library, light.map))
    mean = (weight[..., None] * directions).sum(axis=(0, 1)) / weight.sum()
    length = float(np.linalg.norm(mean))
    return mean / length, 2.0 * float(np.arccos(np.clip(2.0 * length - 1.0, -1.0, 1.0)))


def _colour(light: Light, meter: LightMeter) -> Rgb:
    """Return the colour of a light as a whole; an environment's is that of its light on level ground."""
    if not isinstance(light, EnvironmentLight) or light.map is None:
        return light.amount
    directions, solid_angle = map_directions(0.0)
    weight = np.maximum(directions[..., 2:], 0.0) * solid_angle[:, None, None]
    return triple((weight * small_map(meter.library, light.map)).sum(axis=(0, 1)) * light.radiance)
