"""The pack `builtin`: what needs no download. Objects and tables by formula, textures, bpy's own HDRIs."""

import zlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from pydantic import TypeAdapter

from multilight.scenes.assets import derived_maps
from multilight.scenes.assets.builtin import (
    backdrops,
    furnishings,
    garden,
    joinery,
    lamps,
    luminaires,
    parts,
    plates,
    primitives,
    signs,
    skies,
    tables,
    tableware,
    toys,
)
from multilight.scenes.assets.builtin.parts import Part, Rng, to_mesh
from multilight.scenes.assets.builtin.textures import gobos, grounds, patterns, screens, surfaces
from multilight.scenes.assets.cache import is_sound, kept, sources_key, write_json, write_once
from multilight.scenes.assets.environments import bpy_environment_path, bpy_environments
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.meshes import Mesh

Recipe = Callable[[Rng], list[Part]]

OBJECTS: dict[str, tuple[Recipe, int]] = {
    "ball": (tableware.ball, 4),
    "beach-ball": (garden.beach_ball, 3),
    "block": (toys.block, 6),
    "book": (toys.book, 5),
    "bottle": (tableware.bottle, 4),
    "bowl": (tableware.bowl, 4),
    "box": (toys.box, 4),
    "bucket": (garden.bucket, 3),
    "bulb": (lamps.bulb, 4),
    "can": (tableware.can, 3),
    "candle": (lamps.candle, 4),
    "coins": (toys.coins, 2),
    "crate": (garden.crate, 3),
    "desk-lamp": (lamps.desk_lamp, 3),
    "die": (toys.die, 3),
    "fruit": (tableware.fruit, 5),
    "jar": (tableware.jar, 4),
    "lamp": (lamps.lamp, 4),
    "lantern": (lamps.lantern, 4),
    "monitor": (signs.monitor, 3),
    "mug": (tableware.mug, 5),
    "neon": (signs.neon, 10),
    "night-light": (lamps.night_light, 6),
    "orb": (lamps.orb, 3),
    "pawn": (tableware.pawn, 4),
    "pebble": (garden.pebble, 5),
    "phone": (signs.phone, 4),
    "plant-pot": (garden.plant_pot, 5),
    "plate": (tableware.plate, 3),
    "ring": (toys.ring, 3),
    "sign": (signs.sign, 3),
    "tablet": (signs.tablet, 3),
    "tumbler": (tableware.tumbler, 3),
    "vase": (tableware.vase, 8),
    "votive": (lamps.votive, 3),
    "watering-can": (garden.watering_can, 3),
}
TABLES: dict[str, tuple[Recipe, int]] = {
    "table-bistro": (tables.table_bistro, 2),
    "table-coffee": (tables.table_coffee, 3),
    "table-rectangular": (tables.table_rectangular, 4),
    "table-round": (tables.table_round, 4),
    "table-trestle": (tables.table_trestle, 2),
    "table-workbench": (tables.table_workbench, 2),
}
SURROUNDINGS: dict[str, tuple[Recipe, int]] = {
    "bench": (garden.bench, 3),
    "garden-chair": (garden.garden_chair, 3),
    "planter": (garden.planter, 3),
    "plinth": (plates.plinth, 12),
    "slab": (plates.slab, 6),
    "standing-mirror": (plates.standing_mirror, 4),
    "sweep": (backdrops.seamless_paper, 1),
    "sweep-roll": (backdrops.paper_roll, 1),
    "sweep-table": (backdrops.table_sweep, 2),
    "tray": (plates.tray, 3),
    **furnishings.FITTINGS,
    **luminaires.LUMINAIRES,
}
LAMPS = {
    "bulb": "glow",
    "candle": "flame",
    "desk-lamp": "glow",
    "lamp": "glow",
    "lantern": "glow",
    "monitor": "screen",
    "neon": "glow",
    "night-light": "glow",
    "orb": "glow",
    "phone": "screen",
    "sign": "screen",
    "tablet": "screen",
    "votive": "flame",
}
CATEGORIES = {
    "beach-ball": "ball",
    "desk-lamp": "lamp",
    "garden-chair": "chair",
    "night-light": "night light",
    "orb": "lamp",
    "pebble": "stone",
    "plant-pot": "plant",
    "standing-mirror": "mirror",
    "votive": "candle",
    "watering-can": "watering can",
}
"""Categories of kinds that are not called after them."""
_MODELS = TypeAdapter(list[AssetInfo])
LICENCE, CREATOR = "CC0-1.0", "DTC-MultiLight builder"


def builtin_mesh(name: str) -> Mesh:
    """Make the model of a name such as `mug-02`, always the same."""
    kind, _, _ = name.rpartition("-")
    recipe, _ = (OBJECTS | TABLES | SURROUNDINGS)[kind]
    return to_mesh(recipe(np.random.Generator(np.random.PCG64(zlib.crc32(name.encode())))))


