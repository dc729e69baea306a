"""glTF 2.0 and GLB files: materials, and whole scenes with their lights (KHR_lights_punctual)."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.formats.beside import load_scene
from multilight.scenes.assets.formats.claims import Header, read_header
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, RawPart
from multilight.scenes.assets.formats.mtl import linear, part_name
from multilight.scenes.assets.formats.scene_file import Emission, FoundLight, Imported, KeepImage, Node
from multilight.scenes.assets.info import AssetError, unreadable
from multilight.scenes.files.inside import OutsideError, inside
from multilight.scenes.files.limits import parse_json
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import matrix4, pose_of
from multilight.scenes.spec import Material

LIGHTS_KEY = "multilight_lights"
"""Extra of a glTF scene in which the Blender converter leaves the lights that glTF cannot express."""
EMISSION_NITS = 200.0
"""Luminance [cd/m²] of emission 1 where a file gives no KHR_materials_emissive_strength: a screen's white."""
_NOT_READ = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu", "EXT_texture_webp")


def read_gltf(path: Path, keep: KeepImage) -> Imported:
    """Read a GLB or glTF file; raises `AssetError` in one line with the file, what is wrong and the remedy."""
    header, _ = read_header(path)
    _check_header(path, header)
    try:
        scene = load_scene(path, path.parent)
        nodes = tuple(_nodes(scene, header, keep))
        lights = tuple(_lights(header))
    except AssetError:
        raise
    except Exception as error:  # trimesh raises whatever a broken file makes it stumble over
        raise unreadable(path, error) from error
    return Imported(nodes, lights)


def _check_header(path: Path, header: Header) -> None:
    """Refuse compression that is not read, and files beside it that are missing or lie elsewhere."""
    for extension in header.get("extensionsRequired", []):
        if extension in _NOT_READ:
            raise AssetError(f"{path} needs {extension}, which is not read; export it without compression")
    for kind in ("images", "buffers"):
        for entry in header.get(kind, []):
            uri = str(entry.get("uri", "data:"))
            if uri.startswith("data:"):
                continue
            try:
                beside = inside(path.parent, unquote(uri), beside=path.parent)
            except OutsideError:
                raise AssetError(f"{path} names {uri!r}, which must lie beside it; export it as GLB") from None
            if not beside.is_file():
                raise AssetError(f"{path} names {uri!r}, which is missing; put it beside the file or export as GLB")


def _nodes(scene: Any, header: Header, keep: KeepImage) -> Iterator[Node]:
    """Collect the nodes that hold triangles, in the world."""
    emissions = {material.get("name"): material for material in header.get("materials", [])}
    blender = LIGHTS_KEY in _extras(header)
    for name in sorted(scene.graph.nodes_geometry):
        matrix, geometry = scene.graph[name]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue
        given = getattr(mesh.visual, "material", None)
        part = _placed(raw_part(mesh, keep), Z_UP_FROM_Y_UP @ matrix[:3, :3], Z_UP_FROM_Y_UP @ matrix[:3, 3])
        yield Node(str(name), (part,), (_emission(given, emissions, keep, blender=blender),))


def _placed(part: RawPart, linear: Float64, offset: Float64) -> RawPart:
    """Move a part by an affine map."""
    if abs(np.linalg.det(linear)) < 1e-18:
        return RawPart(part.material, part.vertices[:0], part.faces[:0], None, None)
    normals = None if part.normals is None else part.normals @ np.linalg.inv(linear)
    faces = part.faces[:, ::-1] if np.linalg.det(linear) < 0 else part.faces
    return RawPart(part.material, part.vertices @ linear.T + offset, faces, normals, part.uv)


def raw_part(mesh: Any, keep: KeepImage) -> RawPart:
    """Translate one of trimesh's meshes, with its material."""
    uv = getattr(mesh.visual, "uv", None)
    given = "vertex_normals" in mesh._cache  # nowhere else does trimesh tell those of the file from its own
    return RawPart(
        pbr_material(mesh.visual, keep, has_uv=uv is not None),
        np.asarray(mesh.vertices, np.float64),
        np.asarray(mesh.faces, np.int64),
        np.asarray(mesh.vertex_normals, np.float64) if given else None,
        None if uv is None else np.asarray(uv, np.float64),
    )


