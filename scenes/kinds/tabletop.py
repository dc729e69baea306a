"""Tabletop scenes: a table in a surrounding, a still life on it, and cameras that approach it."""

import numpy as np

from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.rays import body_triangles
from multilight.scenes.geometry.support_surfaces import SupportSurface
from multilight.scenes.materials import body_materials, metres_per_uv, pick_texture, textured
from multilight.scenes.meshes import Mesh
from multilight.scenes.poses import about_z
from multilight.scenes.random_streams import Rng, Streams, weighted_pick
from multilight.scenes.spec import Body, SceneSpec
from multilight.scenes.still_life.receivers import ReceiverKind, choose_receiver, receiver_material, with_receiver
from multilight.scenes.still_life.sample import StillLifeSettings, sample_still_life
from multilight.scenes.still_life.selection import choose_table
from multilight.scenes.still_life.setting import Setting, make_body
from multilight.scenes.still_life.surroundings import PROBABILITIES, SurroundingKind, sample_surrounding

_TOPS = frozenset({"wood", "marble", "linen", "fabric", "laminate", "stone", "terrazzo", "cork"})
_BACKED = frozenset({"counter", "nightstand", "sideboard"})
"""Furniture with its back to the wall."""
_TOP_FINISH = {"marble": "stone", "terrazzo": "stone", "stone": "stone", "linen": "fabric", "fabric": "fabric"}

LAID = 0.5
"""Probability that a table's top is laid with another texture than its own, where one is installed."""
LENGTHWISE = 0.85
"""Probability that a table's long side runs along the wall behind it."""


def sample_tabletop(streams: Streams, library: AssetLibrary, *, index: int, settings: StillLifeSettings) -> SceneSpec:
    """Draw a tabletop scene; the same streams, assets and settings give the same scene anywhere.

    Raises `SceneSamplingError` where no attempt succeeds.
    """
    place = streams("place")
    kind = weighted_pick(place, PROBABILITIES)
    receiver = choose_receiver(place)

    def build(attempt: int) -> Setting:
        setting = _setting(streams, library, kind, receiver, attempt)
        return with_receiver(streams(f"receiver/{attempt}"), library, setting, receiver)

    return sample_still_life(streams, library, build, kind="tabletop", index=index, settings=settings)


def _setting(
    streams: Streams, library: AssetLibrary, kind: SurroundingKind, receiver: ReceiverKind, attempt: int
) -> Setting:
    """Draw the table and what is around it."""
    rng = streams(f"table/{attempt}")
    info, mesh, surface = choose_table(rng, library)
    table = _table(rng, library, info, mesh, surface, aligned=kind != "ground")
    if receiver.endswith(" top"):
        materials = list(table.materials)
        materials[surface.part] = receiver_material(rng, receiver)
        table = table.model_copy(update={"materials": tuple(materials)})
    corners = body_triangles(table, library)[0]
    box = np.stack([corners.min(axis=0), corners.max(axis=0)])
    bodies, front, opening = sample_surrounding(streams(f"surrounding/{attempt}"), library, kind=kind, table=box)
    return Setting((*bodies, table), ("table",), surface, np.array(table.world_from_body), front, opening)


def _table(
    rng: Rng, library: AssetLibrary, info: AssetInfo, mesh: Mesh, surface: SupportSurface, *, aligned: bool
) -> Body:
    """Put the table down, parallel to the walls where there are any, and draw its materials."""
    materials = list(body_materials(rng, library, info, mesh))
    scale = metres_per_uv(mesh.parts[surface.part])
    texture = pick_texture(rng, library, _TOPS, laid=False)
    if texture is not None and scale is not None and rng.random() < LAID:
        finish = _TOP_FINISH.get(texture.category, "wood")
        materials[surface.part] = textured(rng, texture, finish, metres_per_uv=scale)
    if aligned and info.category in _BACKED:
        angle = 0.0
    elif aligned:
        long_side = bool(np.ptp(mesh.bounds()[:, 0]) >= np.ptp(mesh.bounds()[:, 1]))
        quarter = 0 if long_side == bool(rng.random() < LENGTHWISE) else 1
        angle = np.pi / 2 * (quarter + 2 * int(rng.integers(2)))
    else:
        angle = float(rng.uniform(0.0, 2 * np.pi))
    return make_body("table", "support", info, mesh, materials, about_z(angle))
