"""What surfaces are made of: finishes with measured ranges, and the materials of one scene's bodies.

Sources. Metals: reflectance at normal incidence, linear Rec.709, from Akenine-Möller et al., Real-Time Rendering,
4th edition (2018), table 9.2. Roughness: the span that the classes take in Burley's fits to the MERL measurements
(Physically-Based Shading at Disney, 2012; Matusik et al. 2003) and in Lagarde and de Rousiers, Moving Frostbite to
PBR (2014), whose chart also bounds the albedo of non-metals, 0.03 to 0.9. Indices of refraction: glass 1.52 (soda
lime), glaze 1.5, plastics 1.46 to 1.58.
"""

from dataclasses import dataclass

import numpy as np

from scenes.assets.info import AssetInfo
from scenes.assets.library import AssetLibrary
from scenes.frozen import Rgb
from scenes.meshes import Mesh, MeshPart
from scenes.spec import Material, Texture

GLOW = "glow"
"""Name of the material of a part that is meant to shine: the mark by which rigs find it."""

METALS: dict[str, Rgb] = {
    "titanium": (0.542, 0.497, 0.449),
    "chromium": (0.549, 0.556, 0.554),
    "steel": (0.562, 0.565, 0.578),
    "nickel": (0.660, 0.609, 0.526),
    "copper": (0.955, 0.638, 0.538),
    "brass": (0.910, 0.778, 0.423),
    "gold": (1.000, 0.782, 0.344),
    "aluminium": (0.913, 0.922, 0.924),
    "silver": (0.972, 0.960, 0.915),
}


@dataclass(frozen=True)
class Finish:
    """A class of surface: ranges of roughness and coat, and the share of samples that are coated."""

    roughness: tuple[float, float]
    coated: float = 0.0
    metallic: float = 0.0
    ior: tuple[float, float] = (1.5, 1.5)


FINISHES: dict[str, Finish] = {
    "ceramic": Finish((0.06, 0.35), coated=0.5),
    "stoneware": Finish((0.45, 0.8)),
    "plastic": Finish((0.15, 0.55), ior=(1.46, 1.58)),
    "paint": Finish((0.2, 0.6), coated=0.2),
    "polished": Finish((0.04, 0.2), metallic=1.0),
    "brushed": Finish((0.22, 0.5), metallic=1.0),
    "glass": Finish((0.0, 0.04), ior=(1.5, 1.53)),
    "wood": Finish((0.3, 0.7), coated=0.25),
    "stone": Finish((0.08, 0.4), coated=0.2),
    "fabric": Finish((0.75, 1.0)),
    "wall": Finish((0.6, 0.95)),
    "floor": Finish((0.25, 0.6), coated=0.1),
}

_NATURAL = (
    "bag", "banana", "book", "bread", "candle", "clothes", "fabric", "flower", "food", "fruit", "hat", "leaf",
    "leather", "magazine", "page", "paper", "petal", "plant", "rubber", "shoe", "soil", "sole", "stone",
    "teddy", "wax",
)  # fmt: skip
"""Words in names of things whose plain grey or white is their own colour."""
_LAID = ("board", "floor", "parquet", "plank")
_GLASSWARE = frozenset({"bottle", "carafe", "glass", "goblet", "jar", "tumbler", "vase"})
_COLOURS = (
    "f2efe8", "e8dcc8", "d9c7a8", "c9a27c", "b5654a", "8c3b2e", "c8553d", "e3a857", "d9b44a", "7f8f5c",
    "4f6b4a", "2f4f4f", "6f9a9b", "3d6a8a", "27405e", "8aa6bf", "a88aa0", "6b4a63", "d8a7a0", "b97a7a",
    "3b3b3d", "6e6e6c", "a9a59d", "1f1f22",
)  # fmt: skip
_WALL_COLOURS = (
    "f1ede4", "e9e2d3", "dcd6c8", "d3d8d2", "c5cfc6", "a9b8ad", "b9c4cc", "93a7b3", "6c8292", "d9c4b4",
    "c99f86", "b2826b", "e5d5b0", "8f8f88", "6d7268", "4c5a5e",
)  # fmt: skip


def linear_from_hex(colour: str) -> Rgb:
    """Decode six hex digits of sRGB (IEC 61966-2-1) to linear Rec.709."""
    values = np.array([int(colour[i : i + 2], 16) / 255 for i in (0, 2, 4)])
    red, green, blue = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return float(red), float(green), float(blue)


def painted_wall(rng: np.random.Generator) -> Material:
    """Draw a wall paint."""
    return _finished(rng, "wall", linear_from_hex(str(rng.choice(_WALL_COLOURS))), name="wall_paint")


def textured(rng: np.random.Generator, info: AssetInfo, finish: str, *, metres_per_uv: float = 1.0) -> Material:
    """Make a material of a library texture at its real size, on a surface whose uv unit is `metres_per_uv` long."""
    width, height, _ = info.size or (1.0, 1.0, 0.0)
    repeat = (metres_per_uv / width, metres_per_uv / height)
    normal = None if info.normal_map is None else Texture(image=info.normal_map, repeat=repeat)
    tint = rng.uniform(0.8, 1.0)
    material = _finished(rng, finish, (tint, tint, tint), name=info.category)
    return material.model_copy(
        update={"base_color_texture": Texture(image=info.id, repeat=repeat), "normal_texture": normal}
    )


