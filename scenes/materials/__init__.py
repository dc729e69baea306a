"""What surfaces are made of: classes with measured ranges, textures at their real size, a scene's materials."""

from multilight.scenes.colour import linear_from_hex
from multilight.scenes.materials.bodies import GLOW, body_materials, with_derived_maps
from multilight.scenes.materials.classes import FINISHES, METALS, Finish, painted_wall, sample_material
from multilight.scenes.materials.textured import metres_per_uv, pick_texture, textured

__all__ = [
    "FINISHES",
    "GLOW",
    "METALS",
    "Finish",
    "body_materials",
    "linear_from_hex",
    "metres_per_uv",
    "painted_wall",
    "pick_texture",
    "sample_material",
    "textured",
    "with_derived_maps",
]
