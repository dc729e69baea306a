"""Classes of surface with measured ranges, and the one function that draws a material of a class.

Sources. Metals: reflectance at normal incidence, linear Rec.709, from Akenine-Möller et al., Real-Time Rendering,
4th edition (2018), table 9.2. Roughness: the span that the classes take in Burley's fits to the MERL measurements
(Physically-Based Shading at Disney, 2012; Matusik et al. 2003) and in Lagarde and de Rousiers, Moving Frostbite to
PBR (2014), whose chart also bounds the albedo of non-metals, 0.03 to 0.9 (sRGB 50 to 240). Indices of refraction
(sodium line): soda-lime glass 1.52, lead crystal to 1.7 (CRC Handbook of Chemistry and Physics); polymers, from
silicone rubber 1.41 and PMMA 1.49 to PET 1.58 and polystyrene 1.59 (Polymer Handbook, Brandrup et al.); natural
rubber 1.52; cellulose in wood, paper and cotton 1.47 to 1.54; plant cuticle about 1.45; quartz 1.54, calcite 1.49
to 1.66. Coats are lacquer, glaze or wax of index 1.5.
"""

from dataclasses import dataclass

from multilight.scenes.colour import linear_from_hex
from multilight.scenes.frozen import Rgb
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Material

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

_ANY = (
    "f2efe8", "e8dcc8", "d9c7a8", "c9a27c", "b5654a", "8c3b2e", "c8553d", "e3a857", "d9b44a", "7f8f5c",
    "4f6b4a", "2f4f4f", "6f9a9b", "3d6a8a", "27405e", "8aa6bf", "a88aa0", "6b4a63", "d8a7a0", "b97a7a",
    "3b3b3d", "6e6e6c", "a9a59d", "353538",
)  # fmt: skip
_WALLS = (
    "f1ede4", "e9e2d3", "dcd6c8", "d3d8d2", "c5cfc6", "a9b8ad", "b9c4cc", "93a7b3", "6c8292", "d9c4b4",
    "c99f86", "b2826b", "e5d5b0", "8f8f88", "6d7268", "4c5a5e",
)  # fmt: skip
_CLEAR = ("fbfdfd", "fbfdfd", "f4faf6", "f7faff")
_TINTED = ("6fb083", "c98a3a", "5f93c9", "a8c9a0", "b8607a", "8a8f92", "7fc4c4", "d9b46a")
_WOODS = ("c9a678", "b08456", "8a5f3c", "5e3f2a", "dcc39a", "9c6a44", "463226")
_LEATHERS = ("5a3a26", "7d4f30", "a06c42", "3a2a22", "363335", "6e2f2a", "c09a72", "4a5340")
_PAPERS = ("f3efe6", "e9e4d8", "d8c7a4", "c4a47c", "e6e9ea", "d9b8a8", "b8c6b4")
_SKINS = ("b3372c", "c7562b", "d9902f", "e0b93f", "9aa83c", "6f8a3a", "7a2d3a", "4d3350")
_STONES = ("d9d6cf", "b8b2a6", "8f8b84", "6b6964", "46464a", "a08c78", "7d8578", "c2a898")
_RUBBERS = ("353537", "353537", "484645", "6e6c69", "8c3b2e", "3d5a7a", "c7b79a")
_WAXES = ("f0e6cf", "e0d0ae", "a8322a", "3f5a4a", "d9a86a", "efeae2")


@dataclass(frozen=True)
class Finish:
    """A class of surface: ranges of roughness, coat and index, the fraction that is coated, and its colours (sRGB)."""

    roughness: tuple[float, float]
    colours: tuple[str, ...] = _ANY
    coated: float = 0.0
    metallic: float = 0.0
    ior: tuple[float, float] = (1.5, 1.5)
    transmission: float = 0.0
    coat_roughness: tuple[float, float] = (0.02, 0.12)