def pbr_material(visual: Any, keep: KeepImage, *, has_uv: bool) -> Material:
    """Translate trimesh's material (glTF metallic-roughness, or MTL) into ours.

    glTF packs roughness (green) and metallic (blue) into one picture: roughness becomes a picture of its own,
    metallic, of which a material has one value, 0 or 1 by its mean.
    """
    given = getattr(visual, "material", None)
    if given is None:
        return Material(name="material")
    pbr = given if isinstance(given, trimesh.visual.material.PBRMaterial) else given.to_pbr()
    factor = np.asarray(pbr.baseColorFactor if pbr.baseColorFactor is not None else (255,) * 4, np.float64)
    factor = factor / 255 if factor.max() > 1 else factor
    colour = tuple(float(np.clip(v, 0, 1)) for v in factor[:3])
    textured = has_uv and pbr.baseColorTexture is not None
    packed = pbr.metallicRoughnessTexture if has_uv else None
    roughness = 1.0 if pbr.roughnessFactor is None else float(pbr.roughnessFactor)
    metallic = 1.0 if pbr.metallicFactor is None else float(pbr.metallicFactor)
    if packed is not None:
        channels = np.asarray(packed.convert("RGB"), np.float64)
        metallic *= float(np.round(channels[..., 2].mean() / 255))
    blend = pbr.alphaMode in ("BLEND", "MASK")
    return Material(
        name=part_name(str(pbr.name or "material")),
        base_color=(colour[0], colour[1], colour[2]) if pbr is given else linear(colour),
        base_color_texture=keep(pbr.baseColorTexture) if textured else None,
        roughness=float(np.clip(roughness, 0, 1)),
        roughness_texture=None if packed is None else keep(packed.convert("RGB").getchannel("G")),
        metallic=float(np.clip(metallic, 0, 1)),
        opacity=float(np.clip(factor[3], 0, 1)) if blend and not textured and len(factor) > 3 else 1.0,
        opacity_from_alpha=bool(blend and textured and pbr.baseColorTexture.mode in ("RGBA", "LA")),
        normal_texture=keep(pbr.normalTexture) if has_uv and pbr.normalTexture is not None else None,
    )


def _emission(given: Any, materials: dict[Any, Header], keep: KeepImage, *, blender: bool) -> Emission | None:
    """Return what a material emits: cd/m² where the file says how strong, else times `EMISSION_NITS`.

    Blender writes its own strengths, W/(m² sr), into the same field, and leaves out a strength of 1.
    """
    factor = getattr(given, "emissiveFactor", None)
    if factor is None or not np.any(np.asarray(factor) > 0):
        return None
    extension = materials.get(given.name, {}).get("extensions", {}).get("KHR_materials_emissive_strength", {})
    strength = float(extension.get("emissiveStrength", 1.0 if blender else EMISSION_NITS))
    picture = getattr(given, "emissiveTexture", None)
    texture = None if picture is None else keep(picture.convert("RGB"))
    return Emission(_rgb(factor, strength), "W/(m2 sr)" if blender else "nit", texture)


def _extras(header: Header) -> Header:
    """Return what the writer of the scene left beside it."""
    scene = (header.get("scenes") or [{}])[header.get("scene", 0)]
    return scene.get("extras") or {}


def _rgb(colour: Any, strength: float) -> Rgb:
    red, green, blue = (max(float(v), 0.0) * max(strength, 0.0) for v in list(colour)[:3])
    return red, green, blue


def _lights(header: Header) -> Iterator[FoundLight]:
    """Yield the punctual lights: cd for points and spots, lx for suns; and those that our Blender converter left."""
    defined = header.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    extras = _extras(header)
    if LIGHTS_KEY in extras:
        yield from (FoundLight.model_validate(light) for light in parse_json(extras[LIGHTS_KEY]))
        return
    scene = (header.get("scenes") or [{}])[header.get("scene", 0)]
    for node, matrix in _world(header, scene.get("nodes", [])):
        index = node.get("extensions", {}).get("KHR_lights_punctual", {}).get("light")
        if index is not None:
            yield _light(defined[index], node.get("name"), matrix)


def _light(light: Header, name: str | None, matrix: Float64) -> FoundLight:
    """Translate a punctual light; it shines along -Z of its node, as ours do."""
    linear = Z_UP_FROM_Y_UP @ matrix[:3, :3]
    pose = pose_of(linear / np.linalg.norm(linear, axis=0), Z_UP_FROM_Y_UP @ matrix[:3, 3])
    about: dict[str, Any] = {
        "name": str(name or light.get("name") or "light"),
        "amount": _rgb(light.get("color", (1, 1, 1)), float(light.get("intensity", 1.0))),
        "pose": matrix4(pose),
    }
    if light["type"] == "directional":
        return FoundLight(kind="sun", unit="lx", **about)
    if light["type"] == "point":
        return FoundLight(kind="point", unit="cd", **about)
    spot = light.get("spot", {})
    outer = float(np.clip(spot.get("outerConeAngle", np.pi / 4), 1e-3, 1.49))
    inner = float(np.clip(spot.get("innerConeAngle", 0.0), 0.0, outer))
    # glTF fades over the cosines between the two cones; so does `SpotLight.blend`, as a fraction of 1 - cos(outer).
    soft = (np.cos(inner) - np.cos(outer)) / (1.0 - np.cos(outer))
    return FoundLight(kind="spot", unit="cd", half_angle=outer, blend=float(np.clip(soft, 0, 1)), **about)


def _world(header: Header, roots: list[int]) -> Iterator[tuple[Header, Float64]]:
    """Yield every node of a scene with its matrix (4, 4) to the world."""
    nodes = header.get("nodes", [])
    waiting = deque((index, np.eye(4)) for index in roots)
    while waiting:
        index, above = waiting.popleft()
        matrix = above @ _local(nodes[index])
        yield nodes[index], matrix
        waiting.extend((child, matrix) for child in nodes[index].get("children", []))


def _local(node: Header) -> Float64:
    """Return a node's own matrix (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    rotation = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
    return pose_of(rotation * node.get("scale", (1, 1, 1)), node.get("translation", (0, 0, 0)))
