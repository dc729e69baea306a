"""How deep one solid lies in another, where they touch, and how far apart they are.

The depth of two solids is the largest distance by which a point on the surface of one lies below the surface of the
other.
"""

from collections.abc import Iterator

import fcl
import numpy as np
from trimesh.triangles import closest_point

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.geometry.solids import Placed, Solid, bvh
from multilight.scenes.meshes import triangle_crosses
from multilight.scenes.poses import apply_pose

ACCURACY = 1e-4
"""How far [m] a depth may lie below the true one."""
NEGLIGIBLE = 3e-4
"""Depths below this [m] are not looked for, unless asked: things that lie flush would take long."""
MOST_TRIANGLES = 60_000
"""Pieces looked at in one round before a search settles for the accuracy reached."""

CELLS = 32
"""Cells along each side of the grid by which triangles that lie apart are left out."""
FEW = 500
"""So few triangles are asked about at once."""
MOST_FINE = 2000
"""Of a mesh's fine triangles so many are enough to tell where it touches another."""


Box = tuple[Float64, Float64]
"""Lowest and highest corner, (3,) each."""


def boxes_meet(first: Placed, second: Placed, reach: float = 0.0) -> bool:
    """Tell whether the boxes about two solids come within `reach` [m] of each other."""
    if not _meet(first.box, second.box, reach):
        return False
    # What stands askew has a large box: compare in the frames of both.
    pairs = ((first, second), (second, first))
    return all(_meet((a.solid.low, a.solid.high), _box(_local(b.vertices, a)), reach) for a, b in pairs)


def _meet(first: Box, second: Box, reach: float) -> bool:
    (low, high), (other_low, other_high) = first, second
    return bool((low <= other_high + reach).all() and (other_low <= high + reach).all())


def surfaces_cross(first: Placed, second: Placed) -> bool:
    """Tell whether any triangle of one cuts a triangle of the other."""
    if max(len(first.solid.faces), len(second.solid.faces)) < 1000:
        return _cut(first.collider, second.collider)
    # Trees over large meshes cost more than the question: take only what lies in the box of what lies in the box.
    one = first.triangles_near(*second.box)
    other = second.triangles_near(*_box(one)) if len(one) else one
    for frame in (first, second):
        if not len(one) or not len(other):
            return False
        if len(one) + len(other) < FEW:
            break
        keep, keep_other = _sharing_cells(_local(one, frame), _local(other, frame))
        one, other = one[keep], other[keep_other]
    return len(one) > 0 and len(other) > 0 and _cut(_collider(one), _collider(other))


def _sharing_cells(one: Float64, other: Float64) -> tuple[Mask, Mask]:
    """Tell of triangles (T, 3, 3) and (U, 3, 3) which have boxes that share a cell of a grid with one of the others."""
    boxes = [(triangles.min(axis=1), triangles.max(axis=1)) for triangles in (one, other)]
    low = np.maximum(*(lowest.min(axis=0) for lowest, _ in boxes))
    high = np.minimum(*(highest.max(axis=0) for _, highest in boxes))
    side = np.maximum(high - low, 1e-9) / CELLS
    inside = [(lowest <= high).all(axis=1) & (highest >= low).all(axis=1) for lowest, highest in boxes]
    cells = [
        [np.clip((corner[keep] - low) / side, 0, CELLS - 1).astype(np.int64) for corner in box]
        for box, keep in zip(boxes, inside, strict=True)
    ]
    for mask, own, others in zip(inside, cells, cells[::-1], strict=True):
        before = _boxes_before(others)
        mask[mask] = sum(sign * before[corner] for sign, corner in _corners(*own)) > 0
    return inside[0], inside[1]


def _corners(first: Int64, last: Int64) -> Iterator[tuple[int, Int64]]:
    """Yield the corners of boxes of cells (N, 3): a sign, and the numbers (N,) of grid points.

    A sum over a box is the sum over corners of the sign times the sum over all cells before the point.
    """
    for upper in np.ndindex(2, 2, 2):
        x, y, z = np.where(upper, last + 1, first).T
        yield (-1) ** (3 - sum(upper)), (x * (CELLS + 1) + y) * (CELLS + 1) + z


