"""Converts a .blend file to GLB: `python -m multilight.datagen.backends.blender.convert FILE.blend FILE.glb`.

Runs in a process of its own, since it opens a file of unknown origin. No script in that file runs: neither text
blocks marked to run at start, nor drivers and handlers written in Python.
"""

import json
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from multilight.datagen.backends import blender  # finds the libraries that bpy needs

assert blender is not None
import bpy  # noqa: E402
import numpy as np  # noqa: E402
import OpenEXR  # noqa: E402
from mathutils import Matrix  # noqa: E402

from multilight.scenes.assets.formats.gltf import LIGHTS_KEY  # noqa: E402
from multilight.scenes.assets.formats.scene_file import FoundLight  # noqa: E402
from multilight.scenes.cameras.pinhole import matrix4  # noqa: E402
from multilight.scenes.colour import srgb_decode  # noqa: E402
from multilight.scenes.errors import MultilightError  # noqa: E402
from multilight.scenes.files.inside import OutsideError, held  # noqa: E402
from multilight.scenes.frozen import Rgb  # noqa: E402

WATTS_TO_INTENSITY = 1 / (4 * math.pi)
"""W/sr on the axis of a Blender point or spot light of one watt, as in `datagen.backends.blender.lights`."""


SKY = "world"
"""Name of the environment map that is written beside the GLB."""


class ConversionError(MultilightError, RuntimeError):
    """A .blend file cannot be converted: says why and what to do."""


def convert(source: Path, target: Path) -> None:
    """Write the meshes of a .blend file as GLB, with its lights in the scene's extras and its sky beside it.

    Raises `ConversionError` in one line.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        bpy.ops.wm.open_mainfile(filepath=str(source), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise ConversionError(str(error).strip().splitlines()[-1]) from error
    _check_paths(source)
    _check_images()
    scene = bpy.context.scene
    lights = [light.model_dump(mode="json") for light in _lights(scene, target)]
    for key in list(scene.keys()):
        del scene[key]
    scene[LIGHTS_KEY] = json.dumps(lights)
    bpy.ops.export_scene.gltf(
        filepath=str(target),
        export_format="GLB",
        use_renderable=True,
        use_active_scene=True,
        export_apply=True,
        export_extras=True,
        export_cameras=False,
        export_lights=False,
        export_animations=False,
        export_skins=False,
        export_morph=False,
    )


def _check_paths(source: Path) -> None:
    """Refuse what lies outside of the file's folder: pictures, linked libraries, caches."""
    for name in bpy.utils.blend_paths(absolute=True):
        path = Path(os.path.abspath(name))
        try:
            held(source.parent, path)
        except OutsideError as error:
            if path.is_file():
                raise ConversionError(
                    f"it uses a file outside: {error}; put it there, or pack it into the file"
                ) from error


def _check_images() -> None:
    """Name a texture that is used but not there."""
    for image in bpy.data.images:
        if image.source == "FILE" and image.users and image.packed_file is None:
            path = Path(bpy.path.abspath(image.filepath, library=image.library))
            if not path.is_file():
                raise ConversionError(f"texture {image.filepath!r} is missing; put it there, or pack it into the file")


def _lights(scene: Any, target: Path) -> Iterator[FoundLight]:
    """Yield the lights that the scene renders with, and its world, in radiometric units; +Z up, metres."""
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        placed = instance.object
        if placed.type == "LIGHT" and not placed.original.hide_render:
            yield _light(placed.original.name, placed.data, instance.matrix_world.copy())
    if scene.world is not None and (sky := _sky(scene.world, target)) is not None:
        yield sky


