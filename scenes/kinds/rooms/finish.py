"""What a room's furniture is made of: one palette a room, so that things go together."""

from dataclasses import dataclass

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials import GLOW, metres_per_uv, pick_texture, sample_material, textured
from multilight.scenes.meshes import Mesh, MeshPart
from multilight.scenes.spec import Material

_CLOTHS = (
    "8d8578", "5f6a72", "3f4a55", "7a3f33", "b9a88a", "4f5a45", "a9a29a", "2f3b52", "a5673f", "6b5b6e", "d2c7b4",
    "3d3d40", "8a9a9b", "b78a4f",
)  # fmt: skip
_JOINERY = ("efece4", "efece4", "efece4", "e2dccd", "d9d6cf", "8e8f8c", "4a4d4f", "6f7a70")
_CASEWORK = ("e9e6de", "c8cdc8", "7f8f88", "5d6f78", "3f4a52", "a88f6f", "d6c6a4", "8c4a3a", "b9b4ab", "46524a")
UPHOLSTERED = frozenset({"sofa", "armchair", "bed", "pouf", "office_chair"})
CASEWORK = frozenset(
    {
        "wardrobe", "chest", "bookcase", "nightstand", "sideboard", "desk", "table", "coffee_table", "base_unit_a",
        "base_unit_b", "sink_unit_a", "sink_unit_b", "wall_unit_a", "wall_unit_b", "tall_unit_a", "counter", "chair",
    }
)  # fmt: skip


@dataclass(frozen=True)
class Palette:
    """The joinery of windows, doors and skirting, two cloths, and what plain white furniture becomes (None: stays)."""

    joinery: Material
    cloths: tuple[Material, Material]
    casework: Material | None


def sample_palette(rng: np.random.Generator, library: AssetLibrary) -> Palette:
    """Draw a room's palette."""
    joinery = sample_material(rng, "paint", colour=linear_from_hex(str(rng.choice(_JOINERY))), name="joinery")
    if rng.random() < 0.2:
        joinery = sample_material(rng, "wood", name="joinery")
    cloths = tuple(_cloth(rng) for _ in range(2))
    chance = rng.random()
    casework: Material | None = None
    if chance < 0.35:
        casework = sample_material(rng, "paint", colour=linear_from_hex(str(rng.choice(_CASEWORK))), name="casework")
    elif chance < 0.7:
        info = pick_texture(rng, library, frozenset({"wood"}), laid=False)
        casework = None if info is None else textured(rng, info, "wood")
    return Palette(joinery, (cloths[0], cloths[1]), casework)


def _cloth(rng: np.random.Generator) -> Material:
    """Draw a fabric or a leather."""
    if rng.random() < 0.2:
        return sample_material(rng, "leather")
    return sample_material(rng, "fabric", colour=linear_from_hex(str(rng.choice(_CLOTHS))))


def furniture_materials(
    rng: np.random.Generator, palette: Palette, info: AssetInfo, mesh: Mesh, *, lit: bool = False
) -> tuple[Material, ...]:
    """Give each part of a piece of furniture its material: the asset's own mostly, the palette's where it is plain.

    `lit` names the material of the emissive part `GLOW`; no other part keeps that name.
    """
    area = [_area(part) for part in mesh.parts]
    largest = int(np.argmax(area))
    recover = rng.random() < 0.8
    cloth = palette.cloths[int(rng.integers(2))]
    drawn: dict[str, Material] = {}
    result = []
    for number, part in enumerate(mesh.parts):
        if part.name == info.emissive_part:
            name = GLOW if lit else "opal"
            result.append(part.material.model_copy(update={"name": name, "coat": 0.0}))
            continue
        key = part.material.canonical_json()
        if key not in drawn:
            own = part.material
            if own.name in ("joinery", "leaf"):
                own = palette.joinery
            elif info.category in UPHOLSTERED and number == largest and recover and _plain(own):
                own = cloth
            elif info.category in CASEWORK and palette.casework is not None and _white(own):
                own = _at_scale(palette.casework, part)
            else:
                spread = float(np.clip(own.roughness * rng.uniform(0.8, 1.25), 0.02, 1.0))
                own = own.model_copy(update={"roughness": spread})
            drawn[key] = own.model_copy(update={"name": "opal"}) if own.name == GLOW else own
        result.append(drawn[key])
    return tuple(result)


def _area(part: MeshPart) -> float:
    """Return the area of a part [m²]."""
    a, b, c = np.moveaxis(part.vertices[part.faces], 1, 0)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


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
        return material.model_copy(
            update={
                "base_color": (0.36, 0.24, 0.14), "base_color_texture": None, "normal_texture": None,
                "roughness_texture": None, "roughness": 0.5,
            }
        )  # fmt: skip
    scaled = {}
    for name in ("base_color_texture", "normal_texture", "roughness_texture"):
        texture = getattr(material, name)
        if texture is not None:
            repeat = (texture.repeat[0] * scale, texture.repeat[1] * scale)
            scaled[name] = texture.model_copy(update={"repeat": repeat})
    return material.model_copy(update=scaled)