def _boxes_before(cells: list[Int64]) -> Int64:
    """Sum, over all cells before each point of the grid, in how many boxes each cell lies, ((CELLS + 1)³,)."""
    points = (CELLS + 1) ** 3
    steps = np.zeros(points, np.int64)
    for sign, corner in _corners(*cells):
        steps -= sign * np.bincount(corner, minlength=points)
    boxes = steps.reshape(CELLS + 1, CELLS + 1, CELLS + 1).cumsum(0).cumsum(1).cumsum(2)[:-1, :-1, :-1]
    return np.pad(boxes.cumsum(0).cumsum(1).cumsum(2), ((1, 0),) * 3).ravel()


def _cut(first: fcl.CollisionObject, second: fcl.CollisionObject) -> bool:
    return bool(fcl.collide(first, second, fcl.CollisionRequest(), fcl.CollisionResult()) > 0)


def _collider(triangles: Float64) -> fcl.CollisionObject:
    return fcl.CollisionObject(bvh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)))


def gap(first: Placed, second: Placed) -> float:
    """Return the smallest distance [m] between two surfaces; 0 where they cross."""
    return max(0.0, fcl.distance(first.collider, second.collider, fcl.DistanceRequest(), fcl.DistanceResult()))


def depth(first: Placed, second: Placed, *, ignore: float = NEGLIGIBLE) -> float:
    """Return how deep two solids lie in each other [m], 0 where they do not.

    Exact to `ACCURACY` above `ignore` [m]; below, it may come out as anything from 0 to that. Where a sheet crosses a
    sheet there is no inside: then how far one pokes through the other at most, by its vertices.
    """
    if not boxes_meet(first, second):
        return 0.0
    crossing = surfaces_cross(first, second)
    deepest = 0.0
    for inner, outer in ((first, second), (second, first)):
        if outer.solid.is_closed and (crossing or _holds(outer, inner)):
            deepest = max(deepest, _deepest(inner, outer, ignore)[0])
    if crossing and first.solid.is_sheet and second.solid.is_sheet:
        return max(deepest, min(_poke(first, second), _poke(second, first)))
    return deepest


def _holds(outer: Placed, inner: Placed) -> bool:
    """Tell whether any piece of `inner` begins inside `outer`."""
    low, high = outer.box
    probes = apply_pose(inner.pose, inner.solid.probes)
    probes = probes[((probes >= low) & (probes <= high)).all(axis=1)]
    return bool(outer.solid.contains(_local(probes, outer)).any())


def way_out(first: Placed, second: Placed) -> Float64:
    """Return the shift (3,) [m] that takes the deepest point of `first` out of `second`, or of `second` out of `first`.

    Zero where the solids do not lie in each other.
    """
    shift, deepest = np.zeros(3), 0.0
    if not boxes_meet(first, second):
        return shift
    for inner, outer, sign in ((first, second, 1.0), (second, first, -1.0)):
        if outer.solid.is_closed:
            found, point = _deepest(inner, outer, NEGLIGIBLE)
            if found > deepest:
                nearest = outer.solid.nearest(point)
                deepest, shift = found, sign * (outer.pose[:3, :3] @ (nearest - point))
    return shift


def _poke(first: Placed, second: Placed) -> float:
    """Return how far [m] the vertices of `first` reach to that side of `second` to which they reach less.

    Where all lie on one side they tell nothing: then the size of `first`.
    """
    points = apply_pose(np.linalg.inv(second.pose) @ first.pose, first.solid.vertices)
    distance, face = second.solid.distance(points)
    nearest = second.solid.triangles[face]
    above = ((points - nearest[:, 0]) * triangle_crosses(nearest)).sum(axis=1) > 0
    if above.all() or not above.any():
        return float((first.solid.high - first.solid.low).max())
    return min(float(distance[above].max()), float(distance[~above].max()))


def _box(points: Float64) -> Box:
    """Return the box about points (..., 3)."""
    points = points.reshape(-1, 3)
    return points.min(axis=0), points.max(axis=0)


def _local(points: Float64, placed: Placed) -> Float64:
    """Take points (..., 3) from the world to the frame of a solid."""
    return np.asarray((points - placed.pose[:3, 3]) @ placed.pose[:3, :3])


def _rounds(triangles: Float64) -> Iterator[tuple[Float64, Float64, Float64, list[Float64]]]:
    """Yield triangles with centre and radius; those put into the list come again, each cut in four."""
    while 0 < len(triangles) <= MOST_TRIANGLES:
        centre = triangles.mean(axis=1)
        radius = np.linalg.norm(triangles - centre[:, None], axis=2).max(axis=1)
        keep: list[Float64] = []
        yield triangles, centre, radius, keep
        triangles = _quartered(np.concatenate(keep)) if keep else np.empty((0, 3, 3))


