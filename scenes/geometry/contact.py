"""What in a scene lies in what, and what carries it: exact, on the true meshes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from trimesh.creation import icosphere

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.overlap import boxes_meet, depth, surfaces_cross, touching_in_turn
from multilight.scenes.geometry.rays import body_triangles
from multilight.scenes.geometry.solids import Placed, Solid, solid_of
from multilight.scenes.poses import matrix4
from multilight.scenes.spec import Body, MeshAsset, Rectangle, Sphere

TOLERANCE = 1e-3
"""Overlaps deeper and gaps wider than this [m] are faults."""
SINK = 3e-3
"""How far [m] a body that is held must not be able to sink."""
BACKING = 0.1
"""Thickness [m] behind the rectangles of a surrounding: what pokes through a wall lies in it."""

How = Literal["stands", "held", "hangs"]


@dataclass(frozen=True)
class Overlap:
    """Two bodies whose surfaces lie `depth` [m] in each other."""

    first: str
    second: str
    depth: float


@dataclass(frozen=True)
class ContactReport:
    """What is wrong with a scene's contacts, and how each body that is carried is carried.

    `overlaps` deepest first; `unsupported` in the scene's order; `supports` maps a body to how it is carried:
    it `stands` (its centre of mass lies over the hull of the contacts below it), is `held` (over the hull of all
    its contacts), or `hangs` on a wall or a ceiling.
    """

    overlaps: tuple[Overlap, ...]
    unsupported: tuple[str, ...]
    supports: dict[str, How]


class Touch:
    """The points where two bodies touch, looked for only as far as they are asked for."""

    def __init__(self, first: Placed, second: Placed) -> None:
        self._known: list[Float64] = []
        self._further = touching_in_turn(first, second, TOLERANCE)

    def in_turn(self) -> Iterator[Float64]:
        """Yield the points bit by bit, (N, 3) each."""
        yield from self._known
        for points in self._further:
            self._known.append(points)
            yield points

    def points(self) -> Float64:
        """Return all points, (N, 3)."""
        return np.concatenate([np.empty((0, 3)), *self.in_turn()])


Touches = dict[str, dict[str, Touch]]
"""For each body how it touches each of those near it, if it does."""


class Solids:
    """Makes bodies into solids, each geometry once."""

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._made: dict[tuple[str, float, bool], Solid] = {}

    def place(self, body: Body) -> Placed:
        """Return a body as a solid in the world; a surrounding's rectangles are slabs, others are sheets."""
        pose = np.array(body.world_from_body)
        scale = round(float(np.cbrt(np.linalg.det(pose[:3, :3]))), 9)
        slab = body.role == "surrounding" and isinstance(body.geometry, Rectangle)
        key = (body.geometry.canonical_json(), scale, slab)
        if key not in self._made:
            self._made[key] = self._solid(body, scale, slab=slab)
        rigid = pose.copy()
        rigid[:3, :3] /= scale
        return Placed(self._made[key], rigid)

    def _solid(self, body: Body, scale: float, *, slab: bool) -> Solid:
        if scale == 1.0 and isinstance(body.geometry, MeshAsset):
            return solid_of(self._library.mesh(body.geometry.asset))
        vertices, faces = self._triangles(body, slab=slab)
        return Solid(vertices * scale, faces)

    def _triangles(self, body: Body, *, slab: bool) -> tuple[Float64, Int64]:
        if isinstance(body.geometry, Sphere):
            ball = icosphere(subdivisions=5, radius=body.geometry.radius)
            return np.asarray(ball.vertices), np.asarray(ball.faces)
        unposed = body.model_copy(update={"world_from_body": matrix4(np.eye(4))})
        vertices, faces = body_triangles(unposed, self._library)
        return _slab(vertices, faces) if slab else (vertices, faces)


def _slab(vertices: Float64, faces: Int64) -> tuple[Float64, Int64]:
    """Give a rectangle (4, 3) in its XY plane a back."""
    a, b = np.arange(4), np.roll(np.arange(4), -1)
    sides = np.concatenate([np.stack([b, a, a + 4], 1), np.stack([b, a + 4, b + 4], 1)])
    back = vertices - [0.0, 0.0, BACKING]
    return np.concatenate([vertices, back]), np.concatenate([faces, faces[:, ::-1] + 4, sides])