def _sky(world: Any, target: Path) -> FoundLight | None:
    """Translate a world of one background node: a colour, or an environment texture turned about the vertical."""
    about: dict[str, Any] = {"kind": "environment", "name": "world", "unit": "W/(m2 sr)"}
    if world.node_tree is None or (bpy.app.version < (5, 0, 0) and not world.use_nodes):
        return FoundLight(amount=_rgb(world.color, 1.0), **about) if max(world.color) > 0 else None
    output = next((n for n in world.node_tree.nodes if n.type == "OUTPUT_WORLD" and n.is_active_output), None)
    node = _source(output.inputs["Surface"]) if output else None
    if node is None:
        return None
    strength = node.inputs["Strength"].default_value if node.type == "BACKGROUND" else 0.0
    picture = _source(node.inputs["Color"]) if node.type == "BACKGROUND" else node
    if picture is None:
        amount = _rgb(node.inputs["Color"].default_value, strength)
        return FoundLight(amount=amount, **about) if max(amount) > 0 else None
    turned = _source(picture.inputs["Vector"]) if picture.type == "TEX_ENVIRONMENT" else None
    if picture.type != "TEX_ENVIRONMENT" or picture.image is None or node.inputs["Strength"].is_linked:
        raise ConversionError("its world is neither a colour nor an environment texture; bake it into a texture")
    angle = turned.inputs["Rotation"].default_value[2] if turned is not None and turned.type == "MAPPING" else 0.0
    _write_map(picture.image, target.with_name(f"{SKY}.exr"))
    return FoundLight(amount=_rgb((1, 1, 1), strength), map=SKY, rotation=-angle, **about)


def _source(socket: Any) -> Any:
    """Return the node that feeds a socket, or None."""
    return socket.links[0].from_node if socket.is_linked else None


def _write_map(image: Any, path: Path) -> None:
    """Write a picture as linear EXR, the way Blender looks it up."""
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    rows = np.ascontiguousarray(pixels.reshape(height, width, 4)[::-1, :, :3])
    if image.colorspace_settings.name == "sRGB" and not image.is_float:
        rows = srgb_decode(rows).astype(np.float32)
    with OpenEXR.File({}, {"RGB": rows}) as picture:
        picture.write(str(path))


def _light(name: str, light: Any, matrix: Matrix) -> FoundLight:
    """Translate one light; Blender's watts as `datagen.backends.blender.lights` explains them."""
    place, turn, stretch = matrix.decompose()
    pose = np.array(Matrix.Translation(place) @ turn.to_matrix().to_4x4())
    about: dict[str, Any] = {"name": name, "pose": matrix4(pose)}
    colour = np.array(light.color)
    if getattr(light, "use_temperature", False):
        colour *= np.array(light.temperature_color)
    power = float(light.energy) * 2.0 ** float(getattr(light, "exposure", 0.0))
    match light.type:
        case "POINT":
            amount = _rgb(colour, power * WATTS_TO_INTENSITY)
            return FoundLight(kind="point", unit="W/sr", amount=amount, radius=light.shadow_soft_size, **about)
        case "SPOT":
            half = min(light.spot_size / 2, 1.49)
            return FoundLight(
                kind="spot",
                unit="W/sr",
                amount=_rgb(colour, power * WATTS_TO_INTENSITY),
                radius=light.shadow_soft_size,
                half_angle=half,
                blend=light.spot_blend,
                **about,
            )
        case "SUN":
            return FoundLight(kind="sun", unit="W/m2", amount=_rgb(colour, power), angle=light.angle, **about)
        case _:
            round_one = light.shape in ("DISK", "ELLIPSE")
            height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
            size = light.size * stretch.x, height * stretch.y
            area = size[0] * size[1] * (math.pi / 4 if round_one else 1.0)
            return FoundLight(
                kind="area",
                unit="W/(m2 sr)",
                amount=_rgb(colour, power / (math.pi * area)),
                width=size[0],
                height=size[1],
                ellipse=round_one,
                **about,
            )


def _rgb(colour: Any, strength: float) -> Rgb:
    red, green, blue = (max(float(v), 0.0) * max(strength, 0.0) for v in list(colour)[:3])
    return red, green, blue


if __name__ == "__main__":
    try:
        convert(Path(sys.argv[1]), Path(sys.argv[2]))
    except RuntimeError as error:
        print(str(error).strip().splitlines()[-1], file=sys.stderr, flush=True)
        os._exit(1)
    # Blender's own clean-up at exit now and then waits for ever on its sound thread.
    os._exit(0)
