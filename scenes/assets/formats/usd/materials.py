"""Surfaces of UsdPreviewSurface and MaterialX, and the pictures that feed them."""

import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import Usd, UsdShade

from multilight.scenes.assets.formats.coordinates import Place, Wrap, affine_of, common
from multilight.scenes.assets.formats.imported import EMISSION_NITS, Emission
from multilight.scenes.assets.formats.mtl import part_name
from multilight.scenes.assets.formats.pictures import as_eight_bit
from multilight.scenes.assets.formats.usd.names import BASE, IMAGE, NAME, NITS, OPACITY, OWN, TRANSMISSION
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import LUMINOUS_EFFICACY, srgb_decode, srgb_encode
from multilight.scenes.files import limits
from multilight.scenes.files.confined import OutsideError, held
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Material, Texture

_WHITE = (1.0, 1.0, 1.0)


_SURFACES = {
    "ND_open_pbr_surface_surfaceshader": {
        "diffuseColor": "base_color", "roughness": "specular_roughness", "metallic": "base_metalness",
        "ior": "specular_ior", "clearcoat": "coat_weight", "clearcoatRoughness": "coat_roughness",
        "opacity": "geometry_opacity", "emissiveColor": "emission_color", "through": "transmission_weight",
        "glow": "emission_luminance", "normal": "geometry_normal",
    },
    "ND_standard_surface_surfaceshader": {
        "diffuseColor": "base_color", "roughness": "specular_roughness", "metallic": "metalness",
        "ior": "specular_IOR", "clearcoat": "coat", "clearcoatRoughness": "coat_roughness", "opacity": "opacity",
        "emissiveColor": "emission_color", "through": "transmission", "glow": "emission", "normal": "normal",
    },
    "ND_gltf_pbr_surfaceshader": {
        "diffuseColor": "base_color", "clearcoatRoughness": "clearcoat_roughness", "opacity": "alpha",
        "emissiveColor": "emissive", "through": "transmission", "glow": "emissive_strength",
    },
}  # fmt: skip
"""MaterialX surfaces, and what their inputs are called that UsdPreviewSurface has; `glow` multiplies the emission."""
SURFACES = ("UsdPreviewSurface", "ND_UsdPreviewSurface_surfaceshader", *_SURFACES)
PICTURED = ("diffuseColor", "roughness", "normal", "emissiveColor", "metallic", "opacity")
"""Inputs whose pictures are carried."""
_NEUTRAL = {
    "fuzz_weight": "sheen", "sheen": "sheen", "sheen_color": "sheen", "subsurface_weight": "light below the surface",
    "subsurface": "light below the surface", "specular_roughness_anisotropy": "anisotropy",
    "specular_anisotropy": "anisotropy", "anisotropy_strength": "anisotropy", "thin_film_weight": "a thin film",
    "thin_film_thickness": "a thin film",
}  # fmt: skip
"""Inputs of MaterialX surfaces that are not carried where they are above 0."""
_LEVELS = np.arange(256) / 255
_DULL = {"diffuseColor": (0.8, 0.8, 0.8), "roughness": 0.3}
"""What MaterialX surfaces have where they say nothing."""


@dataclass(frozen=True)
class Picture:
    """A picture that feeds an input: `image` is the channel asked for, `scale` multiplies it (R, G, B, A).

    `asset` is the id that the project's own stages name it by; `file` is the picture's file as the stage has it.
    """

    image: Image.Image
    file: str
    scale: tuple[float, float, float, float]
    place: Place
    asset: str | None


TextureOf = Callable[[Picture, str], Texture]
"""Stores a picture in a mode ("RGB", "RGBA", "L") and returns the texture that stands for it."""
Tell = Callable[[Any, str, str, str], None]
"""Takes what is not carried: place, feature, what happens instead, remedy."""
NOW = Usd.TimeCode.EarliestTime()
"""The time of the stage that is read: what moves is as it begins, what does not is as it is."""


def bound_surface(prim: Any) -> Any:
    """Return the surface shader bound to a prim; None where there is none.

    UsdPreviewSurface goes before MaterialX, unless that lets light through, for which the other has no word.
    """
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    found = [material.ComputeSurfaceSource(context)[0] for context in ("", "mtlx")] if material else []
    found = [shader for shader in found if shader and shader.GetIdAttr().Get() in SURFACES]
    clear = [s for s in found if (t := _SURFACES.get(s.GetIdAttr().Get(), {}).get("through")) and inputs_of(s)(t, 0.0)]
    return next(iter(clear or found), None)


def by_blender(stage: Any) -> bool:
    """Tell whether Blender wrote a stage: its lights and emissions are in watts."""
    return str(stage.GetRootLayer().documentation).startswith("Blender v")


