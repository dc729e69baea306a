"""`lights.spec` lights as Blender lights and worlds.

Blender states most powers in watts of its own reckoning; the factors below turn the spec's radiometric
quantities into them. The tests hold each against a closed form.
"""

import math
from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from multilight.datagen.backends.blender.materials import load_image
from multilight.datagen.backends.blender.nodes import empty_tree, maths, node
from multilight.lights.photometry.directions import spot_frame
from multilight.lights.spec import AreaLight, EnvironmentLight, PointLight, SpotLight, SunLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.frozen import Vector3

INTENSITY_TO_WATTS = 4 * math.pi
"""Watts of a Blender point or spot light per W/sr on its axis."""


def add_light(light: SunLight | PointLight | SpotLight | AreaLight, library: AssetLibrary) -> bpy.types.Object:
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
            if light.profile is not None:
                _shape(data, light.direction, light.profile)
        case SpotLight():
            data = _data(light.name, "SPOT", light.intensity, INTENSITY_TO_WATTS)
            data.shadow_soft_size, data.use_soft_falloff = light.radius, False
            data.spot_size, data.spot_blend = 2 * light.half_angle, light.blend
            frame = Matrix(spot_frame(light.direction, light.roll).tolist()).to_4x4()
            pose = Matrix.Translation(light.position) @ frame
            if light.gobo is not None:
                _project(data, load_image(library.texture_path(light.gobo), "Non-Color"))
        case AreaLight():
            data = _area(light)
            pose = Matrix(light.world_from_light)
    placed = bpy.data.objects.new(light.name, data)
    placed.matrix_world = pose
    placed.visible_camera = False
    placed.lightgroup = light.name
    bpy.context.scene.collection.objects.link(placed)
    return placed


class Sky:
    """The world, which lights the scene from infinity by one environment at a time, in the first one's light group.

    It stays one data-block: another in its place would put Cycles' lamps into another order, and with it the random
    choices of every later render, differently in each process.
    """

    def __init__(self, lights: Sequence[EnvironmentLight], library: AssetLibrary) -> None:
        """Light the scene by the first environment; without any, by none."""
        self.names = tuple(light.name for light in lights)
        world = bpy.context.scene.world = bpy.data.worlds.new("world")
        self._tree = empty_tree(world)
        self._surface = node(self._tree, "ShaderNodeOutputWorld").inputs["Surface"]
        self._backgrounds = [self._background(light, library) for light in lights]
        if lights:
            world.lightgroup = self.names[0]
            self.shine(0)

    def shine(self, number: int) -> None:
        """Light the scene by another environment."""
        self._tree.links.new(self._backgrounds[number], self._surface)

    def _background(self, light: EnvironmentLight, library: AssetLibrary) -> Any:
        colour = light.radiance if light.map is None else _map_colour(self._tree, light, library)
        return node(self._tree, "ShaderNodeBackground", {"Color": colour}).outputs["Background"]


def _map_colour(tree: Any, light: EnvironmentLight, library: AssetLibrary) -> Any:
    """Look the map up; Blender's own azimuth is the spec's, so only the rotation is undone first."""
    assert light.map is not None
    direction = node(tree, "ShaderNodeTexCoord").outputs["Generated"]
    rotated = node(tree, "ShaderNodeMapping", {"Vector": direction, "Rotation": (0.0, 0.0, -light.rotation)})
    picture = node(tree, "ShaderNodeTexEnvironment", {"Vector": rotated.outputs["Vector"]})
    picture.image = load_image(library.environment_path(light.map), "Linear Rec.709")
    scaled = node(tree, "ShaderNodeVectorMath", {0: picture.outputs["Color"], 1: light.radiance}, "MULTIPLY")
    return scaled.outputs["Vector"]


def _area(light: AreaLight) -> Any:
    # Radiance L over area A is the flux pi A L, Blender's watts; an ellipse fills pi / 4 of its box.
    filled = 1.0 if light.shape == "rectangle" else math.pi / 4
    data = _data(light.name, "AREA", light.radiance, math.pi * light.width * light.height * filled)
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


def _shape(data: Any, direction: Vector3, profile: tuple[float, ...]) -> None:
    """Multiply a point light by its profile: the table as an image of one row, looked up at the angle of emission.

    Linear filtering between the pixels' centres is the spec's own interpolation, to the last digit.
    """
    table = bpy.data.images.new(f"{data.name} profile", len(profile), 1, alpha=True, float_buffer=True)
    table.colorspace_settings.name = "Non-Color"
    table.pixels.foreach_set(np.repeat(np.array(profile, np.float32), 4))
    table.pack()
    tree, count = empty_tree(data), len(profile)
    # "Incoming" runs from the lamp to what it lights.
    leaving = node(tree, "ShaderNodeNewGeometry").outputs["Incoming"]
    cosine = node(tree, "ShaderNodeVectorMath", {0: leaving, 1: Vector(direction).normalized()}, "DOT_PRODUCT")
    angle = maths(tree, "ARCCOSINE", cosine.outputs["Value"])
    place = maths(tree, "MULTIPLY_ADD", angle, (count - 1) / (math.pi * count), 0.5 / count)
    where = node(tree, "ShaderNodeCombineXYZ", {"X": place, "Y": 0.5})
    _emit(tree, table, where.outputs["Vector"])


def _project(data: Any, image: bpy.types.Image) -> None:
    """Multiply a spot by an image; Cycles' own coordinates of a spot span the square round its cone."""
    tree = empty_tree(data)
    _emit(tree, image, node(tree, "ShaderNodeTexCoord").outputs["UV"])


def _emit(tree: Any, image: bpy.types.Image, where: Any) -> None:
    """Multiply a lamp's power by an image, linearly filtered; past its border it goes on as there."""
    picture = node(tree, "ShaderNodeTexImage", {"Vector": where})
    picture.image, picture.interpolation, picture.extension = image, "Linear", "EXTEND"
    emission = node(tree, "ShaderNodeEmission", {"Color": picture.outputs["Color"]})
    node(tree, "ShaderNodeOutputLight", {"Surface": emission.outputs["Emission"]})
