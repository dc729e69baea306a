"""`scenes.spec.Material` as UsdPreviewSurface."""

from typing import Any

import numpy as np
from pxr import Gf, Sdf, Sdr, UsdShade

from multilight.datagen.usd.files import Files
from multilight.datagen.usd.gains import Strength, glow_strength
from multilight.lights.spec import EmissiveLight
from multilight.scenes.assets.formats.usd.names import BASE, IMAGE, NAME, OPACITY, TRANSMISSION
from multilight.scenes.colour import LUMINANCE_WEIGHTS
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Material, Texture

_TYPES = Sdf.ValueTypeNames


class Materials:
    """Writes each distinct (material, glow) of a scene once, under `scope`; `strengths` are those of what glows."""

    def __init__(self, stage: Any, scope: str, files: Files) -> None:
        self._stage, self._scope, self._files = stage, scope, files
        self._made: dict[tuple[Material, str | None], Any] = {}
        self.strengths: list[Strength] = []

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
        network = _Network(self._stage, path, self._files)
        surface = network.surface
        # What is neither reflected nor let through is absorbed, as in coloured glass.
        dim = 1.0 if material.transmission == 0 else (1.0 - material.transmission) / _opaque_fraction(material)
        red, green, blue = (value * dim for value in material.base_color)
        colour = network.factor("diffuseColor", (red, green, blue), material.base_color_texture)
        network.factor("roughness", material.roughness, material.roughness_texture)
        network.factor("metallic", material.metallic, material.metallic_texture)
        _feed(surface, ior=material.ior, clearcoat=material.coat)
        _feed(surface, clearcoatRoughness=material.coat_roughness)
        if material.opacity_from_alpha and colour is not None:
            scale = colour.GetInput("scale")
            red, green, blue, _ = scale.Get()
            scale.Set(Gf.Vec4f(red, green, blue, material.opacity))
            _connect(surface, "opacity", colour, "a")
            if material.alpha_cutoff:
                _feed(surface, opacityThreshold=material.alpha_cutoff)
        else:  # a presence (a cut-out), or that of glass, whose reflection stays
            _feed(surface, opacity=material.opacity * _opaque_fraction(material))
        if material.transmission > 0:
            prim = made.GetPrim()
            for name, value in ((TRANSMISSION, material.transmission), (OPACITY, material.opacity)):
                prim.CreateAttribute(name, _TYPES.Float, custom=True).Set(value)
            prim.CreateAttribute(BASE, _TYPES.Color3f, custom=True).Set(Gf.Vec3f(*material.base_color))
        _feed(surface, opacityMode="transparent" if material.transmission > 0 else "presence")
        if material.normal_texture is not None:  # in tangent space, its 0 to 1 stretched to -1 to 1
            node = network.picture("normal", material.normal_texture, "raw")
            _feed(node, scale=Gf.Vec4f(2, 2, 2, 1), bias=Gf.Vec4f(-1, -1, -1, 0))
            _connect(surface, "normal", node, "rgb")
        if light is not None:
            self._glow(network, light)
        made.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", _TYPES.Token))
        return made

    def _glow(self, network: "_Network", light: EmissiveLight) -> None:
        if light.texture is None:
            target = _input(network.surface, "emissiveColor")
        else:
            node = network.picture("emissive", light.texture, "sRGB")
            _connect(network.surface, "emissiveColor", node, "rgb")
            target = _input(node, "scale")
        self.strengths.append(glow_strength(light.name, target, light.radiance, textured=light.texture is not None))


def _opaque_fraction(material: Material) -> float:
    """Return the fraction of light that a surface stops: UsdPreviewSurface knows grey glass only, and no refraction."""
    return max(1.0 - material.transmission * float(np.dot(LUMINANCE_WEIGHTS, material.base_color)), 0.01)


class _Network:
    """The shaders that feed one surface."""

    def __init__(self, stage: Any, path: str, files: Files) -> None:
        self._stage, self._path, self._files = stage, path, files
        self.surface = self._node("surface", "UsdPreviewSurface")

    def factor(self, name: str, value: float | Rgb, texture: Texture | None) -> Any:
        """Feed a number or colour: plain, or a picture times it (of a number's the first channel); return the latter.

        Colours' pictures are in sRGB, numbers' are linear.
        """
        if texture is None:
            _feed(self.surface, **{name: Gf.Vec3f(*value) if isinstance(value, tuple) else value})
            return None
        rgb, space, output = (value, "sRGB", "rgb") if isinstance(value, tuple) else ((value,) * 3, "raw", "r")
        node = self.picture(name, texture, space)
        _feed(node, scale=Gf.Vec4f(*rgb, 1.0))
        _connect(self.surface, name, node, output)
        return node

    def picture(self, name: str, texture: Texture, colour_space: str) -> Any:
        """Add the picture's shader, looked up at the mesh's `st` times its repeat."""
        node = self._node(f"{name}_texture", "UsdUVTexture")
        _feed(node, file=self._files.texture(texture.image), sourceColorSpace=colour_space)
        _feed(node, wrapS=texture.wrap, wrapT=texture.wrap)
        node.GetPrim().CreateAttribute(IMAGE, _TYPES.String, custom=True).Set(texture.image)
        placed = self._node(f"{name}_place", "UsdTransform2d")
        _feed(placed, scale=Gf.Vec2f(*texture.repeat))
        coordinates = UsdShade.Shader.Get(self._stage, f"{self._path}/st")
        if not coordinates:
            coordinates = self._node("st", "UsdPrimvarReader_float2")
            _feed(coordinates, varname="st")
        _connect(placed, "in", coordinates, "result")
        _connect(node, "st", placed, "result")
        return node

    def _node(self, name: str, kind: str) -> Any:
        made = UsdShade.Shader.Define(self._stage, f"{self._path}/{name}")
        made.CreateIdAttr(kind)
        return made


def _known(shader: Any) -> Any:
    """Return what USD itself says of a shader's inputs and outputs."""
    return Sdr.Registry().GetShaderNodeByIdentifier(shader.GetIdAttr().Get())


def _input(shader: Any, name: str) -> Any:
    return shader.CreateInput(name, _known(shader).GetShaderInput(name).GetTypeAsSdfType().GetSdfType())


def _feed(shader: Any, **values: Any) -> None:
    for name, value in values.items():
        _input(shader, name).Set(value)


def _connect(shader: Any, name: str, source: Any, output: str) -> None:
    """Feed an input from another shader's output."""
    source.CreateOutput(output, _known(source).GetShaderOutput(output).GetTypeAsSdfType().GetSdfType())
    _input(shader, name).ConnectToSource(source.ConnectableAPI(), output)
