"""Materials of library textures at their real size."""

import numpy as np

from multilight.scenes.assets.derived_maps import MEAN_ROUGHNESS
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.materials.classes import sample_material
from multilight.scenes.meshes import MeshPart, triangle_areas
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Texture

_LAID = ("board", "floor", "parquet", "plank")


def textured(rng: Rng, info: AssetInfo, finish: str, *, metres_per_uv: float = 1.0) -> Material:
    """Make a material of a library texture at its real size, on a surface whose uv unit is `metres_per_uv` long.

    Roughness comes from the texture's own map, or from one derived of its brightness, about a draw of the class.
    """
    width, height, _ = info.size or (1.0, 1.0, 0.0)
    repeat = (metres_per_uv / width, metres_per_uv / height)
    if info.as_made:
        maps = {
            f"{name}_texture": Texture(image=image, repeat=repeat)
            for name, image in (("roughness", info.roughness_map), ("metallic", info.metallic_map))
            if image is not None
        }
        return Material(
            name=info.category,
            base_color=(1.0, 1.0, 1.0),
            base_color_texture=Texture(image=info.id, repeat=repeat),
            roughness=1.0 if info.roughness_map else 0.5,
            metallic=1.0 if info.metallic_map else 0.0,
            normal_texture=None if info.normal_map is None else Texture(image=info.normal_map, repeat=repeat),
            **maps,
        )
    normal = None if info.normal_map is None else Texture(image=info.normal_map, repeat=repeat)
    tint = rng.uniform(0.8, 1.0)
    material = sample_material(rng, finish, colour=(tint, tint, tint), name=info.category)
    rough = Texture(image=info.roughness_map or f"{info.id}#roughness", repeat=repeat)
    return material.model_copy(
        update={
            "base_color_texture": Texture(image=info.id, repeat=repeat),
            "normal_texture": normal,
            "roughness": min(1.0, material.roughness / MEAN_ROUGHNESS),
            "roughness_texture": rough,
        }
    )


def pick_texture(rng: Rng, library: AssetLibrary, categories: frozenset[str], *, laid: bool) -> AssetInfo | None:
    """Draw a texture of one of the categories: first the category, then the texture; None where there is none.

    `laid`: of wood take boards and parquet, as floors are; otherwise the grain of a single piece.
    """
    found = [info for info in library.list("texture") if info.category in categories]
    present = sorted({info.category for info in found})
    if not present:
        return None
    wanted = pick(rng, present)
    choice = [info for info in found if info.category == wanted]
    if wanted == "wood":
        choice = [info for info in choice if any(word in info.id for word in _LAID) == laid] or choice
    return pick(rng, choice)


def metres_per_uv(part: MeshPart) -> float | None:
    """Return the length [m] on the surface of one unit of uv, averaged over a part; None where it has no uv."""
    p, q, r = np.moveaxis(part.uv[part.faces].astype(np.float64), 1, 0)
    surface = 2.0 * triangle_areas(part.triangles().astype(np.float64)).sum()
    u, v = q - p, r - p
    chart = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum()
    return float(np.sqrt(surface / chart)) if chart > 1e-6 * surface else None
