"""Outdoor scenes: things on open ground under the sky, about garden furniture, with the horizon at eye level."""

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.materials import pick_texture, sample_material, textured
from multilight.scenes.poses import translation
from multilight.scenes.random_streams import Rng, Streams, weighted_pick
from multilight.scenes.spec import Body, Material, SceneSpec
from multilight.scenes.still_life.placement import PlacementError, Standing
from multilight.scenes.still_life.planes import level_pose, plane, upright_pose
from multilight.scenes.still_life.sample import StillLifeSettings, sample_still_life
from multilight.scenes.still_life.selection import Choice, Wanted, draw_by_category, draw_standing, unused
from multilight.scenes.still_life.setting import Setting, flat_surface

GROUND = 600.0
"""Side [m] of the ground: its edge lies a fifth of a degree below the horizon for an eye at one metre."""
GROUNDS = {"grass": 0.3, "gravel": 0.15, "paving": 0.2, "asphalt": 0.15, "sand": 0.1, "deck": 0.1}
"""What the still life stands on, and how often."""
AROUND = {"paving": ("grass", "gravel"), "deck": ("grass", "gravel", "sand"), "gravel": ("grass",)}
"""What lies round a patio of that."""
LONGEST, INSERTABLE = (0.10, 0.62), 0.14
"""Longest side [m] of the objects, and of insertable ones at least."""
# Measures of open ground and what is on it [m], and how often [probability].
THIN, PIECES = 0.06, (0.3, 1.6)  # second longest side of insertable objects, at least; longest of garden furniture
MOST = 7  # objects
STRETCH = 6.0  # side of the part of a ground on which things may stand
PATIO, PATIO_SIDE, PATIO_STEP = 0.5, (4.5, 9.0), (0.02, 0.06)  # a ground that may be a patio is one; sides; height
PATIO_EDGE = 0.1  # left free, on both edges together
GLOWING_INSERTED = 0.85  # an object that glows is an insertable one
AS_IT_COMES = 0.6  # an object keeps its own resting pose, besides its chance among them
FURNITURE = frozenset({"bench", "chair", "floor_plant", "planter", "stool"})
_THINGS = frozenset({
    "bag", "ball", "basket", "bottle", "box", "bowl", "bucket", "candle", "crate", "figurine", "fruit", "hat",
    "jar", "jug", "kettle", "lamp", "lantern", "mug", "neon", "night light", "plant", "shoe", "sign", "stone",
    "tool", "toy", "vase", "watering can",
})  # fmt: skip
_FINISH = {"grass": "fabric", "deck": "wood", "sand": "rough stone", "asphalt": "rough stone", "gravel": "rough stone"}


def sample_outdoor(streams: Streams, library: AssetLibrary, *, index: int, settings: StillLifeSettings) -> SceneSpec:
    """Draw an outdoor scene; light it with an outdoor environment map, whose horizon is that of the ground.

    One to three large pieces stand among the objects. The same streams, assets and settings give the same scene
    anywhere. Raises `SceneSamplingError` where no attempt succeeds.
    """
    ground = weighted_pick(streams("place"), GROUNDS)

    def build(attempt: int) -> Setting:
        rng = streams(f"ground/{attempt}")
        front = float(rng.uniform(-np.pi, np.pi))
        bodies, size = _ground(rng, library, ground)
        pieces = choose_pieces(rng, library)
        return Setting(bodies, (), flat_surface(*size), np.eye(4), front, opening=1.2, most=MOST, large_pieces=pieces)

    return sample_still_life(
        streams, library, build, kind="outdoor", index=index, settings=settings, choose=choose_for_ground
    )


def _ground(rng: Rng, library: AssetLibrary, kind: str) -> tuple[tuple[Body, ...], tuple[float, float]]:
    """Lay the ground, or a patio of it, a step above what is around; also return the stretch [m] to stand on."""
    if kind not in AROUND or rng.random() >= PATIO:
        ground = plane("ground", (GROUND, GROUND), _surface(rng, library, kind), level_pose(rng))
        return (ground,), (STRETCH, STRETCH)
    around = str(rng.choice(AROUND[kind]))
    x, y = (float(v) for v in rng.uniform(*PATIO_SIDE, 2))
    step = float(rng.uniform(*PATIO_STEP))
    material = _surface(rng, library, kind)
    bodies = [plane("ground", (GROUND, GROUND), _surface(rng, library, around), translation((0.0, 0.0, -step)))]
    bodies.append(plane("patio", (x, y), material, np.eye(4)))
    edges = {"east": (1, 0), "west": (-1, 0), "north": (0, 1), "south": (0, -1)}
    for name, (dx, dy) in edges.items():
        pose = upright_pose((dx * x / 2, dy * y / 2, -step / 2), (float(dx), float(dy)))
        bodies.append(plane(f"patio_{name}", (y if dx else x, step), material, pose))
    return tuple(bodies), (x - PATIO_EDGE, y - PATIO_EDGE)


