"""What can be measured on a scene's specification alone, without rendering."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from multilight.datagen.stats.quantities import Value
from multilight.lights.photometry.irradiance import LightMeter
from multilight.lights.rigs.measure import LightMeasure, measure_light
from multilight.lights.spec import EnvironmentLight, LightRig
from multilight.scenes.appearance import material_class
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.assets.splits import Split, asset_split
from multilight.scenes.cameras.pinhole import focal_length_mm, pixel_rays, project
from multilight.scenes.cameras.trajectory import SEEN, in_frame
from multilight.scenes.geometry.rays import SceneRays, body_triangles, surface_points
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Camera, MeshAsset, SceneSpec, Sphere

POINTS = 48
"""Points on an insertable object's surface that are looked for."""
GRID = 12
"""Rays along each side of a picture that measure its depth."""

Values = dict[str, list[Value]]


@dataclass(frozen=True)
class SceneFacts:
    """One scene, measured: values by quantity, and what tells it from other scenes.

    `owned` are the asset ids and environment places that must not cross splits; `tokens` say what the scene is
    made of, for finding near-duplicates.
    """

    index: int
    split: Split
    values: Values
    owned: frozenset[str]
    tokens: frozenset[str]


def scene_facts(scene: SceneSpec, rig: LightRig, split: Split, library: AssetLibrary) -> SceneFacts:
    """Measure a scene; raises `AssetError` where an asset of it is not installed."""
    meter = LightMeter.of(scene, library)
    lights = [measure_light(light, meter) for light in rig.lights]
    values: Values = defaultdict(list)
    objects = [body for body in scene.bodies if body.role == "object"]
    values["kind"], values["split"] = [scene.kind], [split]
    values["objects"], values["lights"] = [float(len(objects))], [float(len(rig.lights))]
    values["glows"] = ["yes" if any(light.kind == "emissive" for light in rig.lights) else "no"]
    # The strongest light against all others, as a dome meter reads them; what glows counts in neither.
    *others, strongest = sorted(light.dome for light in lights if light.kind != "emissive") or [0.0]
    if sum(others) > 0:
        values["contrast"].append(float(np.log2(strongest / sum(others))))
    for body in objects:
        _add_object(values, body, library)
    for light in lights:
        _add_light(values, light)
    values["gel"] += [light.gel for light in rig.lights if light.gel is not None]
    _add_views(values, scene, meter.rays, library)
    return SceneFacts(scene.index, split, dict(values), owned_by(scene, rig, library), _tokens(scene))


def _add_object(values: Values, body: Body, library: AssetLibrary) -> None:
    values["category"].append(body.category)
    values["size"].append(float(np.ptp(body_triangles(body, library)[0], axis=0).max()))
    for material in body.materials:
        values["material"].append(material_class(material))
        values["roughness"].append(material.roughness)
        values["metallic"].append(material.metallic)
        values["transmission"].append(material.transmission)


def _add_light(values: Values, measure: LightMeasure) -> None:
    values["light_kind"].append(measure.kind)
    values["azimuth"].append(float(np.degrees(measure.azimuth)))
    values["elevation"].append(float(np.degrees(measure.elevation)))
    values["illuminance"].append(measure.illuminance)
    values["angular_size"].append(float(np.degrees(measure.angular_size)))
    values["temperature"].append(measure.temperature)
    values["saturation"].append(measure.saturation)
    values["shaped"].append("yes" if measure.shaped else "no")


def _add_views(values: Values, scene: SceneSpec, rays: SceneRays, library: AssetLibrary) -> None:
    """Look at the scene through every camera."""
    rng = Streams(0, scene.index)("stats")
    bodies = {scene.bodies.index(body): body for body in scene.bodies if body.insertable}
    points = {number: surface_points(body, library, rng, POINTS) for number, body in bodies.items()}
    centre = np.concatenate(list(points.values())).mean(axis=0)
    shown = dict.fromkeys(points, 0)
    for camera in scene.cameras:
        eye = camera.pose()[:3, 3]
        away = eye - centre
        values["lens"].append(focal_length_mm(camera))
        values["distance"].append(float(np.linalg.norm(away)))
        values["camera_elevation"].append(float(np.degrees(np.arcsin(away[2] / np.linalg.norm(away)))))
        if camera.aperture_radius > 0:
            values["f_number"].append(focal_length_mm(camera) / 2000.0 / camera.aperture_radius)
        near, far = _depth_range(camera, rays)
        values["near"] += [near] if near > 0 else []
        values["depth_range"] += [far / near] if near > 0 else []
        for number, surface in points.items():
            visible = rays.visible_share(eye, number, surface)
            values["occlusion"].append(1.0 - visible)
            values["in_frame"].append(_size_in_frame(camera, surface))
            shown[number] += in_frame(camera, surface) and visible >= SEEN
    values["shown"] += [count / len(scene.cameras) for count in shown.values()]


def _depth_range(camera: Camera, rays: SceneRays) -> tuple[float, float]:
    """Return the 5th and 95th percentile of z_depth [m] over a grid of rays that hit anything; zeros for none."""
    ratio = GRID / camera.width, GRID / camera.height
    scaled = {"fx": camera.fx * ratio[0], "cx": camera.cx * ratio[0], "fy": camera.fy * ratio[1]}
    coarse = camera.model_copy(update=scaled | {"cy": camera.cy * ratio[1], "width": GRID, "height": GRID})
    origins, directions = (array.reshape(-1, 3) for array in pixel_rays(coarse))
    hit, distance = rays.first_hit(origins, directions)
    depth = (distance * (directions @ -camera.pose()[:3, 2]))[hit >= 0]
    if not len(depth):
        return 0.0, 0.0
    low, high = np.percentile(depth, [5, 95])
    return float(low), float(high)


def _size_in_frame(camera: Camera, points: Float64) -> float:
    """Return the longer side of the box round projected points, over the picture's shorter side."""
    pixels, _ = project(camera, points)
    seen = pixels[np.isfinite(pixels).all(axis=1)]
    return float(np.ptp(seen, axis=0).max() / min(camera.width, camera.height)) if len(seen) else 0.0


def owned_by(scene: SceneSpec, rig: LightRig, library: AssetLibrary) -> frozenset[str]:
    """List what belongs to one split only: models by id, environments by place."""
    used = {body.geometry.asset for body in scene.bodies if isinstance(body.geometry, MeshAsset)}
    used |= {light.map for light in rig.lights if isinstance(light, EnvironmentLight) and light.map}
    infos = [info for info in map(library.info, used) if asset_split(info) is not None]
    return frozenset(f"place {info.place}" if info.place else info.id for info in infos)


def _tokens(scene: SceneSpec) -> frozenset[str]:
    """Say what a scene is made of: shapes, textures and colours, wherever they stand."""
    tokens = set()
    for body in scene.bodies:
        match body.geometry:
            case MeshAsset(asset=asset):
                tokens.add(f"{body.role} {asset}")
            case Sphere(radius=radius):
                tokens.add(f"{body.role} sphere {radius:.3f}")
            case _:
                tokens.add(f"{body.role} {body.category}")
        for material in body.materials:
            colour = ",".join(f"{channel:.2f}" for channel in material.base_color)
            image = material.base_color_texture.image if material.base_color_texture else ""
            tokens.add(f"{body.category} {colour} {image}")
    return frozenset(tokens)
