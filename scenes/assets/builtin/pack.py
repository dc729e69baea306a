"""The pack `builtin`: what needs no download. Objects and tables by formula, textures, bpy's own HDRIs."""

from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from PIL import Image
from pydantic import TypeAdapter

from multilight.scenes import numbers, random_streams
from multilight.scenes.assets import derived_maps
from multilight.scenes.assets.builtin import (
    backdrops,
    furnishings,
    garden,
    joinery,
    lamps,
    luminaires,
    plates,
    signs,
    skies,
    tables,
    tableware,
    toys,
)
from multilight.scenes.assets.builtin.parts import Part, to_mesh
from multilight.scenes.assets.builtin.textures import gobos, screens, surfaces
from multilight.scenes.assets.cache import is_sound, kept, sources_key, write_json, write_once
from multilight.scenes.assets.environments import bpy_environment_path, bpy_environments
from multilight.scenes.assets.info import AssetError, AssetInfo, AssetRole
from multilight.scenes.assets.packs.pack import Pack
from multilight.scenes.meshes import Mesh
from multilight.scenes.random_streams import Rng, generator_of

Recipe = Callable[[Rng], list[Part]]


class Model(NamedTuple):
    """A kind of model: its recipe, how many variants there are, its category, and the part that may glow.

    The category is called as the kind, without what comes after a hyphen there, unless told.
    """

    make: Recipe
    variants: int
    category: str | None = None
    glows: str | None = None


OBJECTS = {
    "ball": Model(tableware.ball, 4),
    "beach-ball": Model(garden.beach_ball, 3, category="ball"),
    "block": Model(toys.block, 6),
    "book": Model(toys.book, 5),
    "bottle": Model(tableware.bottle, 4),
    "bowl": Model(tableware.bowl, 4),
    "box": Model(toys.box, 4),
    "bucket": Model(garden.bucket, 3),
    "bulb": Model(lamps.bulb, 4, glows="glow"),
    "can": Model(tableware.can, 3),
    "candle": Model(lamps.candle, 4, glows="flame"),
    "coins": Model(toys.coins, 2),
    "crate": Model(garden.crate, 3),
    "desk-lamp": Model(lamps.desk_lamp, 3, category="lamp", glows="glow"),
    "die": Model(toys.die, 3),
    "fruit": Model(tableware.fruit, 5),
    "jar": Model(tableware.jar, 4),
    "lamp": Model(lamps.lamp, 4, glows="glow"),
    "lantern": Model(lamps.lantern, 4, glows="glow"),
    "monitor": Model(signs.monitor, 3, glows="screen"),
    "mug": Model(tableware.mug, 5),
    "neon": Model(signs.neon, 10, glows="glow"),
    "night-light": Model(lamps.night_light, 6, category="night light", glows="glow"),
    "orb": Model(lamps.orb, 3, category="lamp", glows="glow"),
    "pawn": Model(tableware.pawn, 4),
    "pebble": Model(garden.pebble, 5, category="stone"),
    "phone": Model(signs.phone, 4, glows="screen"),
    "plant-pot": Model(garden.plant_pot, 5, category="plant"),
    "plate": Model(tableware.plate, 3),
    "ring": Model(toys.ring, 3),
    "sign": Model(signs.sign, 3, glows="screen"),
    "tablet": Model(signs.tablet, 3, glows="screen"),
    "tumbler": Model(tableware.tumbler, 3),
    "vase": Model(tableware.vase, 8),
    "votive": Model(lamps.votive, 3, category="candle", glows="flame"),
    "watering-can": Model(garden.watering_can, 3, category="watering can"),
}
TABLES = {
    "table-bistro": Model(tables.table_bistro, 2, category="bistro"),
    "table-coffee": Model(tables.table_coffee, 3, category="coffee"),
    "table-rectangular": Model(tables.table_rectangular, 4, category="rectangular"),
    "table-round": Model(tables.table_round, 4, category="round"),
    "table-trestle": Model(tables.table_trestle, 2, category="trestle"),
    "table-workbench": Model(tables.table_workbench, 2, category="workbench"),
}
SURROUNDINGS = {
    "bench": Model(garden.bench, 3),
    "garden-chair": Model(garden.garden_chair, 3, category="chair"),
    "planter": Model(garden.planter, 3),
    "plinth": Model(plates.plinth, 12),
    "slab": Model(plates.slab, 6),
    "standing-mirror": Model(plates.standing_mirror, 4, category="mirror"),
    "sweep": Model(backdrops.seamless_paper, 1),
    "sweep-roll": Model(backdrops.paper_roll, 1),
    "sweep-table": Model(backdrops.table_sweep, 2),
    "tray": Model(plates.tray, 3),
    **{f"window-{key}": Model(partial(joinery.window, size=size), 2) for key, size in joinery.WINDOWS.items()},
    **{f"curtains-{key}": Model(partial(furnishings.curtains, width=w), 2) for key, (w, *_) in joinery.WINDOWS.items()},
    "door": Model(joinery.door, 5),
    "picture": Model(furnishings.picture, 14),
    "mirror": Model(furnishings.mirror, 3),
    "rug": Model(furnishings.rug, 8),
    "books": Model(furnishings.books, 10),
    "shelf": Model(furnishings.wall_shelf, 4),
    "pendant": Model(luminaires.pendant, 8, glows="glow"),
    "ceilinglamp": Model(luminaires.ceiling_lamp, 4, glows="glow"),
    "floorlamp": Model(luminaires.floor_lamp, 6, glows="glow"),
    "tablelamp": Model(luminaires.table_lamp, 6, glows="glow"),
}
MODELS: dict[AssetRole, dict[str, Model]] = {"object": OBJECTS, "table": TABLES, "surrounding": SURROUNDINGS}
_MODELS = TypeAdapter(list[AssetInfo])
LICENCE, CREATOR = "CC0-1.0", "DTC-MultiLight builder"


