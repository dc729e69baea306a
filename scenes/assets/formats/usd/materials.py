"""UsdPreviewSurface materials, and the pictures that feed them."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pxr import UsdShade

from multilight.scenes.assets.formats.gltf import EMISSION_NITS
from multilight.scenes.assets.formats.mtl import part_name
from multilight.scenes.assets.formats.scene_file import Emission
from multilight.scenes.assets.formats.usd.names import BASE, IMAGE, NAME, NITS, OPACITY, OWN, TRANSMISSION
from multilight.scenes.assets.info import AssetError
from multilight.scenes.files import limits
from multilight.scenes.files.inside import OutsideError, held
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Material, Texture

_WHITE = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Picture:
    """A picture that feeds an input: `image` is the channel asked for, `scale` multiplies it (R, G, B, A).

    `asset` is the id that the project's own stages name it by; `file` is the picture's file as the stage has it.
    """

    image: Image.Image
    file: str
    scale: tuple[float, float, float, float]
    repeat: tuple[float, float]
    asset: str | None


TextureOf = Callable[[Picture, str], Texture]
"""Stores a picture in a mode ("RGB", "RGBA", "L") and returns the texture that stands for it."""


def bound_surface(prim: Any) -> Any:
    """Return the UsdPreviewSurface bound to a prim, or None."""
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0] if material else None
    return shader if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface" else None


def inputs_of(owner: Any) -> Callable[[str, Any], Any]:
    """Return a function that looks an input's value up: (name, fallback) -> value."""

    def value(name: str, fallback: Any) -> Any:
        found = owner.GetInput(name)
        given = found.Get() if found else None
        return fallback if given is None else given

    return value


def rgb_of(colour: Any) -> Rgb:
    """Return a colour as non-negative floats."""
    red, green, blue = (max(float(v), 0.0) for v in colour)
    return red, green, blue


def read_material(path: Path, shader: Any, texture_of: TextureOf, *, has_uv: bool) -> tuple[Material, Emission | None]:
    """Translate a UsdPreviewSurface of the stage at `path`; raises `AssetError` for a picture that cannot be read."""
    value, found = inputs_of(shader), {}
    for name in ("diffuseColor", "roughness", "normal", "emissiveColor", "metallic", "opacity"):
        if has_uv and (picture := _picture(path, shader, name)) is not None:
            found[name] = picture
    cut_out = "diffuseColor" in found and "opacity" in found and found["opacity"].file == found["diffuseColor"].file
    opacity, transmission = _clearness(shader, found["opacity"].scale[3] if cut_out else value("opacity", 1.0))
    own_name, own_base = (shader.GetPrim().GetParent().GetAttribute(name).Get() for name in (NAME, BASE))
    material = Material(
        name=own_name or part_name(shader.GetPrim().GetParent().GetName()),
        base_color=_level(found.get("diffuseColor"), value("diffuseColor", (0.18, 0.18, 0.18)))
        if own_base is None
        else rgb_of(own_base),
        base_color_texture=_texture(found.get("diffuseColor"), "RGBA" if cut_out else "RGB", texture_of),
        roughness=_share(found["roughness"].scale[0] if "roughness" in found else value("roughness", 0.5)),
        roughness_texture=_texture(found.get("roughness"), "L", texture_of),
        metallic=_metallic(found.get("metallic"), value("metallic", 0.0)),
        ior=float(np.clip(value("ior", 1.5), 1.0, 3.0)),
        coat=_share(value("clearcoat", 0.0)),
        coat_roughness=_share(value("clearcoatRoughness", 0.01)),
        transmission=transmission,
        opacity=opacity,
        opacity_from_alpha=cut_out,
        normal_texture=_texture(found.get("normal"), "RGB", texture_of),
    )
    glow = _level(found.get("emissiveColor"), value("emissiveColor", (0.0, 0.0, 0.0)))
    if max(glow) == 0:
        return material, None
    unit = _emission_nits(shader)
    amount = (glow[0] * unit, glow[1] * unit, glow[2] * unit)
    return material, Emission(amount, "nit", _texture(found.get("emissiveColor"), "RGB", texture_of))


def _clearness(shader: Any, opacity: Any) -> tuple[float, float]:
    """Return opacity and transmission: those that the project's own stages state, else all is opacity."""
    prim = shader.GetPrim().GetParent()
    through = prim.GetAttribute(TRANSMISSION).Get()
    if through is None:
        return _share(opacity), 0.0
    return _share(prim.GetAttribute(OPACITY).Get()), _share(through)


def _emission_nits(shader: Any) -> float:
    """Return the luminance [cd/m²] of an emissive colour of 1: stated by the project's own stages, else a guess."""
    said = shader.GetPrim().GetStage().GetRootLayer().customLayerData.get(OWN, {})
    return 1.0 if said.get("emissiveColor") == NITS else EMISSION_NITS


def _share(value: Any) -> float:
    return float(np.clip(value, 0.0, 1.0))


def _level(picture: Picture | None, plain: Any) -> Rgb:
    return rgb_of(plain if picture is None else picture.scale[:3])


def _metallic(picture: Picture | None, plain: Any) -> float:
    if picture is None:
        return _share(plain)
    return float(np.round(np.asarray(picture.image.convert("L")).mean() / 255))


def _texture(picture: Picture | None, mode: str, texture_of: TextureOf) -> Texture | None:
    if picture is None:
        return None
    return texture_of(picture, mode).model_copy(update={"repeat": picture.repeat})


def _picture(path: Path, shader: Any, name: str) -> Picture | None:
    """Open the picture that feeds an input; None where none does."""
    given = shader.GetInput(name)
    source: Any = given.GetConnectedSource() if given else None
    node = UsdShade.Shader(source[0].GetPrim()) if source else None
    if not node or node.GetIdAttr().Get() != "UsdUVTexture":
        return None
    value = inputs_of(node)
    file = value("file", None)
    image = open_picture(path, file, node.GetPath())
    if source[1] in ("r", "g", "b") and image.mode in ("RGB", "RGBA"):
        image = image.getchannel(source[1].upper())
    red, green, blue, alpha = (max(float(v), 0.0) for v in value("scale", (1.0, 1.0, 1.0, 1.0)))
    own = node.GetPrim().GetAttribute(IMAGE).Get()
    return Picture(image, file.resolvedPath, (red, green, blue, alpha), _repeat(node), own)


def _repeat(node: Any) -> tuple[float, float]:
    """Return how often a picture repeats: the scale of the transform that feeds it."""
    feed = node.GetInput("st").GetConnectedSource() if node.GetInput("st") else None
    placed = UsdShade.Shader(feed[0].GetPrim()) if feed else None
    if not placed or placed.GetIdAttr().Get() != "UsdTransform2d":
        return 1.0, 1.0
    x, y = inputs_of(placed)("scale", (1.0, 1.0))
    return max(abs(float(x)), 1e-6), max(abs(float(y)), 1e-6)


def open_picture(path: Path, file: Any, where: Any) -> Image.Image:
    """Open a picture of the stage at `path`; raises `AssetError` naming the prim `where` and the remedy."""
    resolved = resolved_file(path, file, where)
    try:
        if "[" in resolved:  # inside a .usdz
            return limits.open_picture(io.BytesIO(_from_package(resolved))).copy()
        with limits.open_picture(Path(resolved)) as picture:
            return picture.copy()
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