def title_of(prim: Any) -> str:
    """Return a prim's name; in stages by Blender, where things are named after their data, that of its object."""
    parent = prim.GetParent()
    named = by_blender(prim.GetStage()) and parent.GetTypeName() == "Xform" and not parent.GetParent().IsPseudoRoot()
    return str((parent if named else prim).GetName())


def _source(owner: Any, name: str) -> Any:
    """Return what an input's value comes of, through graphs and interfaces: an input or an output; None: nothing."""
    given = owner.GetInput(name)
    found = given.GetValueProducingAttributes() if given else []
    return found[0] if found else None


def _feeding(owner: Any, name: str) -> Any:
    """Return the output that feeds an input; None where none does."""
    source = _source(owner, name)
    return source if source is not None and source.GetName().startswith("outputs:") else None


def inputs_of(owner: Any) -> Callable[[str, Any], Any]:
    """Return a function that looks an input's value up: (name, fallback) -> value."""

    def value(name: str, fallback: Any) -> Any:
        source = _source(owner, name)
        fed = source is not None and source.GetName().startswith("outputs:")
        given = owner.GetInput(name).Get(NOW) if fed else None if source is None else source.Get(NOW)
        return fallback if given is None else given

    return value


def rgb_of(colour: Any) -> Rgb:
    """Return a colour as non-negative floats."""
    red, green, blue = (max(float(v), 0.0) for v in colour)
    return red, green, blue


@dataclass(frozen=True)
class Surface:
    """A surface as it was read: its material, what it gives off, the place of its coordinates, its vertex colours."""

    material: Material
    emission: Emission | None
    place: Place
    colors: str | None = None


def read_material(
    path: Path, shader: Any, texture_of: TextureOf, *, has_uv: bool, tell: Tell = lambda *_: None
) -> Surface:
    """Translate a surface of the stage at `path`; raises `AssetError` for a picture that cannot be read."""
    names = _SURFACES.get(shader.GetIdAttr().Get(), {})
    stated, found = inputs_of(shader), {}

    def value(name: str, fallback: Any) -> Any:
        return stated(names.get(name, name), _DULL.get(name, fallback) if names else fallback)

    def note(name: str, feature: str, instead: str) -> None:
        tell(shader.GetPath(), f"its {names.get(name, name)} {feature}", instead, "bake it into a picture")

    for name in PICTURED if has_uv else ():
        picture = _picture(path, shader, names.get(name, name), colour=name.endswith("Color"))
        if picture is not None:
            found[name] = picture
    colors = _vertex_colours(shader, names.get("diffuseColor", "diffuseColor"))
    for name in (*PICTURED, "ior", "clearcoat", "clearcoatRoughness", "through", "glow"):
        feeding = _feeding(shader, names.get(name, name))
        if feeding is not None and name not in found and not (name == "diffuseColor" and colors):
            kind = UsdShade.Shader(feeding.GetPrim()).GetIdAttr().Get()
            note(name, f"comes of a {kind}", "its plain value is shown")
    for name, words in _NEUTRAL.items() if names else ():
        if np.max(stated(name, 0.0)) > 0:
            tell(shader.GetPath(), words, "the surface is shown without", "none")
    at = common([picture.place for picture in found.values()])
    elsewhere = {k for k, v in found.items() if k not in ("diffuseColor", "opacity") and v.place.within(at) is None}
    for name in sorted(elsewhere):
        note(name, "has a picture that lies in another way", "one value stands for it")

    def number(name: str, fallback: float) -> float:
        picture = found.get(name)
        if picture is None:
            return _share(value(name, fallback))
        return _share(picture.scale[0] * (_mean(picture) if name in elsewhere else 1.0))

    def texture(name: str, mode: str) -> Texture | None:
        return _texture(None if name in elsewhere else found.get(name), mode, texture_of=texture_of, at=at)

    colour, clear = found.get("diffuseColor"), found.get("opacity")
    cut_out = colour is not None and clear is not None and clear.file == colour.file
    stop = _first(value("opacity", 1.0))
    if clear is not None:  # of another picture: its mean
        stop = clear.scale[3] if cut_out else clear.scale[0] * _mean(clear)
        if not cut_out:
            note("opacity", "comes of a picture of its own", "one value, its mean")
    opacity, transmission = _clearness(shader, stop)
    own_name, own_base = (shader.GetPrim().GetParent().GetAttribute(name).Get() for name in (NAME, BASE))
    dim = _share(stated("base_weight", stated("base", 1.0))) if names else 1.0
    base = _level(colour, value("diffuseColor", (0.18, 0.18, 0.18))) if own_base is None else rgb_of(own_base)
    base = _WHITE if colors else base
    ior = float(value("ior", 1.5))
    if value("useSpecularWorkflow", 0):
        zero = min(float(np.mean(value("specularColor", (0.0, 0.0, 0.0)))), 0.25)
        ior = (1 + zero**0.5) / (1 - zero**0.5)
    threshold = _share(value("opacityThreshold", 0.0)) if cut_out else 0.0
    material = Material(
        name=own_name or part_name(shader.GetPrim().GetParent().GetName()),
        base_color=(base[0] * dim, base[1] * dim, base[2] * dim),
        base_color_texture=texture("diffuseColor", "RGBA" if cut_out else "RGB"),
        roughness=number("roughness", 0.5),
        roughness_texture=texture("roughness", "L"),
        metallic=number("metallic", 0.0),
        metallic_texture=texture("metallic", "L"),
        ior=float(np.clip(ior, 1.0, 3.0)),
        coat=_share(value("clearcoat", 0.0)),
        coat_roughness=_share(value("clearcoatRoughness", 0.01)),
        transmission=_share(value("through", 0.0)) if names else transmission,
        opacity=opacity,
        opacity_from_alpha=cut_out,
        alpha_cutoff=threshold,
        normal_texture=texture("normal", "RGB"),
    )
    glow = _level(found.get("emissiveColor"), value("emissiveColor", (0.0, 0.0, 0.0)))
    strength = float(value("glow", 0.0)) if names else 1.0
    if max(glow) * strength == 0:
        return Surface(material, None, at, colors)
    unit = strength * (1.0 if names.get("glow") == "emission_luminance" else _emission_nits(shader))
    amount = (glow[0] * unit, glow[1] * unit, glow[2] * unit)
    return Surface(material, Emission(amount=amount, texture=texture("emissiveColor", "RGB")), at, colors)


