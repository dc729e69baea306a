"""`scenes.spec.Material` as UsdPreviewSurface."""

from typing import Any

import numpy as np
from pxr import Gf, Sdf, UsdShade

from multilight.datagen.usd.files import Files
from multilight.datagen.usd.gains import GlowStrength, photometric
from multilight.lights.spec import EmissiveLight
from multilight.scenes.assets.formats.usd.names import BASE, IMAGE, NAME, OPACITY, TRANSMISSION
from multilight.scenes.colour import LUMINANCE_WEIGHTS
from multilight.scenes.spec import Material, Texture

_TYPES = Sdf.ValueTypeNames


class Materials:
    """Writes each distinct (material, glow) of a scene once, under `scope`; `strengths` are those of what glows."""

    def __init__(self, stage: Any, scope: str, files: Files) -> None:
        self._stage, self._scope, self._files = stage, scope, files
        self._made: dict[tuple[Material, str | None], Any] = {}
        self.strengths: list[GlowStrength] = []

    def get(self, material: Material, light: EmissiveLight | None = None) -> Any:
        """Return the UsdShade material of a surface, and of the light that its part gives off."""
        key = (material, None if light is None else light.name)
        if key not in self._made:
            path = f"{self._scope}/material_{len(self._made):03d}"
            self._made[key] = self._build(path, material, light)
        return self._made[key]

    def _build(self, path: str, material: Material, light: EmissiveLight | None) -> Any:
        made = UsdShade.Material.Define(self._stage, path)
        made.GetPrim().CreateAttribute(NAME, _TYPES.String, custom=True).Set(material.name)
        surface = UsdShade.Shader.Define(self._stage, f"{path}/surface")
        surface.CreateIdAttr("UsdPreviewSurface")
        network = _Network(self._stage, path, surface, self._files)
        opaque = _opaque_fraction(material)
        # What is neither reflected nor let through is absorbed, as in coloured glass.
        dim = 1.0 if material.transmission == 0 else (1.0 - material.transmission) / opaque
        red, green, blue = (value * dim for value in material.base_color)
        network.colour("diffuseColor", (red, green, blue), material.base_color_texture)
        network.number("roughness", material.roughness, material.roughness_texture)
        network.number("metallic", material.metallic, material.metallic_texture)
        for name, value in (
            ("ior", material.ior),
            ("clearcoat", material.coat),
            ("clearcoatRoughness", material.coat_roughness),
        ):
            surface.CreateInput(name, _TYPES.Float).Set(value)
        _clear(network, made.GetPrim(), material)
        if material.normal_texture is not None:
            network.normal(material.normal_texture)
        if light is not None:
            self._glow(network, light)
        made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", _TYPES.Token))
        return made

    def _glow(self, network: "_Network", light: EmissiveLight) -> None:
        level = photometric(light.radiance)
        if light.texture is None:
            target = network.surface.CreateInput("emissiveColor", _TYPES.Color3f)
        else:
            node = network.picture("emissive", light.texture, "sRGB")
            network.connect("emissiveColor", _TYPES.Color3f, node, "rgb", _TYPES.Float3)
            target = node.CreateInput("scale", _TYPES.Float4)
        self.strengths.append(GlowStrength(light.name, target, level, textured=light.texture is not None))


def _opaque_fraction(material: Material) -> float:
    """Return the fraction of light that a surface stops: UsdPreviewSurface knows grey glass only, and no refraction."""
    return max(1.0 - material.transmission * float(np.dot(LUMINANCE_WEIGHTS, material.base_color)), 0.01)


def _clear(network: "_Network", prim: Any, material: Material) -> None:
    """Write opacity: a presence (a cut-out), or that of glass, whose reflection stays."""
    surface = network.surface
    if material.opacity_from_alpha and material.base_color_texture is not None:
        node = UsdShade.Shader(network.nodes["diffuseColor"])
        scale = node.GetInput("scale")
        red, green, blue, _ = scale.Get()
        scale.Set(Gf.Vec4f(red, green, blue, material.opacity))
        network.connect("opacity", _TYPES.Float, node, "a", _TYPES.Float)
        if material.alpha_cutoff:
            surface.CreateInput("opacityThreshold", _TYPES.Float).Set(material.alpha_cutoff)
    else:
        surface.CreateInput("opacity", _TYPES.Float).Set(material.opacity * _opaque_fraction(material))
    if material.transmission > 0:
        for name, value in ((TRANSMISSION, material.transmission), (OPACITY, material.opacity)):
            prim.CreateAttribute(name, _TYPES.Float, custom=True).Set(value)
        prim.CreateAttribute(BASE, _TYPES.Color3f, custom=True).Set(Gf.Vec3f(*material.base_color))
    mode = "transparent" if material.transmission > 0 else "presence"
    surface.CreateInput("opacityMode", _TYPES.Token).Set(mode)


