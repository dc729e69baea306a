"""One room made in Blender and saved as .blend, GLB and USD: `python -m tests.scenes.same_room FOLDER`.

It holds what all three formats can say: pictures repeated and in channels, a normal map, a cut-out, metal, lacquer and
glass, several materials on one thing, copies, a modifier, parents, a lamp that glows, a sun through a window.
"""

import math
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from multilight.datagen.backends import blender as blender  # before bpy

Y, X = np.mgrid[0:32, 0:32] / 32
SQUARES = ((np.floor(X * 4) + np.floor(Y * 4)) % 2)[..., None]
SLOPE = np.stack([0.5 * np.sin(X * 8 * np.pi), 0 * X, 1 + 0 * X], -1)
PICTURES = {
    "tiles": SQUARES * (0.75, 0.7, 0.6) + (1 - SQUARES) * (0.25, 0.1, 0.08),
    "wood": (0.45, 0.28, 0.15) + np.sin(X * 40)[..., None] * (0.15, 0.1, 0.05),
    "orm": np.concatenate([1 + 0 * SQUARES, 0.2 + 0.7 * SQUARES, np.floor(Y * 4)[..., None] % 2], -1),
    "waves": SLOPE / np.linalg.norm(SLOPE, axis=-1, keepdims=True) * 0.5 + 0.5,
    "leaf": np.dstack([0.1 + 0 * X, 0.4 + 0 * X, 0.08 + 0 * X, (X - 0.5) ** 2 + (Y - 0.5) ** 2 < 0.2]),
}
LENGTH, DEPTH, HEIGHT = 5.0, 4.0, 2.6


