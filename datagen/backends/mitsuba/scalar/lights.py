"""The lights of `lights.spec` as Mitsuba's own emitters. Emissive bodies are made in `worlds.py`, with their shapes.

Lamps with a size have the surface `null`: they block nothing.
"""

import math
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import map_coordinates
from scipy.special import betaincinv

from multilight.datagen.backends.mitsuba.environments import envmap
from multilight.datagen.backends.mitsuba.scalar.film import CAMERA_AXES
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.spec import AreaLight, EnvironmentLight, PointLight, SpotLight, SunLight
from multilight.scenes.arrays import Float32, Float64, Int64
from multilight.scenes.assets.environments import read_environment
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import Rgb

Emitters = dict[str, Any]
"""Parts of a scene, by any name, as `mi.load_dict` takes them."""

SUN_DISTANCE = 1e4
"""In radii of the scene: its far side sees the sun a ten-thousandth of a radian off."""
POINTS = 32
"""What a spot of some size is made of."""
SHADE = 2e-3
"""Radius of a profiled lamp's shade over its greatest distance: Mitsuba's shadow rays end a thousandth early."""
PICTURE, PROFILE = 512, 1024
"""Least texels a side of a spot's picture, and of a profile."""
DISK_CORNERS = 64


def emitters(
    light: EnvironmentLight | SunLight | PointLight | SpotLight | AreaLight, library: AssetLibrary, bounds: Float64
) -> Emitters:
    """Make a light; `bounds` (2, 3) are the lowest and highest corner of the scene [m]."""
    match light:
        case EnvironmentLight():
            return {"environment": _environment(light, library)}
        case SunLight():
            return {"sun": _sun(light, bounds)}
        case PointLight() if light.profile is not None:
            return _profiled(light, bounds)
        case PointLight() if light.radius > 0:
            radiance = np.array(light.intensity) / (math.pi * light.radius**2)
            sphere = {"type": "sphere", "center": list(light.position), "radius": light.radius}
            return {"lamp": sphere | _glowing(radiance)}
        case PointLight():
            return {"lamp": _point(light)}
        case SpotLight():
            return _spot(light, library)
        case AreaLight():
            return {"lamp": _panel(light)}


def null_mesh(vertices: Float64, faces: NDArray[np.integer], radiance: Rgb | Float64) -> mi.Mesh:
    """Make a flat-shaded shape, (V, 3) and (F, 3), that glows and blocks nothing; it shines where its faces look."""
    props = mi.Properties()
    props["mesh_bsdf"] = mi.load_dict({"type": "null"})
    props["mesh_emitter"] = mi.load_dict({"type": "area", "radiance": _rgb(radiance)})
    mesh = mi.Mesh("lamp", len(vertices), len(faces), props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def _rgb(value: Rgb | Float64) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(v) for v in value]}


def _point(light: PointLight) -> dict[str, Any]:
    return {"type": "point", "position": list(light.position), "intensity": _rgb(light.intensity)}


def _glowing(radiance: Rgb | Float64) -> dict[str, Any]:
    return {"emitter": {"type": "area", "radiance": _rgb(radiance)}, "bsdf": {"type": "null"}}


def _environment(light: EnvironmentLight, library: AssetLibrary) -> dict[str, Any]:
    if light.map is None:
        return {"type": "constant", "radiance": _rgb(light.radiance)}
    pixels = read_environment(library.environment_path(light.map)) * np.array(light.radiance, np.float32)
    return envmap(pixels, light.rotation)


def _sun(light: SunLight, bounds: Float64) -> Any:
    """A direction, or a disc so far away that it stands for one at infinity."""
    way = np.array(light.direction) / np.linalg.norm(light.direction)
    if light.angle < 1e-5:
        return {"type": "directional", "direction": way.tolist(), "irradiance": _rgb(light.irradiance)}
    half = light.angle / 2
    radiance = np.array(light.irradiance) / (math.pi * math.sin(half) ** 2)
    middle = bounds.mean(axis=0)
    distance = SUN_DISTANCE * max(float(np.linalg.norm(bounds[1] - middle)), 1e-3)
    vertices, faces = _disk(spot_frame(way), distance * math.tan(half), distance * math.tan(half))
    return null_mesh(vertices + middle - way * distance, faces, radiance)


def _panel(light: AreaLight) -> mi.Mesh:
    pose = np.array(light.world_from_light)
    if light.shape == "disk":
        vertices, faces = _disk(pose[:3, :3], light.width / 2, light.height / 2)
    else:
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2 * [light.width, light.height, 0]
        vertices, faces = corners @ pose[:3, :3].T, np.array([[0, 2, 1], [0, 3, 2]])
    return null_mesh(vertices + pose[:3, 3], faces, light.radiance)


