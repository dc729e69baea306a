"""Mirror-like and glossy receivers: table tops, plates, trays and mirrors that show the objects again.

They are what models of compositing fail at, so a stated fraction of the scenes has one.
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from multilight.scenes.arrays import Float64
from multilight.scenes.assets.info import AssetInfo
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.colour import linear_from_hex
from multilight.scenes.geometry.support_surfaces import SupportError, find_support
from multilight.scenes.materials import METALS, body_materials, sample_material
from multilight.scenes.meshes import Mesh
from multilight.scenes.poses import about_z, apply_pose, pose_at
from multilight.scenes.random_streams import Rng, pick, weighted_pick
from multilight.scenes.spec import Material
from multilight.scenes.still_life.placement import PlacementError
from multilight.scenes.still_life.setting import Setting, make_body, without_box

ReceiverKind = Literal[
    "none", "mirror top", "mirror plate", "chrome tray", "standing mirror", "glass top", "glass plate",
    "stone plate", "lacquer top",
]  # fmt: skip
PROBABILITIES: dict[ReceiverKind, float] = {
    "none": 0.70,
    "mirror top": 0.04, "mirror plate": 0.04, "chrome tray": 0.03, "standing mirror": 0.04,
    "glass top": 0.03, "glass plate": 0.03, "stone plate": 0.04, "lacquer top": 0.05,
}  # fmt: skip
"""How often each comes: 15 % of the scenes have a mirror, another 15 % glass or a polish nearly as smooth."""
LOOSE = frozenset({"mirror plate", "glass plate", "stone plate", "chrome tray", "standing mirror"})
"""What stands on a surface, rather than being it."""
_INSTEAD_OF_TOPS: dict[ReceiverKind, ReceiverKind] = {
    "mirror top": "mirror plate", "glass top": "glass plate", "lacquer top": "stone plate",
}  # fmt: skip
MOST_ON_PLATE = 5
"""Objects that a plate or a tray has room for."""
BEFORE_MIRROR, LEAST_FREE = 0.7, 0.16
"""Half the angle [rad] in which cameras look into a standing mirror; surface [m²] that it leaves: as tables have."""
GAP = 0.0004
"""Air [m] between a plate and what it lies on, so that no two surfaces coincide."""
MOST_PLACES = 250
"""Places on a surface that are tried for one, about."""


def choose_receiver(rng: Rng, *, loose: bool = False) -> ReceiverKind:
    """Draw a receiver; `loose`: where there is no table top to change, plates stand in."""
    kind = weighted_pick(rng, PROBABILITIES)
    return _INSTEAD_OF_TOPS.get(kind, kind) if loose else kind


def receiver_material(rng: Rng, kind: ReceiverKind) -> Material:
    """Draw what a receiver is made of."""
    match kind:
        case "mirror top" | "mirror plate" | "standing mirror":
            return sample_material(rng, "mirror")
        case "chrome tray":
            metal = str(rng.choice(("chromium", "steel", "silver", "brass")))
            return sample_material(rng, "mirror", colour=METALS[metal], name=metal).model_copy(
                update={"roughness": float(rng.uniform(0.02, 0.12))}
            )
        case "glass top" | "glass plate":
            return sample_material(rng, "glass" if rng.random() < 0.6 else "tinted glass")
        case "stone plate":
            dark = linear_from_hex(str(rng.choice(("2f2f31", "46464a", "6b6964", "d9d6cf", "5c4a40"))))
            return sample_material(rng, "polished stone", colour=dark)
        case _:
            return sample_material(rng, "lacquer")


def with_receiver(rng: Rng, library: AssetLibrary, setting: Setting, kind: ReceiverKind) -> Setting:
    """Put a plate, a tray or a standing mirror on a setting's surface; objects then stand on it, or before it.

    Raises `PlacementError` where it does not fit.
    """
    if kind not in LOOSE:
        return setting
    category = {"chrome tray": "tray", "standing mirror": "mirror"}.get(kind, "slab")
    found = [i for i in library.list("surrounding") if i.category == category and i.id.startswith("builtin/")]
    found = [info for info in found if info.category != "mirror" or "standing" in info.id]
    info, mesh, local = _fitting(rng, library, setting, found, behind=kind == "standing mirror")
    low, high = (corner.astype(np.float64) for corner in mesh.bounds())
    pose = setting.world_from_surface @ local
    materials = body_materials(rng, library, info, mesh)
    made = (receiver_material(rng, kind), *materials[1:])
    body = make_body(category, "support", info, mesh, made, pose)
    setting = replace(setting, bodies=(*setting.bodies, body), solids=(*setting.solids, category))
    if kind == "standing mirror":
        corners = apply_pose(local, np.array([low, high]))[:, :2]
        free = without_box(setting.surface, corners.min(axis=0) - 0.01, corners.max(axis=0) + 0.01)
        if free.area < LEAST_FREE:
            raise PlacementError(f"a mirror of {info.size} m leaves {free.area:.2f} m² free, need {LEAST_FREE}")
        return replace(setting, surface=free, opening=min(setting.opening, BEFORE_MIRROR))
    try:
        surface = find_support(mesh, smallest=0.3)
    except SupportError as error:
        raise PlacementError(f"{info.id}: {error}") from None
    return replace(setting, surface=surface, world_from_surface=pose, most=min(setting.most, MOST_ON_PLATE))


def _fitting(
    rng: Rng, library: AssetLibrary, setting: Setting, infos: list[AssetInfo], *, behind: bool
) -> tuple[AssetInfo, Mesh, Float64]:
    """Draw one of those that fit on the surface, and its place there; raises `PlacementError` where none does."""
    left = list(infos)
    while True:
        info = pick(rng, left)
        mesh = library.mesh(info.id)
        low, high = (corner.astype(np.float64) for corner in mesh.bounds())
        try:
            return info, mesh, _pose_for(rng, setting, low, high, behind=behind)
        except PlacementError:
            left.remove(info)
            if not left:
                raise


def _pose_for(rng: Rng, setting: Setting, low: Float64, high: Float64, *, behind: bool) -> Float64:
    """Find where a box fits wholly on the surface, in its frame (4, 4): its centre, or the back, facing the front.

    Raises `PlacementError` where it fits nowhere.
    """
    surface = setting.surface
    # Of the four directions along the surface's sides, the one whose -Y looks to the cameras.
    front = setting.world_from_surface[:2, :2].T @ np.array([np.cos(setting.front), np.sin(setting.front)])
    quarter = round(float(np.arctan2(front[1], front[0]) + np.pi / 2) / (np.pi / 2))
    quarters = [quarter] if behind else [quarter, quarter + 1]
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    places = surface.centres[surface.clearance[surface.free] > 0.02]
    forward = places @ front
    # A mirror stands as far back as it can, a plate at the centre.
    score = forward if behind else np.linalg.norm(places - places.mean(axis=0), axis=1)
    order = np.argsort(score + rng.uniform(0.0, 0.05, len(places)))
    for quarter in quarters:
        outline = corners @ about_z(quarter * np.pi / 2)[:2, :2].T
        for place in places[order[:: max(1, len(order) // MOST_PLACES)]]:
            if surface.supports(outline + place, 0.01):
                return pose_at(place, surface.height + GAP, quarter * np.pi / 2)
    raise PlacementError(f"a plate of {np.ptp(corners, axis=0).round(2)} m does not fit the surface")
