"""Bakes what feeds an input of a shader into a picture, by Cycles."""

from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from multilight.datagen.backends.blender.trees import Feed, Groups, UnreadError
from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.assets.formats.coordinates import Place

SIDE = 1024
"""Pixels of a baked picture."""
BAKED = "baked"
"""The UV layer of a shape that has none which can be baked into."""


@dataclass
class Shape:
    """A mesh as corners of triangles in the object's own space, and what it takes to bake on it.

    points (3T, 3) and normals (3T, 3) or None, `uv` (3T, 2) by layer, `colors` (3T, 4) linear by attribute, `slots`
    (T,) number into `materials`.
    """

    name: str
    matrix: Float64
    points: Float64
    normals: Float64 | None
    slots: Int64
    materials: list[Any]
    active: str
    texspace: tuple[Any, Any]
    uv: dict[str, Float64] = field(default_factory=dict)
    colors: dict[str, Float64] = field(default_factory=dict)

    def corners(self, slot: int) -> Int64:
        """Return the corners of a material's triangles."""
        return np.flatnonzero(np.repeat(self.slots == slot, 3))


def bake(shape: Shape, slot: int, socket: Any, groups: Groups, *, colour: bool) -> Feed:
    """Bake what feeds `socket` on the triangles of a material; raises `UnreadError` where that cannot be done."""
    if groups:
        raise UnreadError("a node group")
    corners = shape.corners(slot)
    made = bpy.data.meshes.new(BAKED)
    made.from_pydata(shape.points[corners].tolist(), [], np.arange(len(corners)).reshape(-1, 3).tolist())
    for name, values in shape.uv.items():
        layer = made.uv_layers.new(name=name)
        layer.uv.foreach_set("vector", values[corners].astype(np.float32).ravel())
        layer.active_render = name == shape.active
    for name, values in shape.colors.items():
        layer = made.color_attributes.new(name, "FLOAT_COLOR", "CORNER")
        layer.data.foreach_set("color", values[corners].astype(np.float32).ravel())
    made.use_auto_texspace = False
    made.texspace_location, made.texspace_size = shape.texspace
    placed = bpy.data.objects.new(BAKED, made)
    placed.matrix_world = shape.matrix.T.tolist()
    bpy.context.scene.collection.objects.link(placed)
    bpy.context.view_layer.objects.active = placed
    for other in bpy.context.view_layer.objects:  # all that is selected is baked
        other.select_set(other == placed)
    try:
        target = _layout(placed, made, shape, corners)
        image = bpy.data.images.new(BAKED, SIDE, SIDE, is_data=not colour)
        _render(placed, made, socket, image)
    except RuntimeError as error:
        raise UnreadError(str(error).strip().splitlines()[-1]) from error
    finally:
        bpy.data.objects.remove(placed)
    return Feed(image=image, place=Place(target))


def _layout(placed: Any, made: Any, shape: Shape, corners: Int64) -> str:
    """Return the layer that is baked into: the active one where it fits into the picture, else a new one."""
    own = shape.uv.get(shape.active)
    if own is not None and np.ptp(own[corners], axis=0).min() > 1e-3 and np.abs(own[corners] - 0.5).max() < 0.5001:
        made.uv_layers.active = made.uv_layers[shape.active]
        return shape.active
    if BAKED not in shape.uv:
        shape.uv[BAKED] = np.zeros((len(shape.points), 2))
    layer = made.uv_layers.get(BAKED) or made.uv_layers.new(name=BAKED)
    made.uv_layers.active = layer
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.uv.smart_project(island_margin=0.005)
    bpy.ops.object.mode_set(mode="OBJECT")
    flat = np.empty(2 * len(corners), np.float32)
    made.uv_layers[BAKED].uv.foreach_get("vector", flat)
    shape.uv[BAKED][corners] = flat.reshape(-1, 2)
    return BAKED


def _render(placed: Any, made: Any, socket: Any, image: Any) -> None:
    """Let a copy of the material give off what feeds the socket, and bake that."""
    copy = next(m for m in bpy.data.materials if m.node_tree == socket.node.id_data).copy()
    made.materials.append(copy)
    tree = copy.node_tree
    fed = tree.nodes[socket.node.name].inputs[list(socket.node.inputs).index(socket)]
    glow, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(fed.links[0].from_socket, glow.inputs["Color"])
    tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
    output.is_active_output = True
    target = tree.nodes.new("ShaderNodeTexImage")
    target.image = image
    tree.nodes.active = target
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 4
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    bpy.ops.object.bake(type="EMIT", margin=8, use_clear=True)
    bpy.data.materials.remove(copy)
