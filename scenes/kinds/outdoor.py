"""Outdoor scenes: things on open ground under the sky, about garden furniture, with the horizon at eye level."""

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.materials import pick_texture, sample_material, textured
from multilight.scenes.spec import Body, Material, SceneSpec
from multilight.scenes.still_life.placement import PlacementError, Standing, resting_poses
from multilight.scenes.still_life.sample import Choice, Plan, StillLifeSettings, sample_still_life
from multilight.scenes.still_life.setting import Setting, flat_surface
from multilight.scenes.still_life.surroundings import plane, upright
from multilight.scenes.streams import Streams

GROUND = 600.0
"""Side [m] of the ground: its edge lies a fifth of a degree below the horizon for an eye at one metre."""
GROUNDS = {"grass": 0.3, "gravel": 0.15, "paving": 0.2, "asphalt": 0.15, "sand": 0.1, "deck": 0.1}
"""What the still life stands on, and how often."""
AROUND = {"paving": ("grass", "gravel"), "deck": ("grass", "gravel", "sand"), "gravel": ("grass",)}
"""What lies round a patio of that."""
PATIO = 0.5
"""Share of the patios among the grounds that may be one."""
LONGEST = (0.10, 0.62)
"""Longest side [m] of the objects."""
INSERTABLE = 0.14
"""Longest side [m] of insertable objects, at least."""
FURNITURE = frozenset({"bench", "chair", "floor_plant", "planter", "stool"})
_THINGS = frozenset(
    {
        "bag", "ball", "basket", "bottle", "box", "bowl", "bucket", "candle", "crate", "figurine", "fruit", "hat",
        "jar", "jug", "kettle", "lamp", "lantern", "mug", "neon", "night light", "plant", "shoe", "sign", "stone",
        "tool", "toy", "vase", "watering can",
    }
)  # fmt: skip
_FINISH = {"grass": "fabric", "deck": "wood", "sand": "rough stone", "asphalt": "rough stone", "gravel": "rough stone"}


def sample_outdoor(streams: Streams, library: AssetLibrary, *, index: int, settings: StillLifeSettings) -> SceneSpec:
    """Draw an outdoor scene; light it with an outdoor environment map, whose horizon is that of the ground.

    One to three large pieces stand among the objects. The same streams, assets and settings give the same scene
    anywhere. Raises `SceneSamplingError` where no attempt succeeds.
    """
    ground = str(streams("place").choice(list(GROUNDS), p=list(GROUNDS.values())))

    def build(attempt: int) -> Setting:
        rng = streams(f"ground/{attempt}")
        front = float(rng.uniform(-np.pi, np.pi))
        bodies, size = _ground(rng, library, ground)
        pieces = choose_pieces(rng, library)
        return Setting(bodies, (), flat_surface(*size), np.eye(4), front, opening=1.2, most=7, beside=pieces)

    return sample_still_life(
        streams, library, build, kind="outdoor", index=index, settings=settings, choose=choose_for_ground
    )


def _ground(rng: np.random.Generator, library: AssetLibrary, kind: str) -> tuple[tuple[Body, ...], tuple[float, float]]:
    """Lay the ground, or a patio of it, a step above what is around; also return the stretch [m] to stand on."""
    if kind not in AROUND or rng.random() >= PATIO:
        ground = plane("ground", (GROUND, GROUND), _surface(rng, library, kind), _quarter_turn(rng))
        return (ground,), (6.0, 6.0)
    around = str(rng.choice(AROUND[kind]))
    x, y = (float(v) for v in rng.uniform(4.5, 9.0, 2))
    step = float(rng.uniform(0.02, 0.06))
    low = np.eye(4)
    low[2, 3] = -step
    material = _surface(rng, library, kind)
    bodies = [plane("ground", (GROUND, GROUND), _surface(rng, library, around), low)]
    bodies.append(plane("patio", (x, y), material, np.eye(4)))
    edges = {"east": (1, 0), "west": (-1, 0), "north": (0, 1), "south": (0, -1)}
    for name, (dx, dy) in edges.items():
        pose = upright((dx * x / 2, dy * y / 2, -step / 2), (float(dx), float(dy)))
        bodies.append(plane(f"patio_{name}", (y if dx else x, step), material, pose))
    return tuple(bodies), (x - 0.1, y - 0.1)