def _names() -> Iterator[tuple[str, str, Model, AssetRole]]:
    """Yield each model's name, its title, its kind and its role."""
    for role, kinds in MODELS.items():
        for kind, model in kinds.items():
            for number in range(1, model.variants + 1):
                yield f"{kind}-{number:02d}", f"{kind.replace('-', ' ')} {number}", model, role


def builtin_mesh(name: str) -> Mesh:
    """Make the model of a name such as `mug-02`, always the same."""
    model = (OBJECTS | TABLES | SURROUNDINGS)[name.rpartition("-")[0]]
    return to_mesh(model.make(generator_of(name)))


def _read_index(path: Path) -> list[AssetInfo]:
    """Read the list of models back; raises `ValueError` where it is not that of these."""
    models = _MODELS.validate_json(path.read_bytes())
    if [model.id for model in models] != [f"builtin/{name}" for name, *_ in _names()]:
        raise ValueError("it does not list the built-in models")
    return models


def _info(name: str, role: AssetRole, category: str, *, title: str | None = None, **about: Any) -> AssetInfo:
    """Describe an asset of this pack, called after its name unless told."""
    about |= {"name": title or name.replace("-", " "), "pack": "builtin", "licence": LICENCE, "creator": CREATOR}
    return AssetInfo(id=f"builtin/{name}", role=role, category=category, **about)


def builtin_models() -> list[AssetInfo]:
    """List the built-in objects and tables; makes every mesh once to measure it (about a second)."""
    infos = []
    for name, title, model, role in _names():
        low, high = builtin_mesh(name).bounds().astype(float)
        size = tuple(round(float(v), 5) for v in high - low)
        category = model.category or name.partition("-")[0]
        infos.append(_info(name, role, category, title=title, size=size, emissive_part=model.glows))
    return infos


class BuiltinPack(Pack):
    """Everything that needs no download."""

    name = "builtin"

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        here = Path(__file__).parent
        shared = (str(random_streams.__file__), str(numbers.__file__))
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

    def content(self) -> str:
        """Hash the code that makes it."""
        return f"{self._model_key}{self._texture_key}{self._sky_key}"

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
    measured = []
    for name, recipe in surfaces.TEXTURES.items():
        maps = {f"{kind}_map": f"builtin/{name}-{kind}" for kind in ("normal", "roughness")}
        measured.append(_info(name, "texture", recipe.category, size=(recipe.metres, recipe.metres, 0.0), **maps))
    flat = {name: screen.category for name, screen in screens.SCREENS.items()} | dict.fromkeys(gobos.GOBOS, "gobo")
    return measured + [_info(name, "texture", category) for name, category in flat.items()]
