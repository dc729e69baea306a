"""Which split an asset and a scene belong to, so that nothing of a test scene was ever seen in training.

An asset's split is a hash of its identity alone: neither the dataset's seed nor what else is installed can move it,
so two datasets made on two machines do not leak into one another either. What counts as one identity:

- an environment map: its *place* (maps of one place by other packs or at other hours go together);
- a model: its asset id;
- what is out of domain (`test_ood`): whole categories of objects, whole places, and single models of all other
  roles; lamps count singly too, since they are one category and training needs some.

Shared by all splits are a background scene of one's own, textures of surfaces, gobos, light profiles, skies by
formula, and the fittings of a room (built-in surroundings and `FITTINGS`): never what is inserted.

A scene's split follows from (dataset seed, index), evenly spread, with the weights of the configuration.
"""

import hashlib
from typing import Literal

from multilight.scenes.assets.info import AssetInfo, AssetRole
from multilight.scenes.frozen import UnitFloat
from multilight.scenes.random_streams import Weights, pick_at

Split = Literal["train", "val", "test", "test_ood"]
SPLITS: tuple[Split, ...] = ("train", "val", "test", "test_ood")

ASSET_SHARES: dict[Split, float] = {"train": 0.64, "val": 0.12, "test": 0.12, "test_ood": 0.12}
"""Expected fractions of the identities; fixed, since what they hold out must stay held out."""
KEYS: dict[AssetRole, str] = {
    "environment": "place 1237",
    "object": "object 1183",
    "surrounding": "furniture 126",
    "table": "table 142",
}
"""Keys of the hash, by role. Chosen so that the built-in assets alone fill every split, and that with the default
packs every split has desks and coffee tables, chairs and sofas, indoor and outdoor places (tests hold them to it):
of few models, a hash at random leaves some split without any."""
FITTINGS = frozenset(
    [
        "animal",
        "aquarium",
        "bench",
        "mirror",
        "planter",
        "plinth",
        "slab",
        "tray",
        "base_unit_a",
        "base_unit_b",
        "basket",
        "bed",
        "big_table_lamp",
        "bin",
        "carpet",
    ]
    + ["ceiling_lamp", "chest", "fireplace", "floor_lamp", "fridge", "guitar", "hood", "large_vase", "nightstand"]
    + ["office_chair", "pendant", "piano", "pouf", "printer", "radiator", "rocking_horse", "sink_unit_a"]
    + ["sink_unit_b", "speaker", "stool", "stove", "suitcase", "sweep", "tall_unit_a", "trunk", "tv", "wall_clock"]
    + ["wall_tv", "wall_unit_a", "wall_unit_b", "wardrobe", "washer"]
)
"""Categories of furniture that are shared by all splits: they belong to the building, or the default packs hold five
models at most, so that a kitchen of the test split would have no stove."""

_PLASTIC = 1.32471795724474602596
"""The plastic number: steps of 1/p and 1/p² spread (u, v) pairs most evenly (M. Roberts, The unreasonable
effectiveness of quasirandom sequences, 2018: the R2 sequence)."""


class SplitShares(Weights[Split]):
    """How many scenes of a dataset each split gets, relative to the others."""

    train: UnitFloat = 0.8
    """Scenes to learn from."""
    val: UnitFloat = 0.1
    """Scenes to choose settings by: assets and places of their own."""
    test: UnitFloat = 0.1
    """Scenes to report on: assets and places of their own, kinds as in training."""
    test_ood: UnitFloat = 0.0
    """Scenes out of domain: categories, places and (where held out) kinds never seen in training."""


def asset_split(info: AssetInfo) -> Split | None:
    """Return the one split whose scenes may show an asset; None where it is shared by all."""
    fitting = info.role == "surrounding" and (info.pack == "builtin" or info.category in FITTINGS)
    if fitting or info.role == "texture" or info.category in ("sky", "background"):
        return None
    key = KEYS[info.role]
    # "object" is what is known of no category: held out as a whole, it would take most of a user's models along.
    whole_category = info.role == "object" and info.emissive_part is None and info.category != "object"
    identity = f"place {info.place}" if info.role == "environment" and info.place else f"asset {info.id}"
    group = f"category {info.category}" if whole_category else identity
    if _unit(f"{key} domain {group}") < ASSET_SHARES["test_ood"]:
        return "test_ood"
    return pick_at(_unit(f"{key} {identity}"), {split: ASSET_SHARES[split] for split in ("train", "val", "test")})


def in_split(info: AssetInfo, split: Split) -> bool:
    """Tell whether scenes of a split may show an asset."""
    return asset_split(info) in (None, split)


def scene_split(seed: int, index: int, shares: SplitShares) -> Split:
    """Return the split of a scene; any run of consecutive scenes holds the weights as nearly as it can."""
    return shares.at(scene_place(seed, index)[0])


def scene_place(seed: int, index: int) -> tuple[float, float]:
    """Return a scene's place in the unit square: evenly spread over indices, shifted by the dataset's seed."""
    shift = _unit(f"u {seed}"), _unit(f"v {seed}")
    return (shift[0] + index / _PLASTIC) % 1.0, (shift[1] + index / _PLASTIC**2) % 1.0


def _unit(key: str) -> float:
    """Hash a key to [0, 1)."""
    digest = hashlib.blake2b(key.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "big") / 2**64
