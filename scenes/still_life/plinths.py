"""Plinths: some objects of a still life stand raised, as photographers show wares."""

from dataclasses import dataclass, replace

import numpy as np
from trimesh import Trimesh

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.materials import metres_per_uv, pick_texture, sample_material, textured
from multilight.scenes.random_streams import Rng, pick, weighted_pick
from multilight.scenes.spec import Material
from multilight.scenes.still_life.placement import Standing, resting_poses

EDGE = 0.008
"""Smallest distance [m] of an object's footprint to the plinth's edge."""
TALLEST = 0.22
"""Objects higher than this [m] stay on the floor, lest they tower over all others."""
FITTING = 4
"""Plinths that an object is put on one of: the first that are wide enough."""
_FINISHES = {"paint": 0.45, "stone": 0.2, "wood": 0.15, "lacquer": 0.08, "mirror": 0.06, "polished stone": 0.06}


@dataclass(frozen=True)
class Raised:
    """An object as it is arranged: on its own, or with the plinth below it as one piece."""

    standing: Standing
    plinth: AssetInfo | None = None

    def material(self, rng: Rng, library: AssetLibrary) -> Material:
        """Draw what the plinth is made of."""
        assert self.plinth is not None
        finish = weighted_pick(rng, _FINISHES)
        scale = metres_per_uv(library.mesh(self.plinth.id).parts[0]) or 1.0
        texture = pick_texture(rng, library, frozenset({finish}), laid=False)
        if finish in ("wood", "stone") and texture is not None:
            return textured(rng, texture, finish, metres_per_uv=scale)
        return sample_material(rng, finish)


def raise_some(rng: Rng, library: AssetLibrary, items: list[Standing], fraction: float) -> list[Raised]:
    """Put a fraction of the objects that plinths can carry on plinths."""
    if fraction == 0:
        return [Raised(item) for item in items]
    plinths = [info for info in library.list("surrounding") if info.category == "plinth"]
    result = []
    for item in items:
        reach = float(np.linalg.norm(item.footprint, axis=1).max()) + EDGE
        # What a plinth surely covers is a hexagon's inner circle.
        fit = [info for info in plinths if info.size and 0.5 * min(info.size[:2]) * np.cos(np.pi / 6) >= reach]
        if fit and item.info.role == "object" and item.height <= TALLEST and rng.random() < fraction:
            result.append(_on(item, pick(rng, fit[:FITTING]), library))
        else:
            result.append(Raised(item))
    return result


def _on(item: Standing, plinth: AssetInfo, library: AssetLibrary) -> Raised:
    """Join an object with the plinth below it to one convex piece."""
    (base,) = resting_poses(library.mesh(plinth.id), plinth)
    points = np.concatenate([np.asarray(base.hull.vertices), np.asarray(item.hull.vertices) + [0, 0, base.height]])
    hull = Trimesh(points, process=False).convex_hull
    joined = replace(item, hull=hull, lift=item.lift + base.height, footprint=base.footprint)
    return Raised(joined, plinth)
