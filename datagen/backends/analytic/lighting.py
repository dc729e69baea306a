"""Irradiance on points of the scene from each kind of light, in closed form, direct light only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.analytic.shapes import Ball, Plate, Shape, column, dot
from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.spec import SceneSpec, Sphere


@dataclass(frozen=True)
class SurfacePoints:
    """Points on surfaces: `places`, `normals` (3, N), metres and unit vectors towards the camera; `owners` (N,), the
    instance id of the body each lies on."""

    places: Float64
    normals: Float64
    owners: NDArray[np.uint16]

    def directions_to(self, place: Float64) -> tuple[Float64, Float64]:
        """Return unit vectors (3, N) to a place (3, 1), and its distances (N,)."""
        offsets = place - self.places
        distance = np.sqrt(dot(offsets, offsets))
        return offsets / distance, distance

    def form_factor_of(self, shape: Shape) -> Float64:
        """Return the fraction of each point's hemisphere, weighted by its cosine, that another body fills, (N,)."""
        factor, other = np.zeros(self.owners.size), self.owners != shape.number
        factor[other] = shape.form_factor(self.places[:, other], self.normals[:, other])
        return factor


def check_lights(rig: LightRig, scene: SceneSpec) -> None:
    """Raise `BackendError` naming the first light that has no closed form here."""
    for light in rig.lights:
        match light:
            case SunLight() | PointLight(profile=None) | SpotLight(gobo=None) | EnvironmentLight(map=None):
                continue
            case EmissiveLight(body=name) if name not in [body.name for body in scene.bodies]:
                raise BackendError(f"light {light.name!r} glows on {name!r}, which the scene does not hold")
            case EmissiveLight(body=name, texture=None) if isinstance(scene.body(name).geometry, Sphere):
                continue
            case EnvironmentLight():
                reason = f"the environment map {light.map!r}: the analytic renderer knows uniform ones only"
            case PointLight():
                reason = "an intensity profile: the analytic renderer knows even points only"
            case SpotLight():
                reason = f"the gobo {light.gobo!r}: the analytic renderer projects no images"
            case EmissiveLight():
                reason = f"the glowing body {light.body!r}: the analytic renderer lets only spheres glow, evenly"
            case _:
                reason = f"the kind {light.kind!r}, which has no closed form in the analytic renderer"
        raise BackendError(f"light {light.name!r} has {reason}; use the renderer cycles for it")


def exitance_share(light: Light, shapes: Sequence[Shape], points: SurfacePoints) -> Float64:
    """Return irradiance / pi for a light of unit colour: times albedo and colour it is the outgoing radiance.

    Returns (N,) in the unit that makes radiance from the light's quantity:

    - sun: E cos(theta) / pi; point: I cos(theta) / (pi d^2); spot: the same times its fall-off.
    - uniform environment: 1 minus the other bodies' form factors, without spheres whose centre is behind a
      rectangle. Exact where bodies do not overlap as seen from the point; where they do, the overlap is counted
      twice, down to zero and no further.
    - glowing sphere: its form factor, horizon included; hidden as a whole where its centre is hidden, zero where it has
      been removed.
    """
    match light:
        case SunLight():
            towards = np.broadcast_to(-column(light.direction) / math.hypot(*light.direction), points.places.shape)
            share = np.maximum(dot(towards, points.normals), 0.0) / math.pi
            _darken(share, shapes, points, towards, np.inf)
        case PointLight() | SpotLight():
            offset = column(light.position) - points.places
            towards, distance = points.directions_to(column(light.position))
            share = np.maximum(dot(towards, points.normals), 0.0) / (math.pi * dot(offset, offset))
            if isinstance(light, SpotLight):
                axis = column(light.direction) / math.hypot(*light.direction)
                share *= spot_falloff(-dot(axis, towards), light.half_angle, light.blend)
            _darken(share, shapes, points, towards, distance)
        case EnvironmentLight():
            share = np.ones(points.owners.size)
            plates = [shape for shape in shapes if isinstance(shape, Plate)]
            for shape in shapes:
                blocked = points.form_factor_of(shape)
                if isinstance(shape, Ball):
                    _darken(blocked, plates, points, *points.directions_to(shape.centre))
                share -= blocked
            share = np.maximum(share, 0.0)
        case EmissiveLight():
            share = np.zeros(points.owners.size)
            source = next((shape for shape in shapes if shape.name == light.body), None)
            if isinstance(source, Ball):
                share = points.form_factor_of(source)
                others = [shape for shape in shapes if shape is not source]
                _darken(share, others, points, *points.directions_to(source.centre))
        case _:
            raise BackendError(f"light kind {light.kind!r} has no closed form in the analytic renderer")
    return share


def _darken(
    share: Float64, shapes: Sequence[Shape], points: SurfacePoints, towards: Float64, distance: Float64 | float
) -> None:
    """Set `share` to zero, in place, where a body other than the point's own stands before the light."""
    exposed = np.flatnonzero(share > 0.0)
    start, direction, own = points.places[:, exposed], towards[:, exposed], points.owners[exposed]
    reach = distance if isinstance(distance, float) else distance[exposed]
    hidden = np.zeros(exposed.size, np.bool_)
    for shape in shapes:
        hidden |= (shape.hit(start, direction) < reach) & (own != shape.number)
    share[exposed[hidden]] = 0.0


def spot_falloff(cosine: Float64, half_angle: float, blend: float) -> Float64:
    """Return a spot's fall-off in [0, 1] for the cosine of the angle from its axis.

    Blender's: smoothstep of (cos - cos_half) / ((1 - cos_half) * blend), a hard edge where blend is 0.
    """
    edge = math.cos(half_angle)
    width = max((1.0 - edge) * blend, 1e-30)
    x = np.clip((cosine - edge) / width, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