def check_contacts(bodies: Sequence[Body], library: AssetLibrary) -> ContactReport:
    """Check every pair of bodies for overlap, and every body for what carries it.

    Bodies of role `surrounding` carry without being carried, and may overlap each other. Gaps up to `TOLERANCE`
    count as contact, depths up to it as none.
    """
    solids = Solids(library)
    placed = {body.name: solids.place(body) for body in bodies}
    fixed = {body.name for body in bodies if body.role == "surrounding"}
    overlaps = []
    touches: Touches = {name: {} for name in placed}
    for first, second in combinations(placed, 2):
        pair = placed[first], placed[second]
        if (first in fixed and second in fixed) or not boxes_meet(*pair, reach=TOLERANCE):
            continue
        if (deep := depth(*pair, ignore=0.9 * TOLERANCE)) > TOLERANCE:
            overlaps.append(Overlap(first, second, deep))
        touches[first][second] = touches[second][first] = Touch(*pair)
    supports = _carried(placed, touches, fixed)
    free = [name for name in placed if name not in fixed]
    return ContactReport(
        overlaps=tuple(sorted(overlaps, key=lambda entry: -entry.depth)),
        unsupported=tuple(name for name in free if name not in supports),
        supports=supports,
    )


def support_of(placed: Placed, contacts: Sequence[tuple[Placed, Float64]]) -> How | None:
    """Tell how neighbours carry a body, given each with the contact points (N, 3): it stands, is held, or neither."""
    if not contacts:
        return None
    points = np.concatenate([points for _, points in contacts])
    centre = placed.centre_of_mass
    if _over(points[points[:, 2] < centre[2]], centre):
        return "stands"
    if not _over(points, centre):
        return None
    # A bowl in a bowl is held from the sides; what only touches a ceiling could sink.
    sunk = placed.moved(np.array([0.0, 0.0, -SINK]))
    return "held" if any(surfaces_cross(sunk, other) for other, _ in contacts) else None


def _stands(placed: Placed, touched: Iterable[Touch]) -> bool:
    """Tell whether neighbours carry a body that stands, looking for no more contacts than it takes."""
    centre, below = placed.centre_of_mass, np.empty((0, 3))
    for touch in touched:
        for points in touch.in_turn():
            more = points[points[:, 2] < centre[2]]
            below = np.concatenate([below, more])
            if len(more) and _over(below, centre):
                return True
    return False


def _over(points: Float64, centre: Float64) -> bool:
    """Tell whether a centre (3,) lies over the convex hull of points (N, 3), to within a millimetre."""
    if not len(points):
        return False
    flat = points[:, :2]
    if float(np.linalg.norm(flat - centre[:2], axis=1).min()) <= TOLERANCE:
        return True
    try:
        hull = ConvexHull(flat)
    except (QhullError, ValueError):
        return False
    return bool((hull.equations[:, :2] @ centre[:2] + hull.equations[:, 2] <= TOLERANCE).all())


def _carried(placed: dict[str, Placed], touches: Touches, fixed: set[str]) -> dict[str, How]:
    """Tell how each body is carried: from the surrounding upwards, then those that lean on each other."""
    supports: dict[str, How] = {}
    while True:
        firm = fixed | set(supports)
        waiting = set(placed) - firm
        found = _resting(placed, touches, waiting, firm, fixed) or _leaning(placed, touches, waiting, firm, fixed)
        if not found:
            return {name: supports[name] for name in placed if name in supports}
        supports |= found


def _resting(
    placed: dict[str, Placed], touches: Touches, waiting: set[str], firm: set[str], fixed: set[str]
) -> dict[str, How]:
    """Find which of the waiting bodies rest on what is firm."""
    found: dict[str, How] = {}
    for name in waiting:
        body = placed[name]
        touched = {other: touch for other, touch in touches[name].items() if other in firm}
        if _stands(body, touched.values()):
            found[name] = "stands"
            continue
        near = {other: points for other, touch in touched.items() if len(points := touch.points())}
        how = support_of(body, [(placed[other], points) for other, points in near.items()])
        if how is None:
            fastened = [points[:, 2].max() for other, points in near.items() if other in fixed]
            how = "hangs" if max(fastened, default=-np.inf) >= body.centre_of_mass[2] else None
        if how is not None:
            found[name] = how
    return found


def _leaning(
    placed: dict[str, Placed], touches: Touches, waiting: set[str], firm: set[str], fixed: set[str]
) -> dict[str, How]:
    """Find bodies that carry each other while the group rests on what is firm: leave out those that fail, repeat."""
    group = waiting
    while group:
        found = _resting(placed, touches, group, firm | group, fixed)
        if set(found) == group:
            touched = ((other, touch) for name in group for other, touch in touches[name].items())
            grounded = any(other in firm and len(touch.points()) for other, touch in touched)
            return found if grounded else {}
        group = set(found)
    return {}
