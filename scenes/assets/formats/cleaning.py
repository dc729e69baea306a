"""Turns raw triangles of a model file into clean mesh parts: scale, axes, winding, shading normals."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.meshes import Mesh, MeshPart, triangle_areas, triangle_crosses
from multilight.scenes.spec import Material

Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
CREASE = np.radians(44.0)
"""Faces that meet at a larger angle get a sharp edge where the file gives no normals."""


MOST_UV = 1000.0
"""Texture coordinates beyond this are taken for broken."""


@dataclass(frozen=True)
class RawPart:
    """Triangles of one material as a file gives them: vertices (V, 3), faces (F, 3), normals (V, 3), uv (V, 2).

    colors (V, 3) are linear, and multiply the base colour.
    """

    material: Material
    vertices: Float64
    faces: Int64
    normals: Float64 | None
    uv: Float64 | None
    colors: Float64 | None = None


def tinted(material: Material, colors: Float64) -> tuple[Material, Float64 | None]:
    """Let vertex colours (N, 3) that are the same everywhere be the base colour's."""
    if float(np.ptp(colors, axis=0).max()) >= 1e-6:
        return material, colors
    base = np.array(material.base_color) * np.clip(colors[0], 0, 1)
    return material.model_copy(update={"base_color": tuple(base.tolist())}), None


def transformed(parts: list[RawPart], matrix: Float64) -> list[RawPart]:
    """Apply a 3x3 matrix (rotation and scale) to vertices, and its inverse transpose to normals."""
    inverse = np.linalg.inv(matrix)
    flip = np.linalg.det(matrix) < 0
    return [
        replace(
            part,
            vertices=part.vertices @ matrix.T,
            faces=part.faces[:, ::-1] if flip else part.faces,
            normals=None if part.normals is None else part.normals @ inverse,
        )
        for part in parts
    ]


def extent(parts: list[RawPart]) -> tuple[Float64, Float64]:
    """Return the lowest and the highest corner of what the faces use, (3,) each."""
    points = np.concatenate([part.vertices[np.unique(part.faces)] for part in parts])
    return points.min(axis=0), points.max(axis=0)