def _read_index(path: Path) -> list[AssetInfo]:
    """Read the list of models back; raises `ValueError` where it is not that of these."""
    models = _MODELS.validate_json(path.read_bytes())
    every = [f"{kind}-{n:02d}" for kind, (_, m) in (OBJECTS | TABLES | SURROUNDINGS).items() for n in range(1, m + 1)]
    if [model.id for model in models] != [f"builtin/{name}" for name in every]:
        raise ValueError("it does not list the built-in models")
    return models


def _model_infos(kinds: dict[str, tuple[Recipe, int]], role: AssetRole) -> list[AssetInfo]:
    result = []
    for kind, (_, count) in kinds.items():
        for variant in range(1, count + 1):
            name = f"{kind}-{variant:02d}"
            low, high = builtin_mesh(name).bounds().astype(float)
            x, y, z = (round(float(v), 5) for v in high - low)
            result.append(
                AssetInfo(
                    id=f"builtin/{name}",
                    pack="builtin",
                    role=role,
                    name=f"{kind.replace('-', ' ')} {variant}",
                    category=_category(kind, role),
                    licence=LICENCE,
                    creator=CREATOR,
                    size=(x, y, z),
                    emissive_part="glow" if kind in luminaires.LUMINAIRES else LAMPS.get(kind),
                )
            )
    return result


def _category(kind: str, role: AssetRole) -> str:
    """Name what a kind of model is: its sizes and shapes come after a hyphen."""
    if kind in CATEGORIES:
        return CATEGORIES[kind]
    return kind.removeprefix("table-") if role == "table" else kind.partition("-")[0]


def builtin_models() -> list[AssetInfo]:
    """List the built-in objects and tables; makes every mesh once to measure it (about a second)."""
    return _model_infos(OBJECTS, "object") + _model_infos(TABLES, "table") + _model_infos(SURROUNDINGS, "surrounding")


class BuiltinPack(Pack):
    """Everything that needs no download."""

    name = "builtin"

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        made_of = (primitives, parts, joinery, backdrops)
        modules = (*made_of, tableware, toys, tables, lamps, signs, garden, plates, furnishings, luminaires)
        self._model_key = sources_key(*(str(module.__file__) for module in modules), __file__)
        self._texture_key = sources_key(
            surfaces.__file__, patterns.__file__, grounds.__file__, screens.__file__, derived_maps.__file__
        )
        self._gobo_key, self._sky_key = sources_key(gobos.__file__), sources_key(skies.__file__)

    def infos(self) -> list[AssetInfo]:
        """List models, textures, skies and bpy's HDRIs; models are measured once and remembered in the cache."""
        index = self._cache / "index" / f"builtin-{self._model_key}.json"
        models = kept(index, _read_index, lambda path: write_json(path, [asdict(info) for info in builtin_models()]))
        return models + _texture_infos() + skies.sky_infos(licence=LICENCE, creator=CREATOR) + bpy_environments()

    def mesh_key(self, name: str) -> str:
        """Hash the recipes' source."""
        return self._model_key

    def mesh(self, name: str) -> Mesh:
        """Make a model by name."""
        return builtin_mesh(name)

    def texture(self, name: str) -> Path:
        """Return a texture's PNG, with `-normal` or `-roughness` that map's; all are made on first use."""
        if name in gobos.GOBOS:
            gobo = self._cache / "textures" / "builtin" / self._gobo_key / f"{name}.png"
            return write_once(gobo, lambda path: Image.fromarray(gobos.make_gobo(name)).save(path))
        base = name.removesuffix("-normal").removesuffix("-roughness")
        if name not in screens.SCREENS and base not in surfaces.TEXTURES:
            raise AssetError(f"no texture 'builtin/{name}'; there are {', '.join(sorted(surfaces.TEXTURES))}")
        folder = self._cache / "textures" / "builtin" / self._texture_key
        path = folder / f"{name}.png"
        if name in screens.SCREENS:
            return write_once(path, screens.make_screen(name).save)
        if not is_sound(path):
            for suffix, pixels in zip(("", "-normal", "-roughness"), surfaces.make_texture(base), strict=True):
                write_once(folder / f"{base}{suffix}.png", Image.fromarray(pixels).save)
        return path

    def environment(self, name: str) -> Path:
        """Return a sky, made on first use, or one of bpy's own EXR files."""
        if name in skies.SKIES:
            return skies.sky_path(name, self._cache / "environments" / "builtin" / self._sky_key)
        return bpy_environment_path(name, self._cache)


def _texture_infos() -> list[AssetInfo]:
    mapped = [
        _texture_info(
            name,
            recipe.category,
            size=(recipe.metres, recipe.metres, 0.0),
            normal_map=f"builtin/{name}-normal",
            roughness_map=f"builtin/{name}-roughness",
        )
        for name, recipe in surfaces.TEXTURES.items()
    ]
    flat = {name: screen.category for name, screen in screens.SCREENS.items()} | dict.fromkeys(gobos.GOBOS, "gobo")
    return mapped + [_texture_info(name, category) for name, category in flat.items()]


def _texture_info(name: str, category: str, **about: Any) -> AssetInfo:
    return AssetInfo(
        id=f"builtin/{name}",
        pack="builtin",
        role="texture",
        name=name.replace("-", " "),
        category=category,
        licence=LICENCE,
        creator=CREATOR,
        **about,
    )
