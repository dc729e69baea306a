"""Irradiance on points of the scene from each kind of light, in closed form, direct light only."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.analytic.shapes import Ball, Plate, Shape, column, dot
from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float64
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import SceneSpec, Sphere


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


def colour_of(light: Light) -> Rgb:
    """Return the light's quantity by channel, whatever its unit."""
    match light:
        case EnvironmentLight() | EmissiveLight():
            return light.radiance
        case SunLight():
            return light.irradiance
        case PointLight() | SpotLight():
            return light.intensity
    raise BackendError(f"light kind {light.kind!r} has no closed form in the analytic renderer")


def exitance_share(
    light: Light, shapes: Sequence[Shape], points: Float64, normals: Float64, owners: NDArray[np.uint16]
) -> Float64:
    """Return irradiance / pi for a light of unit colour: times albedo and colour it is the outgoing radiance.

    points, normals (3, N): positions in metres and unit normals towards the camera; owners (N,): the instance
    id of the body each lies on. Returns (N,) in the unit that makes radiance from the light's quantity:

    - sun: E cos(theta) / pi; point: I cos(theta) / (pi d^2); spot: the same times its fall-off.
    - uniform environment: 1 minus the other bodies' form factors, without spheres whose centre is behind a
      rectangle. Exact where bodies do not overlap as seen from the point; where they do, the overlap is counted
      twice, down to zero and no further.
    - glowing sphere: its form factor, horizon included; hidden as a whole where its centre is hidden.
    """
    match light:
        case SunLight():
            towards = -column(light.direction) / math.hypot(*light.direction)
            share = np.maximum(dot(towards, normals), 0.0) / math.pi
            _darken(share, shapes, points, np.broadcast_to(towards, points.shape), np.inf, owners)
        case PointLight() | SpotLight():
            share = _from_point(light, shapes, points, normals, owners)
        case EnvironmentLight():
            share = _from_environment(shapes, points, normals, owners)
        case EmissiveLight():
            share = _from_glow(light, shapes, points, normals, owners)
        case _:
            raise BackendError(f"light kind {light.kind!r} has no closed form in the analytic renderer")
    return share


def _from_environment(
    shapes: Sequence[Shape], points: Float64, normals: Float64, owners: NDArray[np.uint16]
) -> Float64:
    """Return the fraction of the hemisphere, weighted by its cosine, that sees a uniform environment, (N,)."""
    share = np.ones(points.shape[1])
    plates = [shape for shape in shapes if isinstance(shape, Plate)]
    for shape in shapes:
        blocked = np.zeros(points.shape[1])
        other = np.flatnonzero(owners != shape.number)
        blocked[other] = shape.form_factor(points[:, other], normals[:, other])
        if isinstance(shape, Ball):
            to_centre = shape.centre - points
            distance = np.sqrt(dot(to_centre, to_centre))
            _darken(blocked, plates, points, to_centre / distance, distance, owners)
        share -= blocked
    return np.maximum(share, 0.0)


def _from_point(
    light: PointLight | SpotLight,
    shapes: Sequence[Shape],
    points: Float64,
    normals: Float64,
    owners: NDArray[np.uint16],
) -> Float64:
    """Return irradiance / pi from a point of unit intensity, (N,)."""
    to_light = column(light.position) - points
    distance2 = dot(to_light, to_light)
    distance = np.sqrt(distance2)
    towards = to_light / distance
    share = np.maximum(dot(towards, normals), 0.0) / (math.pi * distance2)
    if isinstance(light, SpotLight):
        axis = column(light.direction) / math.hypot(*light.direction)
        share *= spot_falloff(-dot(axis, towards), light.half_angle, light.blend)
    _darken(share, shapes, points, towards, distance, owners)
    return share


def _from_glow(
    light: EmissiveLight,
    shapes: Sequence[Shape],
    points: Float64,
    normals: Float64,
    owners: NDArray[np.uint16],
) -> Float64:
    """Return irradiance / pi from a sphere of unit radiance, (N,); zero where it has been removed."""
    share = np.zeros(points.shape[1])
    source = next((shape for shape in shapes if shape.name == light.body), None)
    if not isinstance(source, Ball):
        return share
    lit = owners != source.number
    share[lit] = source.form_factor(points[:, lit], normals[:, lit])
    to_light = source.centre - points
    distance = np.sqrt(dot(to_light, to_light))
    others = [shape for shape in shapes if shape is not source]
    _darken(share, others, points, to_light / distance, distance, owners)
    return share


def _darken(
    share: Float64,
    shapes: Sequence[Shape],
    points: Float64,
    towards: Float64,
    distance: Float64 | float,
    owners: NDArray[np.uint16],
) -> None:
    """Set `share` to zero, in place, where a body other than the point's own stands before the light."""
    exposed = np.flatnonzero(share > 0.0)
    start, direction, own = points[:, exposed], towards[:, exposed], owners[exposed]
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
