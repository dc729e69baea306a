"""What a room's furniture is made of: one palette a room, so that things go together."""

from dataclasses import dataclass

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials import GLOW, metres_per_uv, pick_texture, sample_material, textured
from multilight.scenes.meshes import Mesh, MeshPart, triangle_areas
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material

_FABRICS = (
    "8d8578", "5f6a72", "3f4a55", "7a3f33", "b9a88a", "4f5a45", "a9a29a", "2f3b52", "a5673f", "6b5b6e", "d2c7b4",
    "3d3d40", "8a9a9b", "b78a4f",
)  # fmt: skip
_JOINERY = ("efece4", "efece4", "efece4", "e2dccd", "d9d6cf", "8e8f8c", "4a4d4f", "6f7a70")
_CASEWORK = ("e9e6de", "c8cdc8", "7f8f88", "5d6f78", "3f4a52", "a88f6f", "d6c6a4", "8c4a3a", "b9b4ab", "46524a")
WOODEN_JOINERY, LEATHER, COVERED = 0.2, 0.2, 0.8
"""Probabilities of varnished instead of painted joinery, of leather, and that plain upholstery is covered anew."""
PAINTED, WOODEN = 0.35, 0.35
"""Probabilities that plain white furniture is painted, or of wood; else it stays as it is."""
_TEXTURES = ("base_color_texture", "normal_texture", "roughness_texture")
_BROWN = {"base_color": (0.36, 0.24, 0.14), "roughness": 0.5}
"""Wood where no picture of it can lie."""
UPHOLSTERED = frozenset({"sofa", "armchair", "bed", "pouf", "office_chair"})
CASEWORK = frozenset({
    "wardrobe", "chest", "bookcase", "nightstand", "sideboard", "desk", "table", "coffee_table", "base_unit_a",
    "base_unit_b", "sink_unit_a", "sink_unit_b", "wall_unit_a", "wall_unit_b", "tall_unit_a", "counter", "chair",
})  # fmt: skip


@dataclass(frozen=True)
class Palette:
    """The joinery of windows, doors and skirting, two covers, and what plain white furniture becomes (None: stays)."""

    joinery: Material
    covers: tuple[Material, Material]
    casework: Material | None


def sample_palette(rng: Rng, library: AssetLibrary) -> Palette:
    """Draw a room's palette."""
    joinery = sample_material(rng, "paint", colour=linear_from_hex(str(rng.choice(_JOINERY))), name="joinery")
    if rng.random() < WOODEN_JOINERY:
        joinery = sample_material(rng, "wood", name="joinery")
    covers = (_cover(rng), _cover(rng))
    chance = rng.random()
    casework: Material | None = None
    if chance < PAINTED:
        casework = sample_material(rng, "paint", colour=linear_from_hex(str(rng.choice(_CASEWORK))), name="casework")
    elif chance < PAINTED + WOODEN:
        info = pick_texture(rng, library, frozenset({"wood"}), laid=False)
        casework = None if info is None else textured(rng, info, "wood")
    return Palette(joinery, covers, casework)


def _cover(rng: Rng) -> Material:
    """Draw a fabric or a leather."""
    if rng.random() < LEATHER:
        return sample_material(rng, "leather")
    return sample_material(rng, "fabric", colour=linear_from_hex(str(rng.choice(_FABRICS))))


def furniture_materials(
    rng: Rng, palette: Palette, info: AssetInfo, mesh: Mesh, *, lit: bool = False
) -> tuple[Material, ...]:
    """Give each part of a piece of furniture its material: the asset's own mostly, the palette's where it is plain.

    `lit` names the material of the emissive part `GLOW`; no other part keeps that name.
    """
    largest = int(np.argmax([triangle_areas(part.triangles()).sum() for part in mesh.parts]))
    recover = rng.random() < COVERED
    drawn_cover = pick(rng, palette.covers)
    drawn: dict[str, Material] = {}
    result = []
    for number, part in enumerate(mesh.parts):
        if part.name == info.emissive_part:
            name = GLOW if lit else "opal"
            result.append(part.material.model_copy(update={"name": name, "coat": 0.0}))
            continue
        key = part.material.canonical_json()
        if key not in drawn:
            covered = info.category in UPHOLSTERED and number == largest and recover
            drawn[key] = unlit(_finished(rng, palette, info, part, drawn_cover if covered else None))
        result.append(drawn[key])
    return tuple(result)


def unlit(material: Material) -> Material:
    """Rename what would be taken for a lamp."""
    return material.model_copy(update={"name": "opal"}) if material.name == GLOW else material


def _finished(rng: Rng, palette: Palette, info: AssetInfo, part: MeshPart, cover: Material | None) -> Material:
    """Draw the material of a part: the palette's, the `cover`, or its own with another roughness."""
    own = part.material
    if own.name in ("joinery", "leaf"):
        return palette.joinery
    if cover is not None and _plain(own):
        return cover
    if info.category in CASEWORK and palette.casework is not None and _white(own):
        return _at_scale(palette.casework, part)
    spread = float(np.clip(own.roughness * rng.uniform(0.8, 1.25), 0.02, 1.0))
    return own.model_copy(update={"roughness": spread})


def _plain(material: Material) -> bool:
    """Tell whether a material is an opaque non-metal without a picture."""
    return material.base_color_texture is None and material.metallic < 0.5 and material.opacity >= 1


def _white(material: Material) -> bool:
    """Tell whether a material is plain and nearly white: lacquer that could as well be another."""
    low, high = min(material.base_color), max(material.base_color)
    return _plain(material) and material.transmission == 0 and low > 0.35 and high - low < 0.12


def _at_scale(material: Material, part: MeshPart) -> Material:
    """Fit a material whose textures repeat per metre to a part's uv; its plain colour where the part has none."""
    picture = material.base_color_texture
    if picture is None:
        return material
    scale = metres_per_uv(part)
    if scale is None or not 0.02 < scale < 50.0:
        return material.model_copy(update={**dict.fromkeys(_TEXTURES), **_BROWN})
    scaled = {}
    for name in _TEXTURES:
        texture = getattr(material, name)
        if texture is not None:
            repeat = (texture.repeat[0] * scale, texture.repeat[1] * scale)
            scaled[name] = texture.model_copy(update={"repeat": repeat})
    return material.model_copy(update=scaled)