def _first(value: Any) -> float:
    """Return a number, or the first of a colour's."""
    return float(value[0]) if hasattr(value, "__len__") else float(value)


def _mean(picture: Picture) -> float:
    return float(np.asarray(picture.image.convert("L"), np.float64).mean()) / 255


def _vertex_colours(shader: Any, name: str) -> str | None:
    """Return the primvar of colours that feeds an input; None where none does."""
    feeding = _feeding(shader, name)
    node = UsdShade.Shader(feeding.GetPrim()) if feeding is not None else None
    kind = str(node.GetIdAttr().Get()) if node else ""
    if kind.startswith(("UsdPrimvarReader_float", "ND_geompropvalue_color", "ND_geomcolor_color")):
        return str(inputs_of(node)("varname", inputs_of(node)("geomprop", "displayColor")))
    return None


def _clearness(shader: Any, opacity: Any) -> tuple[float, float]:
    """Return opacity and transmission: those that the project's own stages state, else all is opacity."""
    prim = shader.GetPrim().GetParent()
    through = prim.GetAttribute(TRANSMISSION).Get()
    if through is None:
        return _share(opacity), 0.0
    return _share(prim.GetAttribute(OPACITY).Get()), _share(through)


def _emission_nits(shader: Any) -> float:
    """Return the luminance [cd/m²] of an emissive colour of 1: stated by the project's own stages, else a guess."""
    if by_blender(shader.GetPrim().GetStage()):
        return LUMINOUS_EFFICACY
    said = shader.GetPrim().GetStage().GetRootLayer().customLayerData.get(OWN, {})
    return 1.0 if said.get("emissiveColor") == NITS else EMISSION_NITS


def _share(value: Any) -> float:
    return float(np.clip(value, 0.0, 1.0))


def _level(picture: Picture | None, plain: Any) -> Rgb:
    return rgb_of(plain if picture is None else picture.scale[:3])


def _texture(picture: Picture | None, mode: str, *, texture_of: TextureOf, at: Place) -> Texture | None:
    if picture is None:
        return None
    repeat = picture.place.within(at) or (1.0, 1.0)
    return texture_of(picture, mode).model_copy(update={"repeat": repeat, "wrap": picture.place.wrap})