def _quarter_turn(rng: np.random.Generator) -> Float64:
    """Return the identity (4, 4), or a quarter turn about +Z."""
    pose = np.eye(4)
    if rng.random() < 0.5:
        pose[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    return pose


def _surface(rng: np.random.Generator, library: AssetLibrary, kind: str) -> Material:
    """Draw the material of a ground at its true scale."""
    info = pick_texture(rng, library, frozenset({kind}), laid=True)
    finish = _FINISH.get(kind, "stoneware")
    return sample_material(rng, finish, name=kind) if info is None else textured(rng, info, finish)


def choose_pieces(rng: np.random.Generator, library: AssetLibrary) -> tuple[Standing, ...]:
    """Draw one to three pieces of garden furniture and planters; as many as are installed."""
    large = [info for info in library.list("surrounding") if info.category in FURNITURE and _fits(info, 0.3, 1.6)]
    chosen: list[Standing] = []
    _add(rng, library, large, chosen, int(rng.integers(1, 4)))
    return tuple(chosen)


def choose_for_ground(rng: np.random.Generator, library: AssetLibrary, plan: Plan, setting: Setting) -> Choice:
    """Draw objects of 10 to 62 cm for open ground; categories repeat only when they run out.

    Raises `PlacementError` where too few are installed.
    """
    every = [info for info in library.list("object") if _fits(info, *LONGEST)]
    wanted = [info for info in every if info.category in _THINGS]
    if len({info.category for info in wanted if info.emissive_part is None}) < plan.objects + 2:
        wanted = every  # a small library, or the split that holds whole categories out
    lamps = [info for info in wanted if info.emissive_part is not None and _is_insertable(info)]
    chosen: list[Standing] = []
    glowing = None
    if plan.glows and lamps:
        glowing = 0
        _add(rng, library, lamps, chosen, 1)
    plain = [info for info in wanted if info.emissive_part is None]
    _add(rng, library, [info for info in plain if _is_insertable(info)], chosen, plan.insertable)
    _add(rng, library, plain, chosen, plan.objects)
    if len(chosen) < plan.objects:
        raise PlacementError(f"found {len(chosen)} of {plan.objects} objects for open ground; install more")
    first = [i for i in range(plan.objects) if _is_insertable(chosen[i].info)]
    rest = [i for i in first if i != glowing]
    picked = [0] if glowing == 0 and rng.random() < 0.85 else []
    picked += [int(i) for i in rng.permutation(rest)[: plan.insertable - len(picked)]]
    if len(picked) < plan.insertable:
        raise PlacementError(f"only {len(picked)} objects have a size for insertion, need {plan.insertable}")
    return chosen, sorted(picked), glowing


def _fits(info: AssetInfo, low: float, high: float) -> bool:
    return info.size is not None and low <= max(info.size) <= high


def _is_insertable(info: AssetInfo) -> bool:
    return info.size is not None and max(info.size) >= INSERTABLE and sorted(info.size)[1] >= 0.06


def _add(
    rng: np.random.Generator, library: AssetLibrary, infos: list[AssetInfo], chosen: list[Standing], count: int
) -> None:
    """Draw until there are `count`: a category, a new one if possible, then an asset of it, then a resting pose."""
    left = list(infos)
    while len(chosen) < count:
        used = {item.info.category for item in chosen}
        if not left:
            return
        fresh = sorted({info.category for info in left} - used) or sorted(used & {info.category for info in left})
        category = fresh[int(rng.integers(len(fresh)))]
        members = [info for info in left if info.category == category]
        info = members[int(rng.integers(len(members)))]
        left.remove(info)
        try:
            poses = resting_poses(info, library.mesh(info.id))
        except AssetError:
            continue
        if poses:
            chosen.append(poses[0] if rng.random() < 0.6 else poses[int(rng.integers(len(poses)))])
