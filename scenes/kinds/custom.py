"""Scenes in a background of one's own: objects on the surfaces that a scene file offers."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from multilight.scenes.arrays import Float64, Mask
from multilight.scenes.assets.library import AssetError, AssetLibrary
from multilight.scenes.geometry.contact import Solids
from multilight.scenes.geometry.rays import SceneRays, body_triangles
from multilight.scenes.geometry.solids import Placed
from multilight.scenes.geometry.support_surfaces import FLATNESS, SupportSurface, largest_region, largest_square
from multilight.scenes.meshes import triangle_crosses
from multilight.scenes.poses import direction_from
from multilight.scenes.random_streams import Streams, pick
from multilight.scenes.spec import Body, SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings, sample_still_life
from multilight.scenes.still_life.setting import Setting, make_body

CELL = 0.02
"""Grid [m] on which surfaces are looked for; coarser on surfaces beyond `MOST_CELLS`."""
MOST_CELLS = 250_000
HEADROOM = 0.5
"""Free height [m] that a surface needs."""
SMALLEST = 0.35
"""Side [m] of the smallest square that a usable surface holds."""
MOST_LEVELS = 24
"""Heights that are examined, those of the largest area first."""
STANDPOINT = 0.9
"""Distance [m] that must be free before a surface for cameras to stand there."""

EYE, RISE, DIRECTIONS = 0.15, np.radians(25.0), 48
"""Height [m] over a surface from which one looks for free sight, elevation [rad] and number of the directions."""
NARROWEST = 0.4
"""Angle [rad] to each side of the front that a usable surface is open to, at least."""


@dataclass(frozen=True)
class Place:
    """A surface of the background, and where cameras may stand: within `opening` [rad] of azimuth `front` [rad]."""

    surface: SupportSurface
    front: float
    opening: float


def background_bodies(library: AssetLibrary) -> tuple[Body, ...]:
    """Return the bodies of the library's background where the file has them."""
    if library.background is None:
        raise AssetError("kind custom needs a background; name a GLB, glTF, USD or .blend file with --background")
    bodies = []
    for piece in library.background.pieces:
        info = library.info(f"{library.background.name}/{piece.name}")
        mesh = library.mesh(info.id)
        materials = [part.material for part in mesh.parts]
        bodies.append(make_body(piece.name, "surrounding", info, mesh, materials, np.array(piece.world_from_body)))
    return tuple(bodies)


def sample_custom(streams: Streams, library: AssetLibrary, *, index: int, settings: StillLifeSettings) -> SceneSpec:
    """Draw objects and cameras in the library's background; its surfaces are found by level faces and free area.

    Raises `AssetError` where the background cannot serve, `SceneSamplingError` where no attempt succeeds.
    """
    bodies = background_bodies(library)
    places = find_places(bodies, library)
    # A floor is no better a place than a table, however large.
    weights = np.sqrt([min(place.surface.area, 1.0) for place in places])

    def build(attempt: int) -> Setting:
        place = pick(streams(f"place/{attempt}"), places, weights)
        return Setting(bodies, (), place.surface, np.eye(4), place.front, place.opening)

    return sample_still_life(streams, library, build, kind="custom", index=index, settings=settings)


def find_places(bodies: Sequence[Body], library: AssetLibrary) -> list[Place]:
    """Find level, free surfaces before which a camera can stand; what has a roof goes before roofs.

    Raises `AssetError` with the largest surface there is where none will do.
    """
    rays = SceneRays(bodies, library)
    solids = Solids(library)
    placed = [solid for solid in map(solids.place, bodies) if solid.solid.is_closed]
    corners = np.concatenate([v[f] for v, f in (body_triangles(body, library) for body in bodies)])
    found: list[SupportSurface] = []
    largest = 0.0
    for level, low, high in _levels(corners):
        for surface in _free_regions(rays, placed, level, (low, high)):
            side = largest_square(surface.free) * surface.cell
            largest = max(largest, side)
            if side >= SMALLEST:
                found.append(surface)
    covered = [surface for surface in found if _is_covered(rays, surface)]
    places = [_place(rays, surface) for surface in covered or found]
    usable = [place for place in places if place is not None]
    if not usable:
        assert library.background is not None
        raise AssetError(
            f"background {library.background.path} has no usable surface: level, {HEADROOM} m of air above it, "
            f"{SMALLEST} m square and open to a side; the largest found is {largest:.2f} m square"
        )
    return usable


