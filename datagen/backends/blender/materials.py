"""`scenes.spec.Material` as a Cycles shader: Principled BSDF, emission, and AOVs for the geometry buffers."""

from pathlib import Path
from typing import Any

import bpy

from multilight.datagen.backends.blender.meshes import COLORS, UV_LAYER
from multilight.datagen.backends.blender.nodes import empty_tree, maths, node
from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import Material, Texture

ALBEDO_AOV = "albedo"
SURFACE_AOV = "surface"
"""Roughness, metallic and whether there is a surface, in R, G and B."""


DECIDED = "decided"


class Materials:
    """Makes each distinct (material, emission) of a scene once."""

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._made: dict[tuple[Material, EmissiveLight | None, bool], bpy.types.Material] = {}
        self._images: dict[tuple[str, str], bpy.types.Image] = {}

    def get(
        self, material: Material, emission: EmissiveLight | None = None, *, coloured: bool = False
    ) -> bpy.types.Material:
        """Return the shader; the radiance of `emission` is added to what the surface reflects.

        `coloured`: the mesh's vertex colours multiply the base colour.
        """
        key = (material, emission, coloured)
        if key not in self._made:
            self._made[key] = self._build(*key)
        return self._made[key]

    def _build(self, material: Material, emission: EmissiveLight | None, coloured: bool) -> bpy.types.Material:
        made = bpy.data.materials.new(material.name)
        tree = empty_tree(made)
        color, alpha = self._base_color(tree, material)
        if coloured:
            vertex = node(tree, "ShaderNodeVertexColor", {})
            vertex.layer_name = COLORS
            tinted = {0: vertex.outputs["Color"], 1: color}
            color = node(tree, "ShaderNodeVectorMath", tinted, "MULTIPLY").outputs["Vector"]
        roughness = self._number(tree, material.roughness, material.roughness_texture)
        metallic = self._number(tree, material.metallic, material.metallic_texture)
        surface = node(
            tree,
            "ShaderNodeBsdfPrincipled",
            {
                "Base Color": color,
                "Roughness": roughness,
                "Metallic": metallic,
                "IOR": material.ior,
                "Alpha": _decided(tree, alpha),
                "Coat Weight": material.coat,
                "Coat Roughness": material.coat_roughness,
                "Transmission Weight": material.transmission,
            },
        )
        if material.normal_texture is not None:
            texture = self._texture(tree, material.normal_texture, "Non-Color")
            bumps = node(tree, "ShaderNodeNormalMap", {"Color": texture.outputs["Color"]})
            bumps.uv_map = UV_LAYER
            tree.links.new(bumps.outputs["Normal"], surface.inputs["Normal"])
        shader = surface.outputs["BSDF"]
        if emission is not None:
            shader = _add_emission(tree, shader, self._glow(tree, emission), alpha)
            made.cycles.emission_sampling = "FRONT_BACK"
        node(tree, "ShaderNodeOutputMaterial", {"Surface": shader})
        _write_aovs(tree, color, (roughness, metallic), alpha)
        return made

    def _number(self, tree: Any, value: float, texture: Texture | None) -> Any:
        if texture is None:
            return value
        return maths(tree, "MULTIPLY", self._texture(tree, texture, "Non-Color").outputs["Color"], value)

    def _base_color(self, tree: Any, material: Material) -> tuple[Any, Any]:
        if material.base_color_texture is None:
            return material.base_color, material.opacity
        texture = self._texture(tree, material.base_color_texture, "sRGB")
        color = node(tree, "ShaderNodeVectorMath", {0: texture.outputs["Color"], 1: material.base_color}, "MULTIPLY")
        alpha: Any = material.opacity
        if material.opacity_from_alpha:
            alpha = maths(tree, "MULTIPLY", texture.outputs["Alpha"], material.opacity)
            if material.alpha_cutoff:
                alpha = maths(tree, "SUBTRACT", 1.0, maths(tree, "LESS_THAN", alpha, material.alpha_cutoff))
        return color.outputs["Vector"], alpha

    def _glow(self, tree: Any, light: EmissiveLight) -> Any:
        """Return the radiance of a glowing part: one value, or times its texture."""
        if light.texture is None:
            return light.radiance
        colour = self._texture(tree, light.texture, "sRGB").outputs["Color"]
        return node(tree, "ShaderNodeVectorMath", {0: colour, 1: light.radiance}, "MULTIPLY").outputs["Vector"]

    def _texture(self, tree: Any, texture: Texture, colour_space: str) -> Any:
        uv = node(tree, "ShaderNodeUVMap", {})
        uv.uv_map = UV_LAYER
        tiled = node(tree, "ShaderNodeVectorMath", {0: uv.outputs["UV"], 1: (*texture.repeat, 1.0)}, "MULTIPLY")
        picture = node(tree, "ShaderNodeTexImage", {"Vector": tiled.outputs["Vector"]})
        key = (texture.image, colour_space)
        if key not in self._images:
            self._images[key] = load_image(self._library.texture_path(texture.image), colour_space)
        picture.image = self._images[key]
        picture.extension = {"repeat": "REPEAT", "clamp": "EXTEND", "mirror": "MIRROR"}[texture.wrap]
        return picture