def pick_texture(
    rng: np.random.Generator, library: AssetLibrary, categories: frozenset[str], *, laid: bool
) -> AssetInfo | None:
    """Draw a texture of one of the categories: first the category, then the texture; None where there is none.

    `laid`: of wood take boards and parquet, as floors are; otherwise the grain of a single piece.
    """
    found = [info for info in library.list("texture") if info.category in categories]
    present = sorted({info.category for info in found})
    if not present:
        return None
    wanted = present[int(rng.integers(len(present)))]
    choice = [info for info in found if info.category == wanted]
    if wanted == "wood":
        choice = [info for info in choice if any(word in info.id for word in _LAID) == laid] or choice
    return choice[int(rng.integers(len(choice)))]


def metres_per_uv(part: MeshPart) -> float | None:
    """Return the length [m] on the surface of one unit of uv, averaged over a part; None where it has no uv."""
    a, b, c = np.moveaxis(part.vertices[part.faces].astype(np.float64), 1, 0)
    p, q, r = np.moveaxis(part.uv[part.faces].astype(np.float64), 1, 0)
    surface = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    u, v = q - p, r - p
    chart = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    return float(np.sqrt(surface / chart)) if chart > 1e-6 * surface else None


def body_materials(
    rng: np.random.Generator, library: AssetLibrary, info: AssetInfo, mesh: Mesh, *, glows: bool = False
) -> tuple[Material, ...]:
    """Give each part of a mesh its material for this scene.

    Textures and distinct colours of the asset stay; roughness and coat vary about the asset's own where no map
    gives them; most plain grey parts get a new finish. Parts that share a material keep sharing it. `glows` marks
    the part that the asset names as emissive.
    """
    drawn: dict[str, Material] = {}
    result = []
    for part in mesh.parts:
        if glows and part.name == info.emissive_part:
            result.append(Material(name=GLOW, base_color=(0.8, 0.8, 0.8), roughness=0.6))
            continue
        key = part.material.canonical_json()
        if key not in drawn:
            has_uv = bool(np.ptp(part.uv, axis=0).min() > 1e-3) if len(part.uv) else False
            drawn[key] = _varied(
                rng,
                library,
                info,
                part.material,
                f"{part.name} {part.material.name} {info.category} {info.name}",
                has_uv,
            )
        result.append(drawn[key])
    return tuple(result)


def _varied(
    rng: np.random.Generator, library: AssetLibrary, info: AssetInfo, material: Material, words: str, has_uv: bool
) -> Material:
    """Vary one material of an object about what the asset says of it."""
    if material.roughness_texture is not None or material.transmission > 0 or material.opacity < 1:
        return material
    high, low = max(material.base_color), min(material.base_color)
    grey = material.base_color_texture is None and high - low < 0.12 * max(high, 0.05)
    natural = any(word in words.lower() for word in _NATURAL)
    if grey and not natural and info.pack != "builtin" and rng.random() < 0.7:
        return _refinished(rng, library, info, has_uv)
    if grey and material.metallic > 0.5 and rng.random() < 0.5:
        metal = str(rng.choice(sorted(METALS)))
        material = material.model_copy(update={"base_color": METALS[metal], "name": metal})
    spread = float(np.clip(material.roughness * rng.uniform(0.7, 1.4), 0.03, 1.0))
    coat = float(np.clip(material.coat * rng.uniform(0.6, 1.3), 0.0, 1.0))
    return material.model_copy(update={"roughness": spread, "coat": coat})


def _refinished(rng: np.random.Generator, library: AssetLibrary, info: AssetInfo, has_uv: bool) -> Material:
    """Give a plain grey part a finish and a colour."""
    finishes = ("ceramic", "stoneware", "plastic", "paint", "polished", "brushed", "wood")
    finish = str(rng.choice(finishes, p=(0.22, 0.1, 0.18, 0.12, 0.14, 0.16, 0.08)))
    if info.category in _GLASSWARE and rng.random() < 0.5:
        finish = "glass"
    if finish == "glass":
        return _finished(rng, "glass", (0.95, 0.97, 0.96), name="glass").model_copy(update={"transmission": 1.0})
    if FINISHES[finish].metallic:
        metal = str(rng.choice(sorted(METALS)))
        return _finished(rng, finish, METALS[metal], name=metal)
    texture = pick_texture(rng, library, frozenset({"wood"}), laid=False) if finish == "wood" and has_uv else None
    if texture is not None:
        # The asset's uv scale is unknown; half a metre a unit suits objects of table size.
        return textured(rng, texture, finish, metres_per_uv=0.5)
    return _finished(rng, finish, linear_from_hex(str(rng.choice(_COLOURS))), name=finish)


def _finished(rng: np.random.Generator, finish: str, colour: Rgb, *, name: str) -> Material:
    """Draw roughness, coat and index of refraction for a class of surface."""
    ranges = FINISHES[finish]
    coated = rng.random() < ranges.coated
    return Material(
        name=name,
        base_color=colour,
        roughness=float(rng.uniform(*ranges.roughness)),
        metallic=ranges.metallic,
        ior=float(rng.uniform(*ranges.ior)),
        coat=float(rng.uniform(0.4, 1.0)) if coated else 0.0,
        coat_roughness=float(rng.uniform(0.02, 0.12)) if coated else 0.05,
    )
