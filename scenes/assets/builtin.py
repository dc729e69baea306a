"""The pack `builtin`: what needs no download. Objects and tables by formula, textures, bpy's own HDRIs."""

import json
import zlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from PIL import Image

from scenes import backdrop, primitives, textures
from scenes.assets import tables, tableware, toys
from scenes.assets.cache import sources_key, write_json, write_once
from scenes.assets.environments import bpy_environment_path, bpy_environments
from scenes.assets.info import AssetError, AssetInfo, AssetRole
from scenes.assets.tableware import Part, Rng, to_mesh
from scenes.meshes import Mesh

Recipe = Callable[[Rng], list[Part]]

OBJECTS: dict[str, tuple[Recipe, int]] = {
    "ball": (tableware.ball, 4),
    "block": (toys.block, 6),
    "book": (toys.book, 5),
    "bottle": (tableware.bottle, 4),
    "bowl": (tableware.bowl, 4),
    "box": (toys.box, 4),
    "bulb": (toys.bulb, 2),
    "can": (tableware.can, 3),
    "candle": (toys.candle, 4),
    "coins": (toys.coins, 2),
    "die": (toys.die, 3),
    "fruit": (tableware.fruit, 5),
    "jar": (tableware.jar, 4),
    "mug": (tableware.mug, 5),
    "neon": (toys.neon, 5),
    "orb": (toys.orb, 3),
    "pawn": (tableware.pawn, 4),
    "plate": (tableware.plate, 3),
    "ring": (toys.ring, 3),
    "tumbler": (tableware.tumbler, 3),
    "vase": (tableware.vase, 8),
}
TABLES: dict[str, tuple[Recipe, int]] = {
    "table-bistro": (tables.table_bistro, 2),
    "table-coffee": (tables.table_coffee, 3),
    "table-rectangular": (tables.table_rectangular, 4),
    "table-round": (tables.table_round, 4),
    "table-trestle": (tables.table_trestle, 2),
    "table-workbench": (tables.table_workbench, 2),
}
SURROUNDINGS: dict[str, tuple[Recipe, int]] = {"sweep": (backdrop.seamless_paper, 1)}
LAMPS = {"bulb": "glow", "candle": "flame", "neon": "glow", "orb": "glow"}
LICENCE, CREATOR = "CC0-1.0", "DTC-MultiLight builder"


def builtin_mesh(name: str) -> Mesh:
    """Make the model of a name such as `mug-02`, always the same."""
    kind, _, _ = name.rpartition("-")
    recipe, _ = (OBJECTS | TABLES | SURROUNDINGS)[kind]
    return to_mesh(recipe(np.random.Generator(np.random.PCG64(zlib.crc32(name.encode())))))


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
                    category="lamp" if kind in LAMPS else kind.replace("table-", "") if role == "table" else kind,
                    licence=LICENCE,
                    creator=CREATOR,
                    size=(x, y, z),
                    emissive_part=LAMPS.get(kind),
                )
            )
    return result


def builtin_models() -> list[AssetInfo]:
    """List the built-in objects and tables; makes every mesh once to measure it (about a second)."""
    return _model_infos(OBJECTS, "object") + _model_infos(TABLES, "table") + _model_infos(SURROUNDINGS, "surrounding")


class BuiltinPack:
    """Everything that needs no download."""

    name = "builtin"

    def __init__(self, cache: Path) -> None:
        self._cache = cache
        modules = (primitives.__file__, tableware.__file__, toys.__file__, tables.__file__, backdrop.__file__, __file__)
        self._model_key = sources_key(*modules)
        self._texture_key = sources_key(textures.__file__)

    def infos(self) -> list[AssetInfo]:
        """List models, textures and bpy's HDRIs; models are measured once and remembered in the cache."""
        index = self._cache / "index" / f"builtin-{self._model_key}.json"
        write_once(index, lambda path: write_json(path, [asdict(info) for info in builtin_models()]))
        models = [
            AssetInfo(**entry | {"size": tuple(entry["size"])})
            for entry in json.loads(index.read_text(encoding="utf-8"))
        ]
        return models + _texture_infos() + bpy_environments()

    def mesh_key(self, name: str) -> str:
        """Hash the recipes' source."""
        return self._model_key

    def mesh(self, name: str) -> Mesh:
        """Make a model by name."""
        return builtin_mesh(name)

    def texture(self, name: str) -> Path:
        """Return a texture's PNG, or with `-normal` its normal map's; both are made on first use."""
        base = name.removesuffix("-normal")
        if base not in textures.TEXTURES:
            raise AssetError(f"no texture 'builtin/{name}'; there are {', '.join(sorted(textures.TEXTURES))}")
        folder = self._cache / "textures" / "builtin" / self._texture_key
        path = folder / f"{name}.png"
        if not path.exists():
            albedo, normal = textures.make_texture(base)
            write_once(folder / f"{base}.png", Image.fromarray(albedo).save)
            write_once(folder / f"{base}-normal.png", Image.fromarray(normal).save)
        return path

    def environment(self, name: str) -> Path:
        """Return one of bpy's own EXR files."""
        return bpy_environment_path(name, self._cache)


def _texture_infos() -> list[AssetInfo]:
    return [
        AssetInfo(
            id=f"builtin/{name}",
            pack="builtin",
            role="texture",
            name=name.replace("-", " "),
            category=recipe.category,
            licence=LICENCE,
            creator=CREATOR,
            size=(recipe.metres, recipe.metres, 0.0),
            normal_map=f"builtin/{name}-normal",
        )
        for name, recipe in textures.TEXTURES.items()
    ]
