"""`lights.spec` lights as Blender lights and worlds.

Blender states most powers in watts of its own reckoning; the factors below turn the spec's radiometric
quantities into them. The tests hold each against a closed form.
"""

import math
from typing import Any

import bpy
from mathutils import Matrix, Vector

from datagen.backends.blender.materials import load_image
from lights.spec import AreaLight, EnvironmentLight, PointLight, SpotLight, SunLight
from scenes.assets.library import AssetLibrary
from scenes.frozen import Vector3

INTENSITY_TO_WATTS = 4 * math.pi
"""Watts of a Blender point or spot light per W/sr on its axis."""


def add_light(light: SunLight | PointLight | SpotLight | AreaLight) -> None:
    """Add a light in its own light group: unseen by the camera, seen in reflections where it has a size."""
    match light:
        case SunLight():
            data = _data(light.name, "SUN", light.irradiance, 1.0)
            data.angle = light.angle
            pose = _facing(light.direction)
        case PointLight():
            data = _data(light.name, "POINT", light.intensity, INTENSITY_TO_WATTS)
            data.shadow_soft_size, data.use_soft_falloff = light.radius, False
            pose = Matrix.Translation(light.position)
        case SpotLight():
            data = _data(light.name, "SPOT", light.intensity, INTENSITY_TO_WATTS)
            data.shadow_soft_size, data.use_soft_falloff = light.radius, False
            data.spot_size, data.spot_blend = 2 * light.half_angle, light.blend
            pose = Matrix.Translation(light.position) @ _facing(light.direction)
        case AreaLight():
            data = _area(light)
            pose = Matrix(light.world_from_light)
    placed = bpy.data.objects.new(light.name, data)
    placed.matrix_world = pose
    placed.visible_camera = False
    placed.lightgroup = light.name
    bpy.context.scene.collection.objects.link(placed)


def set_world(light: EnvironmentLight | None, library: AssetLibrary) -> None:
    """Light the scene from infinity, in a light group of its own; without a light, leave it black."""
    world = bpy.data.worlds.new("world")
    if world.node_tree is None:
        world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0) if light is None else (*light.radiance, 1.0)
    tree.links.new(background.outputs["Background"], tree.nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    if light is not None:
        world.lightgroup = light.name
        if light.map is not None:
            tree.links.new(_map_colour(tree, light, library), background.inputs["Color"])
    bpy.context.scene.world = world


def _map_colour(tree: Any, light: EnvironmentLight, library: AssetLibrary) -> Any:
    """Look the map up; Blender's own azimuth is the spec's, so only the rotation is undone first."""
    assert light.map is not None
    direction = tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"]
    turned = tree.nodes.new("ShaderNodeMapping")
    turned.inputs["Rotation"].default_value = (0.0, 0.0, -light.rotation)
    tree.links.new(direction, turned.inputs["Vector"])
    picture = tree.nodes.new("ShaderNodeTexEnvironment")
    picture.image = load_image(library.environment_path(light.map), "Linear Rec.709")
    tree.links.new(turned.outputs["Vector"], picture.inputs["Vector"])
    scaled = tree.nodes.new("ShaderNodeVectorMath")
    scaled.operation = "MULTIPLY"
    tree.links.new(picture.outputs["Color"], scaled.inputs[0])
    scaled.inputs[1].default_value = light.radiance
    return scaled.outputs["Vector"]


def _area(light: AreaLight) -> Any:
    # Radiance L over area A is the flux pi A L, Blender's watts; an ellipse fills pi / 4 of its box.
    share = 1.0 if light.shape == "rectangle" else math.pi / 4
    data = _data(light.name, "AREA", light.radiance, math.pi * light.width * light.height * share)
    data.shape = "RECTANGLE" if light.shape == "rectangle" else "ELLIPSE"
    data.size, data.size_y, data.spread = light.width, light.height, math.pi
    return data


def _data(name: str, kind: str, colour: Vector3, energy: float) -> Any:
    data = bpy.data.lights.new(name, kind)
    data.color, data.energy = colour, energy
    return data


def _facing(direction: Vector3) -> Matrix:
    """Rotate so that the light's -Z runs along the direction."""
    return Vector(direction).to_track_quat("-Z", "Y").to_matrix().to_4x4()