def _surface(rng: Rng, library: AssetLibrary, kind: str) -> Material:
    """Draw the material of a ground at its true scale."""
    info = pick_texture(rng, library, frozenset({kind}), laid=True)
    finish = _FINISH.get(kind, "stoneware")
    return sample_material(rng, finish, name=kind) if info is None else textured(rng, info, finish)


def choose_pieces(rng: Rng, library: AssetLibrary) -> tuple[Standing, ...]:
    """Draw one to three pieces of garden furniture and planters; as many as are installed."""
    large = [info for info in library.list("surrounding") if info.category in FURNITURE and _fits(info, PIECES)]
    chosen: list[Standing] = []
    _add(rng, library, large, chosen, int(rng.integers(1, 4)))
    return tuple(chosen)


def choose_for_ground(rng: Rng, library: AssetLibrary, wanted: Wanted, setting: Setting) -> Choice:
    """Draw objects of 10 to 62 cm for open ground; categories repeat only when they run out.

    Raises `PlacementError` where too few are installed.
    """
    lamps, plain = _things(library, wanted)
    chosen: list[Standing] = []
    glowing = 0 if wanted.glows and lamps else None
    if glowing is not None:
        _add(rng, library, lamps, chosen, 1)
    _add(rng, library, [info for info in plain if _is_insertable(info)], chosen, wanted.insertable)
    _add(rng, library, plain, chosen, wanted.objects)
    if len(chosen) < wanted.objects:
        raise PlacementError(f"found {len(chosen)} of {wanted.objects} objects for open ground; install more")
    return chosen, _choose_insertable(rng, chosen[: wanted.objects], wanted.insertable, glowing), glowing


def _things(library: AssetLibrary, wanted: Wanted) -> tuple[list[AssetInfo], list[AssetInfo]]:
    """List what may lie on open ground: insertable lamps, and what does not glow."""
    every = [info for info in library.list("object") if _fits(info, LONGEST)]
    usual = [info for info in every if info.category in _THINGS]
    if len({info.category for info in usual if info.emissive_part is None}) < wanted.objects + 2:
        usual = every  # a small library, or the split that holds whole categories out
    lamps = [info for info in usual if info.emissive_part is not None and _is_insertable(info)]
    return lamps, [info for info in usual if info.emissive_part is None]


def _choose_insertable(rng: Rng, chosen: list[Standing], count: int, glowing: int | None) -> list[int]:
    """Draw which objects are insertable, most often the glowing one among them."""
    fit = [i for i, item in enumerate(chosen) if i != glowing and _is_insertable(item.info)]
    picked = [] if glowing is None or rng.random() >= GLOWING_INSERTED else [glowing]
    picked += [int(i) for i in rng.permutation(fit)[: count - len(picked)]]
    if len(picked) < count:
        raise PlacementError(f"only {len(picked)} objects have a size for insertion, need {count}")
    return sorted(picked)


def _fits(info: AssetInfo, longest: tuple[float, float]) -> bool:
    return info.size is not None and longest[0] <= max(info.size) <= longest[1]


def _is_insertable(info: AssetInfo) -> bool:
    return info.size is not None and max(info.size) >= INSERTABLE and sorted(info.size)[1] >= THIN


def _add(rng: Rng, library: AssetLibrary, infos: list[AssetInfo], chosen: list[Standing], count: int) -> None:
    """Draw until there are `count`: a category, a new one if possible, then an asset of it, then a resting pose."""
    left = list(infos)
    while left and len(chosen) < count:
        info = draw_by_category(rng, unused(left, chosen))
        left.remove(info)
        standing = draw_standing(rng, library, info, as_it_comes=AS_IT_COMES)
        chosen += [] if standing is None else [standing]
