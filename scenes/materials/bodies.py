"""The materials of one scene's bodies: what the asset says, varied within what was measured."""

import numpy as np

from multilight.scenes.assets.derived_maps import MEAN_ROUGHNESS
from multilight.scenes.assets.formats.mtl import class_of
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials.classes import FINISHES, METALS, sample_material
from multilight.scenes.materials.emission import emission_of
from multilight.scenes.materials.textured import pick_texture, textured
from multilight.scenes.meshes import Mesh
from multilight.scenes.random_streams import Rng, weighted_pick
from multilight.scenes.spec import Material, Texture

GLOW = "glow"
"""Name of the material of a part that is meant to shine: the mark by which rigs find it."""

_NATURAL = (
    "bag", "banana", "book", "bread", "candle", "clothes", "fabric", "flower", "food", "fruit", "hat", "leaf",
    "leather", "magazine", "page", "paper", "petal", "plant", "rubber", "shoe", "soil", "sole", "stone",
    "teddy", "wax",
)  # fmt: skip
"""Words in names of things whose plain grey or white is their own colour."""
_GLASSWARE = frozenset({"bottle", "carafe", "glass", "goblet", "jar", "tumbler", "vase"})
_RELIEF = frozenset({"fabric", "leather", "wood", "rough stone", "stone", "skin", "leaf", "stoneware"})
"""Classes whose pattern is also felt: print on plastic, paper or glaze is not."""
_REFINISHES = {
    "ceramic": 0.19, "stoneware": 0.1, "plastic": 0.16, "paint": 0.11, "lacquer": 0.04, "polished": 0.12,
    "mirror": 0.02, "brushed": 0.14, "wood": 0.07, "leather": 0.02, "rubber": 0.03,
}  # fmt: skip
"""What plain grey parts become, and how often."""


def body_materials(
    rng: Rng, library: AssetLibrary, info: AssetInfo, mesh: Mesh, *, glows: bool = False
) -> tuple[Material, ...]:
    """Give each part of a mesh its material for this scene.

    Textures and distinct colours of the asset stay; roughness and coat vary within their class, about a map derived
    from the picture where the asset brings only colour; most plain grey parts get a new finish. Parts that share a
    material keep sharing it; a user's own stay as they are. `glows` marks the part that the asset names as emissive.
    """
    if info.as_made:
        return tuple(part.material for part in mesh.parts)
    drawn: dict[str, Material] = {}
    result = []
    for part in mesh.parts:
        if glows and part.name == info.emissive_part:
            result.append(_glowing(info, part.material))
            continue
        key = part.material.canonical_json()
        if key not in drawn:
            has_uv = bool(np.ptp(part.uv, axis=0).min() > 1e-3) if len(part.uv) else False
            words = f"{part.name} {part.material.name} {info.category} {info.name}".lower()
            made = _varied(rng, library, info, part.material, words, has_uv)
            drawn[key] = made.model_copy(update={"name": "opal"}) if made.name == GLOW else made
        result.append(drawn[key])
    return tuple(result)


def _glowing(info: AssetInfo, material: Material) -> Material:
    """Return the surface of a part that shines: black glass of a display, else opal glass, paper or wax."""
    if emission_of(info).display:
        return Material(name=GLOW, base_color=(0.02, 0.02, 0.022), roughness=0.08)
    if info.pack == "builtin":
        return material.model_copy(update={"name": GLOW})
    return Material(name=GLOW, base_color=(0.8, 0.8, 0.8), roughness=0.6)


def _varied(rng: Rng, library: AssetLibrary, info: AssetInfo, material: Material, words: str, has_uv: bool) -> Material:
    """Vary one material of an object about what the asset says of it."""
    own = info.pack == "builtin"
    if material.transmission > 0:
        return _varied_glass(rng, material)
    if (material.roughness_texture is not None and not own) or material.opacity < 1:
        return material
    high, low = max(material.base_color), min(material.base_color)
    grey = material.base_color_texture is None and high - low < 0.12 * max(high, 0.05)
    natural = any(word in words for word in _NATURAL)
    if grey and not natural and not own and rng.random() < 0.7:
        return _refinished(rng, library, info, has_uv)
    if grey and material.metallic > 0.5 and rng.random() < 0.5:
        metal = str(rng.choice(sorted(METALS)))
        material = material.model_copy(update={"base_color": METALS[metal], "name": metal})
    kind = class_of(words, info.category)
    if own or kind is None or FINISHES[kind].metallic != material.metallic:
        spread = float(np.clip(material.roughness * rng.uniform(0.7, 1.4), 0.03, 1.0))
        coat = float(np.clip(material.coat * rng.uniform(0.6, 1.3), 0.0, 1.0))
        material = material.model_copy(update={"roughness": spread, "coat": coat})
    else:
        like = sample_material(rng, kind, colour=material.base_color)
        same = ("roughness", "coat", "coat_roughness", "ior")
        material = material.model_copy(update={field: getattr(like, field) for field in same})
    return material if own or not has_uv else with_derived_maps(material, relief=kind in _RELIEF)


def with_derived_maps(material: Material, *, relief: bool) -> Material:
    """Give a material that has only a picture of its colour the roughness map derived from it, and maybe its bump."""
    picture = material.base_color_texture
    if picture is None or "#" in picture.image:
        return material
    update: dict[str, object] = {}
    if material.roughness_texture is None:
        update["roughness_texture"] = Texture(image=f"{picture.image}#roughness", repeat=picture.repeat)
        update["roughness"] = min(1.0, material.roughness / MEAN_ROUGHNESS)
    if relief and material.normal_texture is None:
        update["normal_texture"] = Texture(image=f"{picture.image}#normal", repeat=picture.repeat)
    return material.model_copy(update=update)


def _varied_glass(rng: Rng, material: Material) -> Material:
    """Leave most glass as it is; tint some, and frost a few."""
    chance = rng.random()
    if chance < 0.65 or material.base_color_texture is not None:
        return material
    return sample_material(rng, "tinted glass" if chance < 0.9 else "frosted glass", name=material.name)


def _refinished(rng: Rng, library: AssetLibrary, info: AssetInfo, has_uv: bool) -> Material:
    """Give a plain grey part a finish and a colour."""
    finish = weighted_pick(rng, _REFINISHES)
    if info.category in _GLASSWARE and rng.random() < 0.5:
        return sample_material(rng, str(rng.choice(("glass", "glass", "tinted glass", "frosted glass"))))
    texture = pick_texture(rng, library, frozenset({"wood"}), laid=False) if finish == "wood" and has_uv else None
    if texture is not None:
        # The asset's uv scale is unknown; half a metre a unit suits objects of table size.
        return textured(rng, texture, finish, metres_per_uv=0.5)
    if finish == "wood":
        return sample_material(rng, finish, colour=linear_from_hex(str(rng.choice(FINISHES["wood"].colours))))
    return sample_material(rng, finish)