FINISHES: dict[str, Finish] = {
    "ceramic": Finish((0.06, 0.35), coated=0.5),
    "stoneware": Finish((0.45, 0.8), ior=(1.5, 1.55)),
    "plastic": Finish((0.15, 0.55), ior=(1.46, 1.59)),
    "paint": Finish((0.2, 0.6), coated=0.2, ior=(1.48, 1.55)),
    "lacquer": Finish((0.02, 0.1), coated=1.0, coat_roughness=(0.0, 0.03)),
    "polished": Finish((0.04, 0.2), metallic=1.0),
    "brushed": Finish((0.22, 0.5), metallic=1.0),
    "mirror": Finish((0.0, 0.02), metallic=1.0),
    "glass": Finish((0.0, 0.02), _CLEAR, ior=(1.5, 1.53), transmission=1.0),
    "tinted glass": Finish((0.0, 0.04), _TINTED, ior=(1.5, 1.53), transmission=1.0),
    "frosted glass": Finish((0.2, 0.45), _CLEAR + _TINTED, ior=(1.5, 1.53), transmission=1.0),
    "wood": Finish((0.3, 0.7), _WOODS, coated=0.25, ior=(1.47, 1.54)),
    "stone": Finish((0.08, 0.4), _STONES, coated=0.2, ior=(1.49, 1.6)),
    "rough stone": Finish((0.6, 0.95), _STONES, ior=(1.49, 1.6)),
    "polished stone": Finish((0.02, 0.08), _STONES, ior=(1.49, 1.6)),
    "fabric": Finish((0.75, 1.0), ior=(1.47, 1.54)),
    "leather": Finish((0.35, 0.65), _LEATHERS, ior=(1.46, 1.53)),
    "paper": Finish((0.7, 0.95), _PAPERS, ior=(1.47, 1.54)),
    "skin": Finish((0.3, 0.5), _SKINS, coated=0.4, ior=(1.42, 1.47), coat_roughness=(0.15, 0.35)),
    "leaf": Finish((0.4, 0.65), ("4f6b34", "6d8a48", "3d5530"), ior=(1.42, 1.47)),
    "rubber": Finish((0.55, 0.9), _RUBBERS, ior=(1.41, 1.52)),
    "wax": Finish((0.35, 0.6), _WAXES, ior=(1.43, 1.46)),
    "wall": Finish((0.6, 0.95), _WALLS),
    "floor": Finish((0.25, 0.6), coated=0.1),
}


def sample_material(rng: Rng, finish: str, *, colour: Rgb | None = None, name: str | None = None) -> Material:
    """Draw a material of a class of `FINISHES`: roughness, coat and index, and the colour where none is given.

    `colour` is linear Rec.709; metals get the reflectance of one of `METALS`, mirrors that of silver or aluminium.
    The material is named after its class, or its metal, unless told. Raises `ValueError` for an unknown class.
    """
    if finish not in FINISHES:
        raise ValueError(f"no class of surface {finish!r}; there are {', '.join(FINISHES)}")
    ranges = FINISHES[finish]
    if colour is None and ranges.metallic:
        metal = str(rng.choice(("aluminium", "silver") if finish == "mirror" else sorted(METALS)))
        colour, name = METALS[metal], name or (finish if finish == "mirror" else metal)
    elif colour is None:
        colour = linear_from_hex(str(rng.choice(ranges.colours)))
    coated = rng.random() < ranges.coated
    return Material(
        name=name or finish,
        base_color=colour,
        roughness=float(rng.uniform(*ranges.roughness)),
        metallic=ranges.metallic,
        ior=float(rng.uniform(*ranges.ior)),
        transmission=ranges.transmission,
        coat=float(rng.uniform(0.4, 1.0)) if coated else 0.0,
        coat_roughness=float(rng.uniform(*ranges.coat_roughness)) if coated else 0.05,
    )


def painted_wall(rng: Rng) -> Material:
    """Draw a wall paint."""
    return sample_material(rng, "wall", name="wall_paint")