def _picture(path: Path, shader: Any, name: str, *, colour: bool) -> Picture | None:
    """Open the picture that feeds an input, a colour (in sRGB then) or a number; None where none does."""
    output = _feeding(shader, name)
    node: Any = UsdShade.Shader(output.GetPrim()) if output is not None else None
    kind, channel = (str(node.GetIdAttr().Get()), output.GetBaseName()) if node else ("", "")
    if kind.startswith(("ND_normalmap", "ND_convert_", "ND_separate")):
        inner = _picture(path, node, "in", colour=colour)
        return inner if inner is None or not kind.startswith("ND_separate") else _channel(inner, channel[-1:])
    if kind != "UsdUVTexture" and not kind.startswith(("ND_image_", "ND_tiledimage_", "ND_UsdUVTexture")):
        return None
    value = inputs_of(node)
    file = value("file", None)
    image = open_picture(path, file, node.GetPath())
    space = str(value("sourceColorSpace", "") or node.GetInput("file").GetAttr().GetColorSpace()).lower()
    if colour and space.startswith(("raw", "lin")):
        image = image.convert("RGB").point([round(255 * float(v)) for v in srgb_encode(_LEVELS)] * 3)
    elif not colour and space.startswith("srgb") and name != "opacity":
        image = image.convert("RGB").point([round(255 * float(v)) for v in srgb_decode(_LEVELS)] * 3)
    red, green, blue, alpha = (max(float(v), 0.0) for v in value("scale", (1.0, 1.0, 1.0, 1.0)))
    own = node.GetPrim().GetAttribute(IMAGE).Get()
    return _channel(Picture(image, file.resolvedPath, (red, green, blue, alpha), _place(node), own), channel)


def _channel(picture: Picture, name: str) -> Picture:
    if name not in ("r", "g", "b") or picture.image.mode not in ("RGB", "RGBA"):
        return picture
    return replace(picture, image=picture.image.getchannel(name.upper()))


def _place(node: Any) -> Place:
    """Return how a picture lies: by which primvar, transformed how, and what is beyond it."""
    value = inputs_of(node)
    wrap = str(value("wrapS", value("uaddressmode", "repeat")))
    layer, affine = "st", np.eye(3)
    if node.GetIdAttr().Get().startswith("ND_tiledimage_"):
        affine = np.diag([*value("uvtiling", (1.0, 1.0)), 1.0]).astype(np.float64)
        affine[:2, 2] = value("uvoffset", (0.0, 0.0))
    feeds: tuple[str, ...] = ("st", "texcoord")
    for _ in range(limits.MOST_LEVELS):  # nodes may feed each other in a circle
        feed = next((found for name in feeds if (found := _feeding(node, name)) is not None), None)
        if feed is None:
            break
        node, feeds = UsdShade.Shader(feed.GetPrim()), ("in",)
        value = inputs_of(node)
        if node.GetIdAttr().Get() == "UsdTransform2d":
            angle = np.radians(float(value("rotation", 0.0)))
            turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
            own = np.eye(3)
            own[:2, :2], own[:2, 2] = turn * np.array(value("scale", (1, 1))), value("translation", (0, 0))
            affine = affine @ own
        else:
            layer = str(value("varname", value("geomprop", "st")))
    wraps: dict[str, Wrap] = {"clamp": "clamp", "black": "clamp", "mirror": "mirror", "constant": "clamp"}
    return Place(layer, affine_of(affine), wraps.get(wrap, "repeat"))


def open_picture(path: Path, file: Any, where: Any) -> Image.Image:
    """Open a picture of the stage at `path`; raises `AssetError` naming the prim `where` and the remedy."""
    resolved = resolved_file(path, file, where)
    try:
        if "[" in resolved:  # inside a .usdz
            return as_eight_bit(_from_package(resolved))
        return as_eight_bit(Path(resolved))
    except (OSError, SyntaxError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: texture {file.path!r} cannot be read ({error}); save it as PNG") from error


def read_resolved(path: Path, file: Any, where: Any) -> bytes:
    """Read a text that the stage at `path` names; raises `AssetError` naming the prim `where`."""
    resolved = resolved_file(path, file, where)
    try:
        return _from_package(resolved) if "[" in resolved else limits.read_bytes(Path(resolved), limits.MOST_TEXT)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise AssetError(f"{path}: {file.path!r} cannot be read ({error})") from error


def resolved_file(path: Path, file: Any, where: Any) -> str:
    """Return the file that the stage at `path` names; raises `AssetError` where it is missing, or out of its folder."""
    resolved = str(file.resolvedPath) if file is not None else ""
    if not resolved:
        named = file.path if file is not None else "nothing"
        raise AssetError(f"{path}: {where} names the file {named!r}, which is missing; put it there")
    try:
        held(path.parent, Path(package_of(resolved)))
    except OutsideError as error:
        raise AssetError(f"{path}: {where} names a file outside: {error}; put it beside the stage") from None
    return resolved


def package_of(name: str) -> str:
    """Return the file that a name of USD's lies in: of `a.usdz[b.png]` the package."""
    return name.partition("[")[0]


def _from_package(resolved: str) -> bytes:
    """Read a file inside a .usdz."""
    package, _, inner = resolved.rstrip("]").partition("[")
    with zipfile.ZipFile(package) as archive:
        return limits.read_member(archive, inner)
