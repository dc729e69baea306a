"""A .blend file's world as light."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from multilight.scenes.assets.environments import keep_map
from multilight.scenes.assets.formats.imported import FoundLight
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import srgb_decode


def read_world(world: Any, path_of: Callable[[Any], Path], work: Path) -> Iterator[FoundLight]:
    """Translate a world of one background node: a colour, or an environment texture turned about the vertical."""
    about: dict[str, Any] = {"kind": "environment", "name": "world", "unit": "W/(m2 sr)"}
    if world.node_tree is None or (bpy.app.version < (5, 0, 0) and not world.use_nodes):
        if max(world.color) > 0:
            yield FoundLight(amount=tuple(world.color), **about)
        return
    output = next((n for n in world.node_tree.nodes if n.type == "OUTPUT_WORLD" and n.is_active_output), None)
    node = _source(output.inputs["Surface"]) if output else None
    if node is None:
        return
    strength = node.inputs["Strength"].default_value if node.type == "BACKGROUND" else 0.0
    picture = _source(node.inputs["Color"]) if node.type == "BACKGROUND" else node
    if picture is None:
        amount = tuple(max(float(v) * strength, 0.0) for v in list(node.inputs["Color"].default_value)[:3])
        if max(amount) > 0:
            yield FoundLight(amount=amount, **about)
        return
    turned = _source(picture.inputs["Vector"]) if picture.type == "TEX_ENVIRONMENT" else None
    if picture.type != "TEX_ENVIRONMENT" or picture.image is None or node.inputs["Strength"].is_linked:
        raise AssetError("its world is neither a colour nor an environment texture; bake it into a texture")
    angle = turned.inputs["Rotation"].default_value[2] if turned is not None and turned.type == "MAPPING" else 0.0
    name = keep_map(_pixels(picture.image, path_of), Path(picture.image.filepath).name or picture.image.name, work)
    yield FoundLight(amount=(strength,) * 3, map=name, rotation=-angle, **about)


def _source(socket: Any) -> Any:
    """Return the node that feeds a socket, or None."""
    return socket.links[0].from_node if socket.is_linked else None


def _pixels(image: Any, path_of: Callable[[Any], Path]) -> np.ndarray:
    """Return a picture, linear, (H, W, 3) float32, the way Blender looks it up."""
    if image.packed_file is None and image.source == "FILE":
        path_of(image)
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    rows = np.ascontiguousarray(pixels.reshape(height, width, 4)[::-1, :, :3])
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        rows = srgb_decode(rows).astype(np.float32)
    return rows
