"""Which table and which objects come into a scene."""

import numpy as np

from multilight.scenes.arrays import Int64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.geometry.support_surfaces import SupportError, SupportSurface, find_support
from multilight.scenes.meshes import Mesh
from multilight.scenes.still_life.placement import PlacementError, Standing, resting_poses

SMALLEST, LARGEST = 0.02, 0.55
"""Longest side [m] of objects that may stand on a table."""
INSERTABLE = (0.06, 0.45)
"""Longest side [m] of insertable objects."""
THIN = 0.03
"""Their middle side is at least this long [m]: pencils and spoons are clutter."""
TALL, SMALL = 0.17, 0.12
"""A scene holds an object at least `TALL` [m] high and one whose longest side is at most `SMALL` [m]."""
CROWDING = 0.35
"""Share of the free surface that the objects' footprints may take."""
UNLIT = 0.2
"""Share of the scenes that may hold lamps and displays beside the one that glows: mostly switched off."""

Size = tuple[float, float, float]


def choose_table(rng: np.random.Generator, library: AssetLibrary) -> tuple[AssetInfo, Mesh, SupportSurface]:
    """Draw a table that has a free surface of at least 0.4 x 0.4 m, category first.

    Raises `PlacementError` where no installed table has one.
    """
    tables = [info for info in library.list("table") if info.size is not None and 0.3 <= info.size[2] <= 1.6]
    refused = []
    while tables:
        info = _draw(rng, tables)
        try:
            mesh = library.mesh(info.id)
            return info, mesh, find_support(mesh)
        except (AssetError, SupportError) as error:
            refused.append(f"{info.id}: {error}")
            tables.remove(info)
    raise PlacementError(f"no usable table among {len(refused)} installed; the last: {(refused or ['none'])[-1]}")


def choose_objects(
    rng: np.random.Generator, library: AssetLibrary, *, count: int, insertable: int, area: float, glows: bool
) -> tuple[list[Standing], list[int], int | None]:
    """Draw `count` different objects for a free surface of `area` [m²].

    Returns the objects, the indices of the insertable ones, and the index of the one that glows (None unless
    `glows` and an installed asset can). The first is tall, the second small, the rest whatever fits; categories
    repeat only when they run out. Raises `PlacementError` where too few objects are installed.
    """
    pool = [info for info in library.list("object") if info.size and SMALLEST <= max(info.size) <= LARGEST]
    lamps = [info for info in pool if info.emissive_part is not None]
    if rng.random() >= UNLIT:
        pool = [info for info in pool if info.emissive_part is None]
    chosen: list[Standing] = []
    budget = CROWDING * area
    glowing: int | None = None
    while len(chosen) < count:
        slot = len(chosen)
        if glows and glowing is None and slot == min(2, count - 1) and lamps:
            wanted = lamps
        else:
            wanted = _unused([info for info in pool if _suits(info, slot, insertable)], chosen)
        wanted = [info for info in wanted if _footprint(info) <= budget - 0.004 * (count - slot)]
        if not wanted:
            raise PlacementError(f"found {len(chosen)} of {count} objects that fit {area:.2f} m²; install more")
        info = _draw(rng, wanted)
        pool = [other for other in pool if other is not info]
        lamps = [lamp for lamp in lamps if lamp is not info]
        standing = _stand(rng, library, info)
        if standing is None:
            continue
        if glows and glowing is None and info.emissive_part is not None:
            glowing = slot
        chosen.append(standing)
        budget -= _footprint(info)
    return chosen, _choose_insertable(rng, chosen, insertable, glowing), glowing


def _suits(info: AssetInfo, slot: int, insertable: int) -> bool:
    """Tell whether an object suits a slot: the first is tall, the second small, enough of them insertable."""
    size: Size = info.size or (0.0, 0.0, 0.0)
    if slot < insertable + 1 and not _is_insertable(size):
        return False
    if slot == 0:
        return size[2] >= TALL
    return slot != 1 or max(size) <= SMALL


def _is_insertable(size: Size) -> bool:
    """Tell whether an object of that size (x, y, z) [m] is neither tiny, thin nor huge."""
    return INSERTABLE[0] <= max(size) <= INSERTABLE[1] and sorted(size)[1] >= THIN


def _unused(infos: list[AssetInfo], chosen: list[Standing]) -> list[AssetInfo]:
    """Keep the categories that are not on the table yet, or all where none is left."""
    used = {item.info.category for item in chosen}
    return [info for info in infos if info.category not in used] or infos


def _draw(rng: np.random.Generator, infos: list[AssetInfo]) -> AssetInfo:
    """Draw a category, then an asset: categories with many members come more often, but not in proportion."""
    categories = sorted({info.category for info in infos})
    sizes = np.sqrt([sum(info.category == category for info in infos) for category in categories])
    wanted = categories[int(rng.choice(len(categories), p=sizes / sizes.sum()))]
    members = [info for info in infos if info.category == wanted]
    return members[int(rng.integers(len(members)))]


def _footprint(info: AssetInfo) -> float:
    """Return the area [m²] of an object's bounding rectangle on the table."""
    size: Size = info.size or (0.0, 0.0, 0.0)
    return size[0] * size[1]


def _stand(rng: np.random.Generator, library: AssetLibrary, info: AssetInfo) -> Standing | None:
    """Load an object and draw one of its resting poses, its own most often; None where it is broken or falls over."""
    try:
        poses = resting_poses(info, library.mesh(info.id))
    except AssetError:
        return None
    if not poses:
        return None
    return poses[0] if rng.random() < 0.5 else poses[int(rng.integers(len(poses)))]


def _choose_insertable(rng: np.random.Generator, chosen: list[Standing], count: int, glowing: int | None) -> list[int]:
    """Draw which objects are insertable, the glowing one in four scenes of five."""
    fit = [i for i, item in enumerate(chosen) if _is_insertable(item.info.size or (0.0, 0.0, 0.0))]
    if len(fit) < count:
        raise PlacementError(f"only {len(fit)} objects have a size for insertion, need {count}")
    picked: Int64 = rng.choice(len(fit), size=count, replace=False)
    result = sorted(fit[int(i)] for i in picked)
    if glowing in fit and glowing not in result and rng.random() < 0.8:
        result[int(rng.integers(count))] = glowing
    return sorted(result)
