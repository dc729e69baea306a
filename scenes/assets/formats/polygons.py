"""Polygons as triangles."""

import numpy as np

from multilight.scenes.arrays import Float64, Int64


def triangulated(points: Float64, counts: Int64, corners: Int64) -> tuple[Int64, Int64]:
    """Return triangles (T, 3) of numbers of corners, and the polygon (T,) that each came from.

    points (V, 3); counts (F,) corners of each polygon, whose points are `corners`, end to end. Convex ones become
    fans; others lose ears, so that a notch stays open.
    """
    start = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    source = np.repeat(np.arange(len(counts)), fans)
    step = np.arange(len(source)) - np.repeat(np.cumsum(fans) - fans, fans)
    triangles = start[source][:, None] + np.stack([np.zeros_like(step), step + 1, step + 2], axis=1)
    normal = np.cross(*(points[corners[triangles[:, i]]] - points[corners[triangles[:, 0]]] for i in (1, 2)))
    total = np.stack([np.bincount(source, normal[:, i], len(counts)) for i in range(3)], axis=-1)
    notched = np.unique(source[np.einsum("ti,ti->t", normal, total[source]) < 0])
    for polygon in notched.tolist():
        own = start[polygon] + np.arange(counts[polygon])
        triangles[source == polygon] = own[_without_ears(points[corners[own]], total[polygon])]
    return triangles, source


def _without_ears(points: Float64, normal: Float64) -> Int64:
    """Cut a simple polygon (N, 3) into N - 2 triangles (Meisters 1975): one corner after the other is cut off."""
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, axis, axis=1) * (1, 1 if (normal[axis] > 0) == (axis != 1) else -1)
    left, result = list(range(len(flat))), []
    while len(left) > 3:
        for at in range(len(left)):
            a, b, c = (flat[left[(at + i) % len(left)]] for i in (-1, 0, 1))
            others = np.delete(flat[left], [(at + i) % len(left) for i in (-1, 0, 1)], axis=0)
            sides = [_side(p, q, others) for p, q in ((a, b), (b, c), (c, a))]
            if _side(a, b, c) > 0 and not np.logical_and.reduce([side >= 0 for side in sides]).any():
                break
        result.append([left[at - 1], left[at], left[(at + 1) % len(left)]])
        del left[at]
    return np.array([*result, left])


def _side(a: Float64, b: Float64, p: Float64) -> Float64:
    """Return on which side of a line points (..., 2) lie: above 0 on the left."""
    return np.asarray((b[0] - a[0]) * (p[..., 1] - a[1]) - (b[1] - a[1]) * (p[..., 0] - a[0]))
