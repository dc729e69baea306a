"""The pack `builtin`: what needs no download. Objects and tables by formula, textures, bpy's own HDRIs."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from PIL import Image
from pydantic import TypeAdapter

from multilight.scenes import numbers, streams
from multilight.scenes.assets import derived_maps
from multilight.scenes.assets.builtin import (
    backdrops,
    furnishings,
    garden,
    lamps,
    luminaires,
    plates,
    signs,
    skies,
    tables,
    tableware,
    toys,
)
from multilight.scenes.assets.builtin.parts import Part, Rng, to_mesh
from multilight.scenes.assets.builtin.textures import gobos, screens, surfaces
from multilight.scenes.assets.cache import is_sound, kept, sources_key, write_json, write_once
from multilight.scenes.assets.environments import bpy_environment_path, bpy_environments
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.meshes import Mesh
from multilight.scenes.streams import generator_of

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


MODELS = OBJECTS | TABLES | SURROUNDINGS


def builtin_mesh(name: str) -> Mesh:
    """Make the model of a name such as `mug-02`, always the same."""
    recipe, _ = MODELS[name.rpartition("-")[0]]
    return to_mesh(recipe(generator_of(name)))


def _read_index(path: Path) -> list[AssetInfo]:
    """Read the list of models back; raises `ValueError` where it is not that of these."""
    models = _MODELS.validate_json(path.read_bytes())
    every = [f"{kind}-{n:02d}" for kind, (_, count) in MODELS.items() for n in range(1, count + 1)]
    if [model.id for model in models] != [f"builtin/{name}" for name in every]:
        raise ValueError("it does not list the built-in models")
    return models


def _info(name: str, role: AssetRole, category: str, **about: Any) -> AssetInfo:
    """Describe an asset of this pack; called after its `name`, unless `title` says how."""
    title = about.pop("title", name.replace("-", " "))
    return AssetInfo(
        id=f"builtin/{name}", pack="builtin", role=role, name=title, category=category, licence=LICENCE,
        creator=CREATOR, **about,
    )  # fmt: skip


def _model_info(kind: str, variant: int, role: AssetRole) -> AssetInfo:
    """Describe a model, which is made and measured for it."""
    name = f"{kind}-{variant:02d}"
    low, high = builtin_mesh(name).bounds().astype(float)
    return _info(
        name,
        role,
        _category(kind, role),
        title=f"{kind.replace('-', ' ')} {variant}",
        size=tuple(round(float(v), 5) for v in high - low),
        emissive_part="glow" if kind in luminaires.LUMINAIRES else LAMPS.get(kind),
    )


def _category(kind: str, role: AssetRole) -> str:
    """Name what a kind of model is: its sizes and shapes come after a hyphen."""
    if kind in CATEGORIES:
        return CATEGORIES[kind]
    return kind.removeprefix("table-") if role == "table" else kind.partition("-")[0]


def builtin_models() -> list[AssetInfo]:
    """List the built-in objects and tables; makes every mesh once to measure it (about a second)."""
    kinds: dict[AssetRole, dict[str, tuple[Recipe, int]]] = {
        "object": OBJECTS, "table": TABLES, "surrounding": SURROUNDINGS,
    }  # fmt: skip
    return [
        _model_info(kind, variant, role)
        for role, recipes in kinds.items()
        for kind, (_, count) in recipes.items()
        for variant in range(1, count + 1)
    ]


class BuiltinPack:
    """Everything that needs no download."""

    name = "builtin"

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        here = Path(__file__).parent
        shared = (str(streams.__file__), str(numbers.__file__))
        self._model_key = sources_key(*sorted(map(str, here.glob("*.py"))), *shared)
        textures = sorted(map(str, (here / "textures").glob("*.py")))
        self._texture_key = sources_key(*textures, str(derived_maps.__file__), *shared)
        self._sky_key = sources_key(str(skies.__file__))

    def infos(self) -> list[AssetInfo]:
        """List models, textures, skies and bpy's HDRIs; models are measured once and remembered in the cache."""
        index = self._cache / "index" / f"builtin-{self._model_key}.json"
        models = kept(index, _read_index, lambda path: write_json(path, [asdict(info) for info in builtin_models()]))
        # Each sky is a place of its own: splits hold places apart.
        above = [_info(name, "environment", "sky", place=name) for name in skies.SKIES]
        return models + _texture_infos() + above + bpy_environments()

    def mesh_key(self, name: str) -> str:
        """Hash the recipes' source."""
        return self._model_key

    def mesh(self, name: str) -> Mesh:
        """Make a model by name."""
        return builtin_mesh(name)

    def texture(self, name: str) -> Path:
        """Return a texture's PNG, with `-normal` or `-roughness` that map's; all are made on first use."""
        path = self._cache / "textures" / "builtin" / self._texture_key / f"{name}.png"
        if name in gobos.GOBOS:
            return write_once(path, lambda file: Image.fromarray(gobos.make_gobo(name)).save(file))
        if name in screens.SCREENS:
            return write_once(path, screens.make_screen(name).save)
        base = name.removesuffix("-normal").removesuffix("-roughness")
        if base not in surfaces.TEXTURES:
            raise AssetError(f"no texture 'builtin/{name}'; there are {', '.join(sorted(surfaces.TEXTURES))}")
        if not is_sound(path):
            for suffix, pixels in zip(("", "-normal", "-roughness"), surfaces.make_texture(base), strict=True):
                write_once(path.with_name(f"{base}{suffix}.png"), Image.fromarray(pixels).save)
        return path

    def environment(self, name: str) -> Path:
        """Return a sky, made on first use, or one of bpy's own EXR files."""
        if name in skies.SKIES:
            return skies.sky_path(name, self._cache / "environments" / "builtin" / self._sky_key)
        return bpy_environment_path(name, self._cache)


def _texture_infos() -> list[AssetInfo]:
    measured = [
        _info(
            name,
            "texture",
            recipe.category,
            size=(recipe.metres, recipe.metres, 0.0),
            normal_map=f"builtin/{name}-normal",
            roughness_map=f"builtin/{name}-roughness",
        )
        for name, recipe in surfaces.TEXTURES.items()
    ]
    flat = {name: screen.category for name, screen in screens.SCREENS.items()} | dict.fromkeys(gobos.GOBOS, "gobo")
    return measured + [_info(name, "texture", category) for name, category in flat.items()]
