"""Surfaces as Mitsuba's own plugins: `principled`, or `diffuse` where nothing but its diffuse lobe is left."""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.mitsuba.arrays import Textures
from multilight.scenes.arrays import Float32
from multilight.scenes.colour import srgb_decode
from multilight.scenes.frozen import Rgb
from multilight.scenes.spec import Material, Texture

COAT = 4.0
"""Disney's clear coat reflects a quarter of what a dielectric of ior 1.5 does, which is what a coat of 1 means here."""
COAT_ALPHA = (0.1, 0.001)
"""Width of Disney's clear coat at gloss 0 and 1."""


def surface(material: Material, textures: Textures) -> mi.BSDF:
    """Make a body part's surface."""
    base = coloured(material.base_color_texture, material.base_color, textures)
    if material.ior == 1.0 and not (material.metallic or material.transmission or material.coat):
        parts: dict[str, Any] = {"type": "diffuse", "reflectance": base}
    else:
        parts = _principled(material, base, textures)
    if material.normal_texture is not None:
        words = _texels(material.normal_texture, textures)[..., :3]
        picture = _bitmap(words, material.normal_texture)
        parts = {"type": "normalmap", "normalmap": picture, "bsdf": parts}
    if not material.transmission:
        parts = {"type": "twosided", "bsdf": parts}
    opacity = _opacity(material, textures)
    if opacity is not None:
        parts = {"type": "mask", "opacity": opacity, "bsdf": parts}
    return mi.load_dict(parts)


def coloured(texture: Texture | None, colour: Rgb, textures: Textures) -> dict[str, Any]:
    """Multiply an sRGB-encoded texture, decoded, by a linear colour; the colour alone where there is no texture."""
    if texture is None:
        return {"type": "rgb", "value": list(colour)}
    return _bitmap(srgb_decode(_texels(texture, textures)[..., :3]) * np.array(colour), texture)


def _principled(material: Material, base: dict[str, Any], textures: Textures) -> dict[str, Any]:
    roughness: Any = material.roughness
    if material.roughness_texture is not None:
        grey = _texels(material.roughness_texture, textures)[..., :1]
        roughness = _bitmap(grey * material.roughness, material.roughness_texture)
    widest, narrowest = COAT_ALPHA
    gloss = (widest - material.coat_roughness**2) / (widest - narrowest)
    parts = {
        "type": "principled",
        "base_color": base,
        "roughness": roughness,
        "metallic": material.metallic,
        "clearcoat": COAT * material.coat,
        "clearcoat_gloss": float(np.clip(gloss, 0, 1)),
    }
    if material.transmission:
        parts["spec_trans"] = material.transmission
    if material.ior > 1.0:
        return parts | {"eta": material.ior}
    return parts | {"specular": 0.0}


def _opacity(material: Material, textures: Textures) -> Any:
    """Return what `mask` takes, None for an opaque surface."""
    texture = material.base_color_texture
    if material.opacity_from_alpha and texture is not None:
        return _bitmap(_texels(texture, textures)[..., 3:] * material.opacity, texture)
    return material.opacity if material.opacity < 1 else None


def _texels(texture: Texture, textures: Textures) -> Float32:
    """Return a texture's encoded values, (H, W, 4) float32 in [0, 1], top row first."""
    words = textures.load(texture.image)
    return words.view(np.uint8).reshape(*words.shape, 4).astype(np.float32) / 255


def _bitmap(values: NDArray[np.floating], texture: Texture) -> dict[str, Any]:
    """Describe a repeating picture of linear values (H, W, C); Mitsuba's v runs downwards, ours upwards."""
    across, up = texture.repeat
    place = mi.ScalarTransform3f().translate([0, 1]).scale([across, -up])
    picture = mi.Bitmap(np.ascontiguousarray(values, np.float32))
    return {"type": "bitmap", "bitmap": picture, "raw": True, "to_uv": place}
