"""How large a light looks from a place: the smaller, the harder the shadows it casts there."""

import numpy as np
from numpy.typing import ArrayLike

from multilight.lights.spec import AreaLight, Light, PointLight, SpotLight, SunLight


def angular_diameter(light: Light, place: ArrayLike) -> float | None:
    """Return the diameter [rad] of the disc that a lamp or a sun looks like from `place` (3,) [m].

    A panel counts as a disc of the same area, rotated to face the place. None for environments and glowing bodies,
    whose extent stands in their maps and meshes.
    """
    match light:
        case SunLight():
            return light.angle
        case PointLight() | SpotLight():
            distance = float(np.linalg.norm(np.array(light.position) - np.asarray(place)))
            return 2.0 * float(np.arctan(light.radius / distance))
        case AreaLight():
            pose = np.array(light.world_from_light)
            offset = pose[:3, 3] - np.asarray(place)
            distance = float(np.linalg.norm(offset))
            cosine = abs(float(pose[:3, 2] @ offset)) / distance
            return 2.0 * float(np.arctan(np.sqrt(light.area * cosine / np.pi) / distance))
    return None