def make(folder: Path) -> None:
    """Write room.blend, room.glb and room.usdc."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)

    def picture(tree: Any, name: str, scale: float = 0.0) -> Any:
        pixels = PICTURES[name]
        image = bpy.data.images.new(name, 32, 32, alpha=pixels.shape[2] == 4, is_data=name in ("orm", "waves"))
        rgba = np.ones((32, 32, 4), np.float32)
        rgba[..., : pixels.shape[2]] = pixels
        image.pixels.foreach_set(rgba.ravel())
        image.filepath_raw, image.file_format = str(folder / f"{name}.png"), "PNG"
        image.save()
        image.pack()
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = image
        if scale:
            place, layer = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeUVMap")
            place.inputs["Scale"].default_value, layer.uv_map = (scale, scale, 1), "UVMap"
            tree.links.new(layer.outputs[0], place.inputs[0])
            tree.links.new(place.outputs[0], node.inputs[0])
        return node

    def material(name: str, colour: tuple[float, ...] = (0.8, 0.8, 0.8), **values: Any) -> tuple[Any, Any, Any]:
        made = bpy.data.materials.new(name)
        made.use_nodes = True
        surface = made.node_tree.nodes["Principled BSDF"]
        surface.inputs["Base Color"].default_value = (*colour, 1)
        for key, value in values.items():
            surface.inputs[key.replace("_", " ")].default_value = value
        return made, made.node_tree, surface.inputs

    floor, tree, to = material("floor", Roughness=0.4)
    tree.links.new(picture(tree, "tiles", 3).outputs[0], to["Base Color"])
    wall, tree, to = material("wall", (0.7, 0.72, 0.68), Roughness=0.9)
    bend = tree.nodes.new("ShaderNodeNormalMap")
    tree.links.new(picture(tree, "waves", 6).outputs[0], bend.inputs["Color"])
    tree.links.new(bend.outputs[0], to["Normal"])
    oak, tree, to = material("oak")
    tree.links.new(picture(tree, "wood").outputs[0], to["Base Color"])
    parted = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(picture(tree, "orm").outputs[0], parted.inputs[0])
    tree.links.new(parted.outputs[1], to["Roughness"])
    tree.links.new(parted.outputs[2], to["Metallic"])
    leaf, tree, to = material("leaf", Roughness=0.6)
    node = picture(tree, "leaf")
    tree.links.new(node.outputs[0], to["Base Color"])
    tree.links.new(node.outputs["Alpha"], to["Alpha"])
    steel = material("steel", (0.6, 0.6, 0.65), Metallic=1, Roughness=0.25)[0]
    lacquer = material("lacquer", (0.5, 0.03, 0.03), Coat_Weight=1, Coat_Roughness=0.05)[0]
    glass = material("glass", (0.95, 1, 0.97), Transmission_Weight=1, Roughness=0, IOR=1.45)[0]
    glow = material("glow", Emission_Color=(1, 0.6, 0.3, 1), Emission_Strength=6)[0]

    def named(name: str, *materials: Any, scale: tuple[float, float, float] = (1, 1, 1)) -> Any:
        made = bpy.context.object
        made.name, made.scale = name, scale
        for one in materials:
            made.data.materials.append(one)
        return made

    def box(name: str, size: tuple[float, float, float], at: tuple[float, float, float], *materials: Any) -> Any:
        bpy.ops.mesh.primitive_cube_add(size=1, location=at)
        return named(name, *materials, scale=size)

    def sheet(name: str, size: tuple[float, float], at: Any, turn: Any, of: Any) -> Any:
        bpy.ops.mesh.primitive_plane_add(size=1, location=at, rotation=turn)
        return named(name, of, scale=(*size, 1))

    def ball(name: str, radius: float, at: tuple[float, float, float], of: Any) -> None:
        bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=at, segments=24, ring_count=12)
        bpy.ops.object.shade_smooth()
        named(name, of)

    quarter, side = math.pi / 2, LENGTH / 2
    sheet("Floor", (LENGTH, DEPTH), (0, 0, 0), (0, 0, 0), floor)
    sheet("Ceiling", (LENGTH, DEPTH), (0, 0, HEIGHT), (math.pi, 0, 0), wall)
    sheet("North", (LENGTH, HEIGHT), (0, DEPTH / 2, HEIGHT / 2), (quarter, 0, 0), wall)
    sheet("South", (LENGTH, HEIGHT), (0, -DEPTH / 2, HEIGHT / 2), (-quarter, 0, 0), wall)
    sheet("West", (DEPTH, HEIGHT), (-side, 0, HEIGHT / 2), (quarter, 0, quarter), wall)
    for name, size, at in (("Sill", (0.1, DEPTH, 0.9), (side, 0, 0.45)), ("Lintel", (0.1, DEPTH, 0.5), (side, 0, 2.35)),
                           ("Left", (0.1, 1.2, 1.2), (side, -1.4, 1.5)), ("Right", (0.1, 1.2, 1.2), (side, 1.4, 1.5)),
                           ):  # fmt: skip
        box(name, size, at, wall)
    box("Frame", (0.06, 0.05, 1.2), (side, 0, 1.5), steel)
    box("Top", (1.4, 0.8, 0.05), (0.4, 0.5, 0.725), oak).modifiers.new("edges", "BEVEL").width = 0.01
    leg = box("Leg", (0.06, 0.06, 0.7), (-0.2, 0.2, 0.35), steel)
    for x, y in ((1.2, 0), (0, 0.6), (1.2, 0.6)):
        copy = leg.copy()
        copy.location = (x - 0.2, y + 0.2, 0.35)
        bpy.context.scene.collection.objects.link(copy)
    sides = box("Cupboard", (0.5, 1.2, 0.8), (-2.2, -0.4, 0.4), lacquer, oak).data.polygons
    sides[0].material_index = sides[3].material_index = 1
    ball("Ball", 0.12, (-2.2, -0.1, 0.92), glass)
    ball("Lamp", 0.09, (-2.2, -0.8, 0.89), glow)
    pot = bpy.data.objects.new("Pot", None)
    bpy.context.scene.collection.objects.link(pot)
    pot.location, pot.scale, pot.rotation_euler = (1.8, -1.2, 0), (1.5, 1.5, 1.5), (0, 0, 0.6)
    for number in range(2):
        sheet(f"Leaf{number}", (0.5, 0.5), (0, 0, 0.3), (quarter, 0, number * quarter), leaf).parent = pot

    def light(kind: str, name: str, energy: float, at: Any, turn: Any = (0, 0, 0), **values: Any) -> None:
        bpy.ops.object.light_add(type=kind, location=at, rotation=turn)
        made = named(name)
        for key, value in ({"energy": energy} | values).items():
            setattr(made.data, key, value)

    light("SUN", "Sun", 3, (3, 0, 3), (0, math.radians(55), 0.3), angle=0.0093)
    light("POINT", "Bulb", 60, (0, 0, 2.2), color=(1, 0.8, 0.6), shadow_soft_size=0)
    light("SPOT", "Spot", 80, (0.4, -0.8, 2.3), (0.5, 0, 0), spot_size=0.9, spot_blend=0.3, shadow_soft_size=0)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "room.blend"))
    bpy.ops.export_scene.gltf(filepath=str(folder / "room.glb"), export_lights=True, export_apply=True)
    # UsdPreviewSurface has no word for glass.
    bpy.ops.wm.usd_export(filepath=str(folder / "room.usdc"), generate_materialx_network=True)
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    make(Path(sys.argv[1]))
