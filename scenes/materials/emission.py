"""How strongly things glow: luminance or luminous flux of lamps, screens, tubes and flames, and what they show.

Pure data, for `lights/` to turn into radiance. Sources: display luminance from the makers' data sheets (phones and
tablets 200 to 600 cd/m², monitors 150 to 400); LED matrix signs for indoors 500 to 2000; household lamps 400 to
1600 lm (EU 2019/2015 label, 40 to 100 W incandescent equivalents); a candle is about 1 cd, 12 lm; cold-cathode and
neon tubes of sign makers 500 to 3000 cd/m²; lampshades and paper globes from the flux of the lamp behind their area;
night lights 5 to 40 lm.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.meshes import Mesh, triangle_areas
from multilight.scenes.random_streams import Rng, log_uniform, pick
from multilight.scenes.spec import Texture


@dataclass(frozen=True)
class Emission:
    """What a category of glowing things gives off.

    `quantity` is `nits` (cd/m², of white where a picture is shown) or `lumens` (all the part gives off); `kelvin`
    bounds its colour temperature; `coloured` is the fraction that glows in a saturated colour; `shows` is the category
    of textures that it may show.
    """

    quantity: Literal["nits", "lumens"]
    low: float
    high: float
    kelvin: tuple[float, float]
    coloured: float = 0.0
    shows: str | None = None

    @property
    def display(self) -> bool:
        """Whether it is a display, black when off, rather than a lamp."""
        return self.shows is not None


EMISSIONS: dict[str, Emission] = {
    "bulb": Emission("lumens", 400.0, 1600.0, (2400.0, 5000.0), coloured=0.1),
    "candle": Emission("lumens", 8.0, 16.0, (1850.0, 2100.0)),
    "lamp": Emission("lumens", 250.0, 1000.0, (2200.0, 4500.0), coloured=0.05),
    "lantern": Emission("lumens", 150.0, 800.0, (2200.0, 3500.0), coloured=0.15),
    "night light": Emission("lumens", 5.0, 40.0, (2200.0, 4000.0), coloured=0.6),
    "neon": Emission("nits", 500.0, 3000.0, (3000.0, 8000.0), coloured=0.9),
    "phone": Emission("nits", 200.0, 600.0, (5800.0, 7500.0), shows="screen-upright"),
    "tablet": Emission("nits", 200.0, 600.0, (5800.0, 7500.0), shows="screen-wide"),
    "monitor": Emission("nits", 150.0, 400.0, (5800.0, 7500.0), shows="screen-wide"),
    "sign": Emission("nits", 500.0, 2000.0, (6000.0, 7000.0), shows="screen-sign"),
}
"""Emission by asset category, or by a word in the asset's id; all else that has a glowing part counts as `lamp`."""
_WORDS = {
    "candle": "candle", "lantern": "lantern", "mobile": "phone", "tablet": "tablet", "laptop": "monitor",
    "ibook": "monitor", "imac": "monitor", "pc": "monitor", "tv": "monitor", "television": "monitor",
}  # fmt: skip


@dataclass(frozen=True)
class Glow:
    """One draw: luminance [cd/m²], colour temperature [K], whether in a saturated colour, and the picture shown."""

    nits: float
    kelvin: float
    coloured: bool
    texture: Texture | None


def emission_of(info: AssetInfo) -> Emission:
    """Return how an asset with a glowing part glows."""
    if info.category in EMISSIONS and info.category != "lamp":
        return EMISSIONS[info.category]
    words = info.id.partition("/")[2].split("-")
    return EMISSIONS[next((kind for word, kind in _WORDS.items() if word in words), "lamp")]


def part_area(mesh: Mesh, part: int) -> float:
    """Return the area [m²] of a mesh part, one side."""
    return float(triangle_areas(mesh.parts[part].triangles().astype(np.float64)).sum())


def sample_glow(rng: Rng, library: AssetLibrary, info: AssetInfo, part: int, *, scale: float = 1.0) -> Glow:
    """Draw how part `part` of an asset glows.

    Flux becomes luminance as for a Lambertian surface: flux = pi * area * luminance (McCluney 2014, ch. 1); `scale`
    is the body's uniform scale. Values are drawn evenly in their logarithm.
    """
    emission = emission_of(info)
    value = log_uniform(rng, emission.low, emission.high)
    if emission.quantity == "lumens":
        value /= np.pi * part_area(library.mesh(info.id), part) * scale**2
    kelvin = float(rng.uniform(*emission.kelvin))
    coloured = bool(rng.random() < emission.coloured)
    return Glow(value, kelvin, coloured, _picture(rng, library, info, part) if emission.display else None)


def _picture(rng: Rng, library: AssetLibrary, info: AssetInfo, part: int) -> Texture | None:
    """Draw what a display shows: one of the pictures where its uv fills them, else what the asset itself shows."""
    shown = library.mesh(info.id).parts[part]
    if info.pack != "builtin":
        return shown.material.base_color_texture
    pictures = [found for found in library.list("texture") if found.category == emission_of(info).shows]
    return Texture(image=pick(rng, pictures).id)
