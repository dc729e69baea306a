"""Which table and which objects come into a scene: draws of assets by category, and of how they rest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.geometry.support_surfaces import SupportError, SupportSurface, find_support
from multilight.scenes.meshes import Mesh
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.still_life.placement import PlacementError, Standing, resting_poses
from multilight.scenes.still_life.setting import Setting

SMALLEST, LARGEST = 0.02, 0.55
"""Longest side [m] of objects that may stand on a table."""
INSERTABLE, THIN = (0.06, 0.45), 0.03
"""Longest side [m] of insertable objects; their second longest at least: pencils and spoons are clutter."""
TALL, SMALL = 0.17, 0.12
"""A scene holds an object at least `TALL` [m] high and one whose longest side is at most `SMALL` [m]."""
CROWDING, LEAST_FOOTPRINT = 0.35, 0.004
"""Fraction of a free surface that footprints may take; what is set aside for an object still to come [m²]: a mug's."""
UNLIT, GLOWING_INSERTED, AS_IT_COMES = 0.2, 0.8, 0.5
"""Probabilities that lamps and displays may stand beside the one that glows, mostly switched off; that what glows is
insertable, where the draw leaves it out; that an object keeps its own resting pose, besides its chance among them.
"""

Size = tuple[float, float, float]
Choice = tuple[list[Standing], list[int], int | None]
"""Objects, the indices of the insertable ones, and the index of the one that glows."""


@dataclass(frozen=True)
class Wanted:
    """What is wanted of a still life in one attempt."""

    attempt: int
    objects: int
    insertable: int
    glows: bool
    piled: bool = False


def draw_by_category(rng: Rng, infos: Sequence[AssetInfo], *, evenly: bool = True) -> AssetInfo:
    """Draw a category, then one of its assets, of at least one.

    Categories are as likely as each other, or else in proportion to the square root of their numbers of members.
    """
    names = [info.category for info in infos]
    categories = sorted(set(names))
    if evenly:
        wanted = pick(rng, categories)
    else:
        wanted = pick(rng, categories, np.sqrt([names.count(category) for category in categories]))
    return pick(rng, [info for info in infos if info.category == wanted])


def unused(infos: list[AssetInfo], chosen: Sequence[Standing]) -> list[AssetInfo]:
    """Keep the assets of categories that were not chosen yet, or all where none is left."""
    used = {item.info.category for item in chosen}
    return [info for info in infos if info.category not in used] or infos


def draw_standing(
    rng: Rng, library: AssetLibrary, info: AssetInfo, *, as_it_comes: float = AS_IT_COMES
) -> Standing | None:
    """Load an object and draw one of its resting poses, its own most often; None where it is broken or falls over."""
    try:
        poses = resting_poses(library.mesh(info.id), info)
    except AssetError:
        return None
    if not poses:
        return None
    return poses[0] if rng.random() < as_it_comes else pick(rng, poses)


def choose_table(rng: Rng, library: AssetLibrary) -> tuple[AssetInfo, Mesh, SupportSurface]:
    """Draw a table that has a free surface of at least 0.4 x 0.4 m, category first.

    Raises `PlacementError` where no installed table has one.
    """
    tables = [info for info in library.list("table") if info.size is not None and 0.3 <= info.size[2] <= 1.6]
    refused = []
    while tables:
        info = draw_by_category(rng, tables, evenly=False)
        try:
            mesh = library.mesh(info.id)
            return info, mesh, find_support(mesh)
        except (AssetError, SupportError) as error:
            refused.append(f"{info.id}: {error}")
            tables.remove(info)
    raise PlacementError(f"no usable table among {len(refused)} installed; the last: {(refused or ['none'])[-1]}")


def choose_objects(rng: Rng, library: AssetLibrary, wanted: Wanted, setting: Setting) -> Choice:
    """Draw different objects of table size, for the free surface.

    None glows unless that is wanted and an installed asset can. The first is tall, the second small, the rest
    whatever fits; categories repeat only when they run out. Raises `PlacementError` where too few are installed.
    """
    count, area = wanted.objects, setting.surface.area
    left = [info for info in library.list("object") if info.size and SMALLEST <= max(info.size) <= LARGEST]
    with_unlit = rng.random() < UNLIT
    chosen: list[Standing] = []
    budget = CROWDING * area
    glowing: int | None = None
    while len(chosen) < count:
        slot = len(chosen)
        dark = wanted.glows and glowing is None
        lamp = dark and slot == min(2, count - 1)
        room = budget - LEAST_FOOTPRINT * (count - slot)
        fitting = _candidates(left, chosen, wanted.insertable, lamp=lamp, with_unlit=with_unlit)
        fitting = [info for info in fitting if _footprint(info) <= room]
        if not fitting:
            raise PlacementError(f"found {slot} of {count} objects that fit {area:.2f} m²; install more")
        info = draw_by_category(rng, fitting, evenly=False)
        left.remove(info)
        standing = draw_standing(rng, library, info)
        if standing is None:
            continue
        if dark and info.emissive_part is not None:
            glowing = slot
        chosen.append(standing)
        budget -= _footprint(info)
    return chosen, _choose_insertable(rng, chosen, wanted.insertable, glowing), glowing


def _candidates(
    left: list[AssetInfo], chosen: list[Standing], insertable: int, *, lamp: bool, with_unlit: bool
) -> list[AssetInfo]:
    """List what may come next: where a `lamp` is wanted what can glow, if there is any; else what suits the slot."""
    lamps = [info for info in left if info.emissive_part is not None]
    if lamp and lamps:
        return lamps
    plain = [info for info in left if with_unlit or info.emissive_part is None]
    suiting = [info for info in plain if _suits(info, len(chosen), insertable)]
    # A user's own may hold nothing tall, or nothing small.
    return unused(suiting or [info for info in plain if info.as_made and _is_insertable(info)], chosen)


def _size(info: AssetInfo) -> Size:
    """Return the size (x, y, z) of an asset [m], zero where it is not known."""
    return info.size or (0.0, 0.0, 0.0)


def _suits(info: AssetInfo, slot: int, insertable: int) -> bool:
    """Tell whether an object suits a slot: the first is tall, the second small, enough of them insertable."""
    if slot < insertable + 1 and not _is_insertable(info):
        return False
    if slot == 0:
        return _size(info)[2] >= TALL
    return slot != 1 or max(_size(info)) <= SMALL


def _is_insertable(info: AssetInfo) -> bool:
    """Tell whether an object is neither tiny, thin nor huge."""
    _, second, longest = sorted(_size(info))
    return INSERTABLE[0] <= longest <= INSERTABLE[1] and second >= THIN


def _footprint(info: AssetInfo) -> float:
    """Return the area [m²] of an object's bounding rectangle on the table."""
    return _size(info)[0] * _size(info)[1]


def _choose_insertable(rng: Rng, chosen: list[Standing], count: int, glowing: int | None) -> list[int]:
    """Draw which objects are insertable, most often the glowing one among them."""
    fit = [i for i, item in enumerate(chosen) if _is_insertable(item.info)]
    if len(fit) < count:
        raise PlacementError(f"only {len(fit)} objects have a size for insertion, need {count}")
    result = sorted(fit[int(i)] for i in rng.choice(len(fit), size=count, replace=False))
    if glowing in fit and glowing not in result and rng.random() < GLOWING_INSERTED:
        result[int(rng.integers(count))] = glowing
    return sorted(result)
