"""Guesses principled materials from what MTL files say: colours, opacity, and the words in material names."""

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from multilight.scenes.colour import srgb_decode
from multilight.scenes.spec import Material, Rgb, Texture


@dataclass(frozen=True)
class Finish:
    """What a word in a material's name tells of its surface; `kind` is a class of `scenes.materials.FINISHES`."""

    kind: str
    words: tuple[str, ...]
    roughness: float
    metallic: float = 0.0
    coat: float = 0.0


# English, French, Spanish, German and Swedish, as the catalogues' authors name things. The first match counts.
FINISHES = (
    Finish("plastic", ("plast", "button", "keys", "tecla"), 0.4),
    Finish("brushed", ("brushed", "alumin", "alumain", "steel", "acero"), 0.35, metallic=1.0),
    Finish(
        "polished",
        ("chrome", "crom", "cr.nk", "silver", "mirror", "plata", "cuttelry", "cutlery", "blade"),
        0.15,
        metallic=1.0,
    ),
    Finish("polished", ("gold", "brass", "copper", "bronze"), 0.22, metallic=1.0),
    Finish("brushed", ("metal", "iron", "alu", "tin", "screw", "blad"), 0.32, metallic=1.0),
    Finish("ceramic", ("ceramic", "porcelain", "ceramique", "beige_with_flowers", "enamel"), 0.2, coat=0.8),
    Finish(
        "wood",
        ("wood", "madera", "fusta", "oak", "pine", "teak", "alder", "walnut", "pear_", "beech", "wenge", "mahag"),
        0.5,
    ),
    Finish("glass", ("glass", "cristal", "vidre", "verre", "vetro"), 0.05),
    Finish("leather", ("leather", "cuir", "cuero"), 0.5),
    Finish("fabric", ("fabric", "cloth", "tela", "toalla", "cotton", "velvet", "plush", "teddy", "belt", "lasso"), 0.9),
    Finish("rubber", ("rubber", "goma", "sole", "wheel", "pneu"), 0.75),
    Finish("paper", ("paper", "page", "card", "newspaper", "label", "etiq"), 0.8),
    Finish("rough stone", ("stone", "rock", "soil", "ground", "erde", "flints", "bark"), 0.85),
    Finish("leaf", ("leaf", "leaves", "petal", "plant", "stem", "flower", "branch", "blatt", "cactus"), 0.55),
    Finish("skin", ("apple", "pear", "banana", "orange", "cherry", "lemon"), 0.35, coat=0.3),
    Finish("paint", ("paint", "gloss", "shiny"), 0.3, coat=0.4),
)
_CATEGORIES: dict[str, tuple[str, float, float, float]] = {
    "cup mug plate jug teapot": ("ceramic", 0.22, 0, 0.8), "bowl": ("ceramic", 0.25, 0, 0.7),
    "vase": ("ceramic", 0.3, 0, 0.5), "cutlery": ("polished", 0.2, 1, 0), "jewellery": ("polished", 0.12, 1, 0),
    "keys": ("polished", 0.25, 1, 0), "pan": ("brushed", 0.3, 1, 0), "plant": ("leaf", 0.6, 0, 0),
    "food": ("skin", 0.5, 0, 0), "shoe bag": ("leather", 0.55, 0, 0), "fabric": ("fabric", 0.9, 0, 0),
    "hat": ("fabric", 0.85, 0, 0), "stone": ("rough stone", 0.85, 0, 0), "paper": ("paper", 0.8, 0, 0),
    "camera": ("plastic", 0.45, 0, 0), "electronics": ("plastic", 0.4, 0, 0),
}  # fmt: skip
"""Kind, roughness, metallic and coat of categories."""
BY_CATEGORY = {
    category: Finish(kind, (), roughness, float(metallic), float(coat))
    for categories, (kind, roughness, metallic, coat) in _CATEGORIES.items()
    for category in categories.split()
}
GLASS_WORDS = ("glass", "cristal", "vidre", "verre", "vetro", "glas", "bottle", "carafe", "diamon")


@dataclass(frozen=True)
class MtlEntry:
    """What is used of one MTL material; colours as written (sRGB), `texture` an asset id."""

    name: str
    diffuse: tuple[float, float, float]
    shininess: float | None
    opacity: float
    texture: str | None
    texture_has_alpha: bool


def class_of(words: str, category: str) -> str | None:
    """Return the class of surface that lower-case words name, else that of the category; None where neither tells."""
    found = next((f for f in FINISHES if any(word in words for word in f.words)), BY_CATEGORY.get(category))
    return None if found is None else found.kind


def linear(colour: ArrayLike) -> Rgb:
    """Decode sRGB values in [0, 1] to linear, kept within what real surfaces reflect (0.02 to 0.9)."""
    values = srgb_decode(np.asarray(colour, np.float64)[:3])
    r, g, b = (round(float(v), 5) for v in np.clip(values, 0.02, 0.9))
    return r, g, b


def material_of(entry: MtlEntry, *, category: str, closed: bool) -> Material:
    """Make the material of an MTL entry.

    Names beat the category, which beats the file's specular exponent (Ns as a Blinn-Phong lobe, alpha =
    sqrt(2 / (Ns + 2)), roughness = sqrt(alpha)). What lets light through becomes glass where the part is a
    closed solid, else plain partial opacity.
    """
    words = entry.name.lower()
    finish = next((f for f in FINISHES if any(word in words for word in f.words)), BY_CATEGORY.get(category))
    if finish is None:
        ns = 20.0 if entry.shininess is None else max(entry.shininess, 0.0)
        finish = Finish("plastic", (), float(np.clip((2 / (min(ns, 400.0) + 2)) ** 0.25, 0.25, 0.7)))
    textured = entry.texture is not None
    material = Material(
        name=entry.name,
        base_color=(1.0, 1.0, 1.0) if textured else linear(entry.diffuse),
        base_color_texture=Texture(image=entry.texture) if entry.texture is not None else None,
        roughness=finish.roughness,
        metallic=0.0 if textured else finish.metallic,
        coat=finish.coat,
        opacity_from_alpha=entry.texture_has_alpha,
    )
    if material.metallic and max(entry.diffuse) < 0.25:
        material = material.model_copy(update={"metallic": 0.0, "coat": 0.3})
    glassy = entry.opacity < 0.6 or any(word in words for word in GLASS_WORDS)
    # Authors write 0.8 to 0.9 for all sorts of opaque plastic.
    see_through = entry.opacity < (0.95 if glassy else 0.75) and not textured
    return _see_through(material, entry, solid_glass=glassy and closed) if see_through else material


def _see_through(material: Material, entry: MtlEntry, *, solid_glass: bool) -> Material:
    if solid_glass:
        tint = np.array(linear(entry.diffuse))
        tint = 1 - (1 - tint / max(float(tint.max()), 1e-3)) * 0.8
        r, g, b = (float(v) for v in 0.97 * tint)
        return material.model_copy(
            update={"base_color": (r, g, b), "transmission": 1.0, "roughness": 0.02, "metallic": 0.0, "coat": 0.0}
        )
    opacity = float(np.clip(entry.opacity, 0.12, 1.0))
    return material.model_copy(update={"opacity": opacity, "roughness": 0.05, "metallic": 0.0, "coat": 0.0})


def part_name(name: str) -> str:
    """Make a material's name safe and short: letters, digits, dots, dashes, underscores; at most 40."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", name).strip("_")[:40] or "material"
