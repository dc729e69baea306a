"""Scene files by independent writers: a room by trimesh, the same by pxr, and by Blender in a process of its own."""

import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image
from trimesh.transformations import quaternion_from_matrix, rotation_matrix, translation_matrix
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from multilight.scenes.arrays import Float64
from tests import ROOT

LENGTH, DEPTH, HEIGHT = 5.0, 4.0, 2.6
TABLE = (1.4, 0.8, 0.75)
Y_UP = rotation_matrix(-np.pi / 2, [1, 0, 0])

OAK = Image.fromarray(np.tile(np.array([[[150, 110, 70]]], np.uint8), (8, 8, 1)))
PACKED = Image.fromarray(np.tile(np.array([[[0, 153, 0]]], np.uint8), (8, 8, 1)))
"""Green is roughness, 0.6; blue is metallic, 0."""


def walls() -> dict[str, Float64]:
    """Return the pose of each side of the room, as a rectangle that faces inwards along its +Z."""
    return {
        "Floor": np.eye(4),
        "North": translation_matrix([0, DEPTH / 2, HEIGHT / 2]) @ rotation_matrix(np.pi / 2, [1, 0, 0]),
        "South": translation_matrix([0, -DEPTH / 2, HEIGHT / 2]) @ rotation_matrix(-np.pi / 2, [1, 0, 0]),
        "Ceiling": translation_matrix([0, 0, HEIGHT]) @ rotation_matrix(np.pi, [1, 0, 0]),
    }


def rectangle(width: float, height: float) -> trimesh.Trimesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [width / 2, height / 2, 1]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def clothed(mesh: trimesh.Trimesh, material: PBRMaterial) -> trimesh.Trimesh:
    mesh.unmerge_vertices()
    mesh.visual = TextureVisuals(uv=mesh.vertices[:, :2] + mesh.vertices[:, 2:], material=material)
    return mesh


def room(*, table: bool = True, scale: float = 1.0) -> trimesh.Scene:
    """Make a room with a floor, two walls and a ceiling, a table, a cupboard and a lamp that glows; Y-up."""
    oak = PBRMaterial("oak", baseColorTexture=OAK, metallicRoughnessTexture=PACKED)
    oak.roughnessFactor, oak.metallicFactor = 1.0, 1.0
    paint = PBRMaterial("paint", baseColorFactor=[200, 190, 175, 255], roughnessFactor=0.9, metallicFactor=0.0)
    glow = PBRMaterial("glow", emissiveFactor=[1.0, 0.5, 0.25], metallicFactor=0.0)
    scene = trimesh.Scene()

    def add(name: str, mesh: trimesh.Trimesh, material: PBRMaterial) -> None:
        scene.add_geometry(
            clothed(mesh, material).apply_transform(Y_UP).apply_scale(scale), node_name=name, geom_name=name
        )

    for name, pose in walls().items():
        across = DEPTH if name in ("Floor", "Ceiling") else HEIGHT
        add(name, rectangle(LENGTH, across).apply_transform(pose), oak if name == "Floor" else paint)
    if table:
        x, y, z = TABLE
        top = trimesh.creation.box((x, y, 0.04)).apply_translation((0.6, 0.5, z - 0.02))
        legs = [
            trimesh.creation.box((0.06, 0.06, z - 0.04)).apply_translation((0.6 + i * 0.6, 0.5 + j * 0.3, z / 2 - 0.02))
            for i in (-1, 1)
            for j in (-1, 1)
        ]
        add("Table", trimesh.util.concatenate([top, *legs]), oak)
        add("Cupboard", trimesh.creation.box((0.45, 1.2, 0.8)).apply_translation((-2.25, -0.4, 0.4)), paint)
    add("Lamp", trimesh.creation.icosphere(2, 0.09).apply_translation((-2.25, -0.8, 0.9)), glow)
    return scene


LIGHTS = [
    {"type": "point", "intensity": 179.0, "color": [1.0, 0.5, 0.25], "name": "Bulb"},
    {"type": "spot", "intensity": 358.0, "name": "Spot", "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.6}},
    {"type": "directional", "intensity": 1790.0, "name": "Sun"},
]


def write_glb(path: Path, scene: trimesh.Scene, **changes: Any) -> Path:
    """Write a scene with `LIGHTS`: spot and sun point down, the bulb hangs at (0.5, 1, 2.3) in the Z-up room."""
    data = scene.export(file_type="glb")
    length = struct.unpack("<I", data[12:16])[0]
    header, rest = json.loads(data[20 : 20 + length]), data[20 + length :]
    header["extensionsUsed"] = ["KHR_lights_punctual"]
    header["extensions"] = {"KHR_lights_punctual": {"lights": LIGHTS}}
    w, x, y, z = (float(v) for v in quaternion_from_matrix(Y_UP))
    first = len(header["nodes"])
    for i, at in enumerate(([0.5, 2.3, -1.0], [0.6, 2.4, -0.5], [0, 3, 0])):
        light = {"KHR_lights_punctual": {"light": i}}
        header["nodes"].append(
            {"name": LIGHTS[i]["name"], "translation": at, "rotation": [x, y, z, w], "extensions": light}
        )
    header["scenes"][0]["nodes"] += [first, first + 1, first + 2]
    header |= changes
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    size = 20 + len(text) + len(rest)
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text + rest)
    return path