def load_image(path: Path, colour_space: str) -> bpy.types.Image:
    """Open an image file by path; raises `BackendError` naming a missing or broken file."""
    try:
        # Never shared between colour spaces, so never `check_existing`.
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError as error:
        raise BackendError(f"cannot open image {path}: {str(error).strip()}; fetch or repair its asset") from error
    if 0 in image.size:
        raise BackendError(f"cannot decode image {path}; fetch or repair its asset")
    image.colorspace_settings.name = colour_space
    # Colours stay as stored: alpha is data of its own, not a premultiplier.
    image.alpha_mode = "CHANNEL_PACKED"
    return image


def _add_emission(tree: Any, shader: Any, emission: Any, alpha: Any) -> Any:
    """Add emission beside the Principled BSDF, whose own a coat would dim; a cut-out does not glow."""
    glow = node(tree, "ShaderNodeEmission", {"Color": emission, "Strength": alpha})
    total = node(tree, "ShaderNodeAddShader", {0: shader, 1: glow.outputs["Emission"]})
    return total.outputs["Shader"]


def _decided(tree: Any, alpha: Any) -> Any:
    """Return opacity as it is, or, where the node `DECIDED` is switched on, as 1 above one half and 0 elsewhere.

    Cycles takes see-through surfaces for hit by chance, whatever their opacity.
    """
    if alpha == 1.0:
        return alpha
    away = maths(tree, "SUBTRACT", maths(tree, "GREATER_THAN", alpha, 0.5), alpha)
    switch = node(tree, "ShaderNodeMath", {0: away, 1: 0.0, 2: alpha}, "MULTIPLY_ADD")
    switch.name = DECIDED
    return switch.outputs["Value"]


def deciding() -> list[Any]:
    """Return the switches of all materials that may be see-through."""
    trees = (material.node_tree for material in bpy.data.materials if material.node_tree is not None)
    return [tree.nodes[DECIDED].inputs[1] for tree in trees if DECIDED in tree.nodes]


def _write_aovs(tree: Any, color: Any, surface: tuple[Any, Any], alpha: Any) -> None:
    """Write the AOVs: albedo, roughness and metallic where the surface is opaque enough to count as hit.

    That is the threshold for depth and ids. Geometry that is see-through, but there, covers the environment.
    """
    shown: Any = float(alpha > 0.5) if isinstance(alpha, float) else maths(tree, "GREATER_THAN", alpha, 0.5)
    albedo = node(tree, "ShaderNodeVectorMath", {"Vector": color, "Scale": shown}, "SCALE").outputs["Vector"]
    roughness, metallic = (maths(tree, "MULTIPLY", value, shown) for value in surface)
    there: Any = float(alpha > 0) if isinstance(alpha, float) else maths(tree, "GREATER_THAN", alpha, 0.01)
    triple = node(tree, "ShaderNodeCombineXYZ", {0: roughness, 1: metallic, 2: there}).outputs["Vector"]
    for name, vector in ((ALBEDO_AOV, albedo), (SURFACE_AOV, triple)):
        output = node(tree, "ShaderNodeOutputAOV", {"Color": vector})
        output.aov_name = name