def clean_mesh(parts: list[RawPart], *, turn_out: bool = True) -> Mesh:
    """Centre the parts in x and y, stand them on z = 0, and clean each; parts left without faces are dropped.

    `turn_out`: closed pieces that are inside out are turned; not so for a room, which is one seen from inside.
    Raises `ValueError` where nothing is left or a coordinate is not finite.
    """
    parts = [part for part in parts if len(part.faces)]
    if not parts or not all(np.isfinite(part.vertices).all() for part in parts):
        raise ValueError("has no faces" if not parts else "has coordinates that are not finite")
    low, high = extent(parts)
    size = float((high - low).max())
    offset = np.array([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    cleaned = (_clean(replace(part, vertices=part.vertices + offset), size, turn_out) for part in parts)
    result = tuple(part for part in cleaned if part is not None)
    if not result:
        raise ValueError("has only degenerate faces")
    return Mesh(result)


def _clean(part: RawPart, size: float, turn_out: bool) -> MeshPart | None:
    """Drop degenerate and doubled faces, make winding and normals agree, and keep only used vertices."""
    welded, corner = _weld(part.vertices, size * 1e-6)
    faces, kept = _sound(part.vertices, part.faces, corner)
    if not len(kept):
        return None
    welded_faces = corner[faces]
    normals = part.normals if _usable(part.normals, faces) else None
    if normals is not None:
        cross = triangle_crosses(part.vertices[faces])
        against = np.einsum("fi,fi->f", cross, normals[faces].sum(axis=1)) < 0
    else:
        against = np.zeros(len(faces), dtype=bool)
    faces = np.where(against[:, None], faces[:, ::-1], faces)
    welded_faces = np.where(against[:, None], welded_faces[:, ::-1], welded_faces)
    inside_out = _inside_out(welded, welded_faces) if turn_out else np.zeros(len(faces), dtype=bool)
    faces = np.where(inside_out[:, None], faces[:, ::-1], faces)
    if normals is None:
        corner_normals = _crease_normals(part.vertices, faces, corner[faces])
    else:
        corner_normals = normals[faces] * np.where(inside_out, -1.0, 1.0)[:, None, None]
        corner_normals /= np.linalg.norm(corner_normals, axis=-1, keepdims=True)
    uv = np.zeros((len(part.vertices), 2)) if part.uv is None else np.nan_to_num(part.uv)
    # Some files hold rubbish such as 3e9 here, which makes renderers read outside of their textures.
    uv = np.where(np.abs(uv) <= MOST_UV, uv, 0.0)
    colors = () if part.colors is None else (np.clip(np.nan_to_num(part.colors), 0, 1)[faces],)
    return _indexed(part.material, part.vertices[faces], corner_normals, uv[faces], *colors)


def _weld(vertices: Float64, tolerance: float) -> tuple[Float64, Int64]:
    """Merge vertices that share a place: the places (W, 3), and each vertex's place (V,)."""
    keys = np.round(vertices / max(tolerance, 1e-12)).astype(np.int64)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return vertices[first], inverse.reshape(-1)


def _sound(vertices: Float64, faces: Int64, corner: Int64) -> tuple[Int64, Int64]:
    """Keep faces with three different corners and an area, and the first of those with the same corners."""
    places = np.sort(corner[faces], axis=1)
    solid = (np.diff(places, axis=1) > 0).all(axis=1)
    triangles = vertices[faces]
    longest = np.ptp(triangles, axis=1).max(axis=1)
    solid &= np.linalg.norm(triangle_crosses(triangles), axis=1) > 1e-9 * longest**2
    kept = np.flatnonzero(solid)
    _, first = np.unique(places[kept], axis=0, return_index=True)
    kept = kept[np.sort(first)]
    return faces[kept], kept


def _usable(normals: Float64 | None, faces: Int64) -> bool:
    """Tell whether the file's normals can be trusted: finite and not zero wherever a face uses them."""
    if normals is None:
        return False
    used = normals[np.unique(faces)]
    return bool(np.isfinite(used).all() and (np.linalg.norm(used, axis=1) > 1e-6).all())


def _inside_out(places: Float64, faces: Int64) -> Mask:
    """Find the faces of connected pieces that enclose a negative volume, (F,) bool."""
    count = len(places)
    ones = np.ones(2 * len(faces))
    links = coo_matrix((ones, (faces[:, [0, 1]].T.ravel(), faces[:, [1, 2]].T.ravel())), shape=(count, count))
    pieces, label = connected_components(links, directed=False)
    piece = label[faces[:, 0]]
    weight = np.maximum(np.bincount(piece, minlength=pieces), 1)
    centroid = places[faces].mean(axis=1)
    centre = np.stack([np.bincount(piece, centroid[:, i], pieces) / weight for i in range(3)], -1)
    triangles = places[faces] - centre[piece][:, None]
    a, b, c = np.moveaxis(triangles, 1, 0)
    volume = np.bincount(piece, np.einsum("fi,fi->f", a, np.cross(b, c)) / 6, pieces)
    area = np.bincount(piece, triangle_areas(triangles), pieces)
    return (volume < -0.01 * np.maximum(area, 1e-30) ** 1.5)[piece]


def _crease_normals(vertices: Float64, faces: Int64, places: Int64) -> Float64:
    """Average, for each corner, the normals of the faces around its place that bend less than `CREASE`, (F, 3, 3)."""
    cross = triangle_crosses(vertices[faces])
    unit = cross / np.linalg.norm(cross, axis=1, keepdims=True)
    flat = places.ravel()
    order = np.argsort(flat, kind="stable")
    _, start, count = np.unique(flat[order], return_index=True, return_counts=True)
    repeats = np.repeat(count, count)
    left = np.repeat(np.arange(len(flat)), repeats)
    first = np.repeat(np.repeat(start, count), repeats)
    right = first + np.arange(len(left)) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    left, right = order[left], order[right]
    near = np.einsum("pi,pi->p", unit[left // 3], unit[right // 3]) > np.cos(CREASE)
    left, right = left[near], right[near]
    weight = _corner_angles(vertices[faces]).ravel()[right]
    total = np.stack([np.bincount(left, weight * unit[right // 3, i], len(flat)) for i in range(3)], -1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 1e-9, total / np.maximum(length, 1e-9), np.repeat(unit, 3, axis=0)).reshape(-1, 3, 3)


def _corner_angles(corners: Float64) -> Float64:
    """Return the angle at each corner of each triangle, (F, 3) rad."""
    forward = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    cosine = (forward * back).sum(-1) / (np.linalg.norm(forward, axis=-1) * np.linalg.norm(back, axis=-1))
    return np.arccos(np.clip(cosine, -1, 1))


def _indexed(material: Material, points: Float64, normals: Float64, uv: Float64, *colors: Float64) -> MeshPart:
    """Share the corners (F, 3, ...) that are equal in place, normal, uv and colour."""
    table = np.concatenate([points, normals, uv, *colors], axis=-1).astype(np.float32)
    table = table.reshape(-1, table.shape[-1])
    keys = np.concatenate([table[:, :3], np.round(table[:, 3:6], 3), table[:, 6:]], axis=1) + np.float32(0)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    table = table[first]
    return MeshPart(
        name=material.name,
        vertices=np.ascontiguousarray(table[:, :3]),
        faces=inverse.reshape(-1, 3).astype(np.int32),
        normals=np.ascontiguousarray(table[:, 3:6]),
        uv=np.ascontiguousarray(table[:, 6:8]),
        material=material,
        colors=np.ascontiguousarray(table[:, 8:]) if colors else None,
    )