def write_glb_of(path: Path, header: dict[str, Any], material: dict[str, Any]) -> Path:
    """Write a sheet with red vertices, a third of them opaque, changed by entries of the header and the material."""
    sheet = rectangle(0.1, 0.1)
    sheet.visual.vertex_colors = np.tile(np.array([255, 0, 0, 85], np.uint8), (4, 1))
    data = sheet.export(file_type="glb")
    length = struct.unpack("<I", data[12:16])[0]
    made = json.loads(data[20 : 20 + length]) | {"materials": [material]} | header
    made["meshes"][0]["primitives"][0]["material"] = 0
    text = json.dumps(made).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest)) + struct.pack("<I4s", len(text), b"JSON")
    path.write_bytes(head + text + rest)
    return path


BLENDER = """
import sys
from multilight.datagen.backends import blender
import bpy

out, mark, action = sys.argv[1:4]
if action == "open":
    bpy.ops.wm.open_mainfile(filepath=out, use_scripts=True)
    bpy.context.view_layer.update()
else:
    bpy.ops.wm.read_factory_settings(use_empty=True)

    def material(name, colour, glow=0.0):
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        surface = made.node_tree.nodes["Principled BSDF"]
        surface.inputs["Base Color"].default_value = (*colour, 1)
        surface.inputs["Roughness"].default_value = 0.6
        surface.inputs["Emission Color"].default_value = (1, 0.5, 0.25, 1)
        surface.inputs["Emission Strength"].default_value = glow
        return made

    def cube(name, scale, location, made):
        bpy.ops.mesh.primitive_cube_add(size=1, location=location, scale=scale)
        bpy.context.object.name = name
        bpy.context.object.data.materials.append(made)
        return bpy.context.object

    wall, wood = material("wall", (0.6, 0.55, 0.5)), material("wood", (0.3, 0.15, 0.07))
    cube("floor", (5, 4, 0.1), (0, 0, -0.05), wall)
    cube("wall", (5, 0.1, 2.6), (0, 2.05, 1.3), wall)
    top = cube("table", (1.4, 0.8, 0.75), (0.6, 0.5, 0.375), wood)
    cube("lamp", (0.1, 0.1, 0.1), (2, 1.5, 0.05), material("glow", (1, 1, 1), 12.0))
    hidden = cube("hidden", (9, 9, 9), (0, 0, 20), wall)
    hidden.hide_render = True

    def light(kind, name, energy, location, **more):
        bpy.ops.object.light_add(type=kind, location=location)
        bpy.context.object.name = name
        bpy.context.object.data.energy = energy
        for key, value in more.items():
            setattr(bpy.context.object.data, key, value)

    light("AREA", "panel", 60.0, (0, 0, 2.5), shape="RECTANGLE", size=0.8, size_y=0.5)
    light("SUN", "sun", 1.5, (0, 0, 3), angle=0.02)
    light("POINT", "bulb", 20.0, (1, -1, 2), color=(1, 0.5, 0.25), shadow_soft_size=0.05)
    light("SPOT", "spot", 40.0, (1, 1, 2), spot_size=1.0, spot_blend=0.3)
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.12, 0.2, 1)
    world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    bpy.context.scene.world = world
    text = bpy.data.texts.new("evil.py")
    text.write(f"open({mark + '.text'!r}, 'w').close()")
    text.use_module = True
    driver = top.driver_add("rotation_euler", 2).driver
    driver.type = "SCRIPTED"
    driver.expression = f"(lambda: (open({mark + '.driver'!r}, 'w').close(), 0.0)[1])()"
    bpy.ops.wm.save_as_mainfile(filepath=out)
import os
sys.stdout.flush()
os._exit(0)
"""


def blender(path: Path, mark: Path, action: str) -> None:
    """Let Blender `write` a scene with scripts in it that leave a mark, or `open` it with scripts allowed."""
    subprocess.run(
        [sys.executable, "-c", BLENDER, str(path), str(mark), action], check=True, capture_output=True, cwd=ROOT
    )