def _quartered(triangles: Float64) -> Float64:
    """Cut each triangle (T, 3, 3) in four, (4 T, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])


def _reach_from(outer: Solid, face: Int64, triangles: Float64) -> Float64:
    """Return the largest distance [m] of each triangle's points to its given face of `outer`, (T,).

    The distance to a convex set is convex, so a corner has the largest.
    """
    target = outer.triangles[np.repeat(face, 3)]
    corners = triangles.reshape(-1, 3)
    return np.asarray(np.linalg.norm(closest_point(target, corners) - corners, axis=1).reshape(-1, 3).max(axis=1))


def _deepest(inner: Placed, around: Placed, ignore: float) -> tuple[float, Float64]:
    """Return the depth [m] of the deepest point of `inner`'s surface inside `around`, and that point: branch and bound.

    Depth changes no faster than one walks, and no point lies deeper than its distance to any one face.
    """
    best, where, outer = 0.0, np.zeros(3), around.solid
    for triangles, centre, radius, keep in _rounds(_local(inner.triangles_near(*around.box), around)):
        distance, face = outer.distance(centre)
        bar = max(best, ignore) + ACCURACY
        hopeful = (distance + radius > bar) & (_box_distance(outer, centre) <= radius)
        hopeful[hopeful] = _reach_from(outer, face[hopeful], triangles[hopeful]) > bar
        if not hopeful.any():
            break
        triangles, centre, radius, distance = triangles[hopeful], centre[hopeful], radius[hopeful], distance[hopeful]
        signed = np.where(outer.contains(centre), distance, -distance)
        deepest = int(np.argmax(signed))
        if signed[deepest] > best:
            best, where = float(signed[deepest]), centre[deepest]
        keep.append(triangles[signed + radius > max(best, ignore) + ACCURACY])
    return best, where


def _box_distance(outer: Solid, points: Float64) -> Float64:
    """Return the distance [m] of points (N, 3) to the box about a solid, 0 inside it, (N,)."""
    return np.asarray(np.linalg.norm(np.maximum(outer.low - points, 0) + np.maximum(points - outer.high, 0), axis=1))


def touching(first: Placed, second: Placed, reach: float = 1e-3) -> Float64:
    """Return points where two surfaces come within `reach` [m] of each other, (N, 3) in the world.

    Dense enough that their convex hull is that of the contact to within a twelfth of its size.
    """
    return np.concatenate([np.empty((0, 3)), *touching_in_turn(first, second, reach)])


def touching_in_turn(first: Placed, second: Placed, reach: float = 1e-3) -> Iterator[Float64]:
    """Yield what `touching` returns bit by bit, for those to whom fewer points may do."""
    if boxes_meet(first, second, reach):
        for inner, outer in ((first, second), (second, first)):
            for points in _close_points(inner, outer, reach):
                yield apply_pose(outer.pose, points)


def _close_points(inner: Placed, around: Placed, reach: float) -> Iterator[Float64]:
    """Yield points of `inner`'s surface within `reach` [m] of `around`'s, in the frame of the latter, (N, 3)."""
    (low, high), (own_low, own_high), outer = around.box, inner.box, around.solid
    finest = max(0.003, float((np.minimum(high, own_high) - np.maximum(low, own_low)).max()) / 12)
    near = _thinned(_local(inner.triangles_near(low - reach, high + reach), around), finest)
    for triangles, centre, radius, keep in _rounds(near):
        distance, face = outer.distance(centre)
        close = distance - radius <= reach
        triangles, face, radius = triangles[close], face[close], radius[close]
        yield centre[close][distance[close] <= reach]
        if not len(triangles):
            break
        # A triangle wholly close to one face is close everywhere: its corners say all.
        whole = _reach_from(outer, face, triangles) <= reach
        yield triangles[whole].reshape(-1, 3)
        rest = triangles[~whole & (radius > finest)]
        corners = triangles[~whole & (radius <= finest)].reshape(-1, 3)
        if len(corners):
            yield corners[outer.distance(corners)[0] <= reach]
        if len(rest):
            keep.append(rest)


def _thinned(triangles: Float64, finest: float) -> Float64:
    """Leave out some triangles that are smaller than `finest` [m] where there are very many, evenly."""
    small = np.ptp(triangles, axis=1).max(axis=1) < finest
    step = max(1, int(small.sum()) // MOST_FINE)
    return np.concatenate([triangles[~small], triangles[small][::step]])