def _levels(corners: Float64) -> list[tuple[float, Float64, Float64]]:
    """Return the heights [m] at which most level area lies, each with the box (2,) (2,) about it seen from above."""
    cross = triangle_crosses(corners)
    length = np.linalg.norm(cross, axis=1)
    level = np.abs(cross[:, 2]) > 0.98 * np.maximum(length, 1e-30)
    flat, area = corners[level], length[level] / 2
    height = flat[:, :, 2].mean(axis=1)
    key, group = np.unique(np.round(height / FLATNESS).astype(np.int64), return_inverse=True)
    total = np.bincount(group, area, len(key))
    result = []
    for number in np.argsort(-total, kind="stable")[:MOST_LEVELS]:
        if total[number] < SMALLEST**2:
            break
        corners = flat[group == number][:, :, :2]
        result.append((float(np.median(height[group == number])), corners.min((0, 1)), corners.max((0, 1))))
    return result


def _free_regions(
    rays: SceneRays, solids: Sequence[Placed], level: float, box: tuple[Float64, Float64]
) -> list[SupportSurface]:
    """Return the connected regions of a level that a ray from `HEADROOM` above reaches first, inside no solid."""
    low, high = box
    cell = max(CELL, float(np.sqrt(np.prod(high - low) / MOST_CELLS)))
    columns, rows = (np.arange(low[i] + cell / 2, high[i], cell) for i in (0, 1))
    if not len(columns) or not len(rows):
        return []
    x, y = np.meshgrid(columns, rows)
    origins = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, level + HEADROOM)])
    _, distance = rays.first_hit(origins, np.tile([0.0, 0.0, -1.0], (x.size, 1)))
    free = np.abs(distance - HEADROOM) <= FLATNESS
    free[free] = ~_is_inside(solids, origins[free] - [0.0, 0.0, HEADROOM - 0.02])
    free = free.reshape(x.shape)
    labels, count = ndimage.label(free)
    sizes = ndimage.sum_labels(free, labels, np.arange(1, count + 1))
    # Above the highest cell that counts, so that nothing is sunk into an uneven surface.
    top = level + HEADROOM - distance.reshape(x.shape)
    result = []
    for label in np.flatnonzero(sizes * cell**2 >= SMALLEST**2) + 1:
        region = labels == label
        result.append(SupportSurface(height=float(top[region].max()), origin=low, cell=cell, free=region, part=0))
    return result


def _is_inside(solids: Sequence[Placed], points: Float64) -> Mask:
    """Tell which points (N, 3) lie inside a closed piece: a cabinet's floor is no place to stand."""
    inside = np.zeros(len(points), bool)
    for placed in solids:
        low, high = placed.box
        near = np.flatnonzero((points >= low).all(axis=1) & (points <= high).all(axis=1) & ~inside)
        inside[near] = placed.solid.contains((points[near] - placed.pose[:3, 3]) @ placed.pose[:3, :3])
    return inside


def _is_covered(rays: SceneRays, surface: SupportSurface) -> bool:
    """Tell whether most of a surface has something above it."""
    points = surface.centres[:: max(1, len(surface.centres) // 50)]
    origins = np.column_stack([points, np.full(len(points), surface.height + 0.01)])
    hit, _ = rays.first_hit(origins, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    return bool((hit >= 0).mean() > 0.5)


def _place(rays: SceneRays, surface: SupportSurface) -> Place | None:
    """Find the widest side from which cameras can look at the centre of a surface; None where there is none."""
    centre = surface.centres[int(np.argmax(surface.edge_distance(surface.centres)))]
    eye = np.array([*centre, surface.height + EYE])
    azimuth = np.linspace(-np.pi, np.pi, DIRECTIONS, endpoint=False)
    outwards = np.stack([direction_from(angle, RISE) for angle in azimuth])
    _, distance = rays.first_hit(np.broadcast_to(eye, outwards.shape), outwards)
    free = distance > STANDPOINT
    if free.all():
        return Place(surface, front=-np.pi / 2, opening=np.pi)
    if not free.any():
        return None
    # Start at an azimuth that is blocked, so that no free stretch runs over the seam.
    start = int(np.argmin(free))
    stretch = np.flatnonzero(largest_region(np.roll(free, -start)))
    opening = len(stretch) * np.pi / DIRECTIONS
    front = azimuth[0] + (start + stretch.mean()) * 2 * np.pi / DIRECTIONS
    return Place(surface, front=float(front), opening=float(opening)) if opening > NARROWEST else None