class _Network:
    """The shaders that feed one surface."""

    def __init__(self, stage: Any, path: str, surface: Any, files: Files) -> None:
        self._stage, self._path, self._files = stage, path, files
        self.surface = surface
        self.nodes: dict[str, Any] = {}

    def colour(self, name: str, value: tuple[float, float, float], texture: Texture | None) -> None:
        """Feed a colour: plain, or a picture in sRGB times it."""
        if texture is None:
            self.surface.CreateInput(name, _TYPES.Color3f).Set(Gf.Vec3f(*value))
            return
        node = self.picture(name, texture, "sRGB")
        node.CreateInput("scale", _TYPES.Float4).Set(Gf.Vec4f(*value, 1.0))
        self.connect(name, _TYPES.Color3f, node, "rgb", _TYPES.Float3)

    def number(self, name: str, value: float, texture: Texture | None) -> None:
        """Feed a number: plain, or the first channel of a linear picture times it."""
        if texture is None:
            self.surface.CreateInput(name, _TYPES.Float).Set(value)
            return
        node = self.picture(name, texture, "raw")
        node.CreateInput("scale", _TYPES.Float4).Set(Gf.Vec4f(value, value, value, 1.0))
        self.connect(name, _TYPES.Float, node, "r", _TYPES.Float)

    def normal(self, texture: Texture) -> None:
        """Feed the shading normal: a picture in tangent space, its 0 to 1 stretched to -1 to 1."""
        node = self.picture("normal", texture, "raw")
        node.CreateInput("scale", _TYPES.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
        node.CreateInput("bias", _TYPES.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        self.connect("normal", _TYPES.Normal3f, node, "rgb", _TYPES.Float3)

    def picture(self, name: str, texture: Texture, colour_space: str) -> Any:
        """Add the picture's shader, looked up at the mesh's `st` times its repeat."""
        node = UsdShade.Shader.Define(self._stage, f"{self._path}/{name}_texture")
        node.CreateIdAttr("UsdUVTexture")
        node.CreateInput("file", _TYPES.Asset).Set(self._files.texture(texture.image))
        node.CreateInput("sourceColorSpace", _TYPES.Token).Set(colour_space)
        for axis in ("wrapS", "wrapT"):
            node.CreateInput(axis, _TYPES.Token).Set(texture.wrap)
        node.GetPrim().CreateAttribute(IMAGE, _TYPES.String, custom=True).Set(texture.image)
        placed = UsdShade.Shader.Define(self._stage, f"{self._path}/{name}_place")
        placed.CreateIdAttr("UsdTransform2d")
        placed.CreateInput("scale", _TYPES.Float2).Set(Gf.Vec2f(*texture.repeat))
        placed.CreateInput("in", _TYPES.Float2).ConnectToSource(self._coordinates(), "result")
        placed.CreateOutput("result", _TYPES.Float2)
        node.CreateInput("st", _TYPES.Float2).ConnectToSource(placed.ConnectableAPI(), "result")
        self.nodes[name] = node.GetPrim()
        return node

    def connect(self, name: str, kind: Any, node: Any, output: str, output_kind: Any) -> None:
        """Feed an input from a picture's output."""
        node.CreateOutput(output, output_kind)
        self.surface.CreateInput(name, kind).ConnectToSource(node.ConnectableAPI(), output)

    def _coordinates(self) -> Any:
        path = f"{self._path}/st"
        node = UsdShade.Shader.Get(self._stage, path)
        if not node:
            node = UsdShade.Shader.Define(self._stage, path)
            node.CreateIdAttr("UsdPrimvarReader_float2")
            node.CreateInput("varname", _TYPES.String).Set("st")
            node.CreateOutput("result", _TYPES.Float2)
        return node.ConnectableAPI()
