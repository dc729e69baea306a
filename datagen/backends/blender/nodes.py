"""Shader nodes: an empty tree, and nodes with their inputs."""

from typing import Any

import bpy


def empty_tree(holder: Any) -> Any:
    """Return the node tree of a material, light or world without a node in it."""
    if holder.node_tree is None:  # what is made through the data API starts without nodes in Blender 4, with them in 5
        holder.use_nodes = True
    holder.node_tree.nodes.clear()
    return holder.node_tree


def node(tree: Any, kind: str, inputs: dict[Any, Any] | None = None, operation: str | None = None) -> Any:
    """Add a node; an input is a socket to link or a plain value (RGB is padded to RGBA where needed)."""
    made = tree.nodes.new(kind)
    if operation is not None:
        made.operation = operation
    for key, value in (inputs or {}).items():
        socket = made.inputs[key]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        elif socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value
    return made


def maths(tree: Any, operation: str, *inputs: Any) -> Any:
    """Add a node that calculates with one to three numbers; return its result."""
    return node(tree, "ShaderNodeMath", dict(enumerate(inputs)), operation).outputs["Value"]