def _disk(frame: Float64, half_width: float, half_height: float) -> tuple[Float64, Int64]:
    """Make an ellipse about the origin that looks along the frame's -Z, as a polygon of the same area."""
    angle = np.arange(DISK_CORNERS) / DISK_CORNERS * 2 * math.pi
    swell = math.sqrt(angle[1] / math.sin(angle[1]))
    rim = np.stack([np.cos(angle) * half_width, np.sin(angle) * half_height, 0 * angle], axis=1) * swell
    corner = np.arange(DISK_CORNERS)
    faces = np.stack([np.roll(corner, -1), corner, np.full(DISK_CORNERS, DISK_CORNERS)], axis=1)
    return np.concatenate([rim, np.zeros((1, 3))]) @ frame.T, faces


def _places(position: tuple[float, float, float], radius: float) -> Float64:
    """Return points (N, 3) that look, from every side, like a disc of even brightness; one where radius is 0.

    Their distance from the middle has the density r^2 / sqrt(1 - r^2), the inverse Abel transform of such a disc's.
    """
    if radius == 0:
        return np.array([position])
    golden = 1.2207440846057596  # Roberts' generalized golden ratio for three dimensions
    u = (0.5 + np.outer(np.arange(POINTS), golden ** -np.arange(1.0, 4.0))) % 1.0
    z, phi = 2 * u[:, 0] - 1, 2 * math.pi * u[:, 1]
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(phi), flat * np.sin(phi), z], axis=1)
    return np.array(position) + radius * np.sqrt(betaincinv(1.5, 0.5, u[:, 2]))[:, None] * directions


def _spot(light: SpotLight, library: AssetLibrary) -> Emitters:
    """Project the spot's whole pattern: Blender's soft edge, which Mitsuba's own spot has not, times the gobo."""
    picture = mi.Bitmap(_spot_picture(light, library))
    irradiance = mi.load_dict({"type": "bitmap", "bitmap": picture, "raw": True, "wrap_mode": "clamp"})
    places = _places(light.position, light.radius)
    pose = np.eye(4)
    pose[:3, :3] = spot_frame(light.direction, light.roll)
    parts = {}
    for number, place in enumerate(places):
        pose[:3, 3] = place
        parts[f"projector{number}"] = {
            "type": "projector",
            "irradiance": irradiance,
            "fov": 2 * math.degrees(light.half_angle),
            "to_world": mi.ScalarTransform4f((pose @ CAMERA_AXES).tolist()),
            "scale": 1 / len(places),
        }
    return parts


def _spot_picture(light: SpotLight, library: AssetLibrary) -> Float32:
    """Return the irradiance over pi, (S, S, 3), on the plane one metre before the spot, as `projector` takes it."""
    gobo = np.ones((1, 1))
    if light.gobo is not None:
        with Image.open(library.texture_path(light.gobo)) as image:
            gobo = np.asarray(image.convert("L"), np.float64) / 255
    size = max(PICTURE, *gobo.shape)
    place = (np.arange(size) + 0.5) / size
    x, y = np.meshgrid(*2 * [(2 * place - 1) * math.tan(light.half_angle)])
    cosine = 1 / np.sqrt(1 + x * x + y * y)
    edge = math.cos(light.half_angle)
    soft = np.clip((cosine - edge) / max((1 - edge) * light.blend, 1e-6), 0, 1)
    rows, columns = np.meshgrid(*(place * count - 0.5 for count in gobo.shape), indexing="ij")
    shape = soft * soft * (3 - 2 * soft) * map_coordinates(gobo, [rows, columns], order=1, mode="nearest")
    return (shape * cosine**3 / math.pi)[..., None].astype(np.float32) * np.array(light.intensity, np.float32)


def _profiled(light: PointLight, bounds: Float64) -> Emitters:
    """Put a small shade round a point, as see-through in each direction as the profile says.

    The shade is an emitter too, a dark one that is never sampled, since the camera sees no lamps.
    """
    assert light.profile is not None
    angle = (np.arange(PROFILE) + 0.5) / PROFILE * math.pi
    passed = np.interp(angle, np.linspace(0, math.pi, len(light.profile)), light.profile)
    rows = np.repeat(1 - passed[:, None, None], 2, axis=1).astype(np.float32)
    opacity = {"type": "bitmap", "bitmap": mi.Bitmap(rows), "raw": True, "wrap_mode": "clamp"}
    frame = np.eye(4)
    frame[:3, :3] = spot_frame(light.direction) @ np.diag([1, -1, -1])  # the shade's pole lies along the direction
    frame[:3, 3] = light.position
    radius = SHADE * float(np.linalg.norm(np.abs(bounds - light.position).max(axis=0)))
    shade = {
        "type": "sphere",
        "to_world": mi.ScalarTransform4f(frame.tolist()) @ mi.ScalarTransform4f().scale(radius),
        "bsdf": {"type": "mask", "opacity": opacity, "bsdf": {"type": "diffuse", "reflectance": _rgb((0, 0, 0))}},
        "emitter": {"type": "area", "radiance": _rgb((0, 0, 0)), "sampling_weight": 0.0},
    }
    return {"lamp": _point(light), "shade": shade}
