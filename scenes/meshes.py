"""Triangle meshes as backends receive them, and the plain shapes as meshes."""

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from multilight.scenes.arrays import Float32, Int64
from multilight.scenes.files.atomic import write_whole
from multilight.scenes.frozen import Frozen
from multilight.scenes.spec import Material, Rectangle, Sphere

Real = TypeVar("Real", np.float32, np.float64)
P = ParamSpec("P")
T = TypeVar("T")
Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True)
class MeshPart:
    """Triangles that share one material.

    vertices (V, 3) float32 metres, faces (F, 3) int32 counter-clockwise seen from outside, normals (V, 3)
    float32 unit shading normals, uv (V, 2) float32 with the origin at the image's bottom left, or zeros; colors
    (V, 3) float32, linear, multiply the base colour where they are given.
    """

    name: str
    vertices: Float32
    faces: NDArray[np.int32]
    normals: Float32
    uv: Float32
    material: Material
    colors: Float32 | None = None

    def triangles(self) -> Float32:
        """Return the corners of its faces, (F, 3, 3) float32, metres."""
        return self.vertices[self.faces]


def once_a_mesh(make: Callable[Concatenate["Mesh", P], T]) -> Callable[Concatenate["Mesh", P], T]:
    """Work a thing out once for a mesh (and what else it is asked with), and keep it as long as the mesh lives.

    Nobody may change what comes back.
    """

    @wraps(make)
    def recall(mesh: "Mesh", *args: P.args, **kwargs: P.kwargs) -> T:
        key = (make, args, *kwargs.items())
        if key not in mesh.kept:
            mesh.kept[key] = make(mesh, *args, **kwargs)
        found: T = mesh.kept[key]
        return found

    return recall


@dataclass(frozen=True)
class Mesh:
    """The parts of one asset, in the body's frame: metres, Z-up, standing on z = 0, centred in x and y.

    `kept` is what `once_a_mesh` has worked out.
    """

    parts: tuple[MeshPart, ...]
    kept: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @once_a_mesh
    def vertices(self) -> Float32:
        """Stack all parts' vertices, (N, 3) float32, metres."""
        return read_only(np.concatenate([part.vertices for part in self.parts]))

    def part_of_face(self) -> Int64:
        """Return the part that each face belongs to, all parts' faces stacked, (F,) int64."""
        return np.repeat(np.arange(len(self.parts)), [len(part.faces) for part in self.parts])

    @once_a_mesh
    def bounds(self) -> Float32:
        """Return the lowest and the highest corner, (2, 3) float32, metres."""
        points = self.vertices()
        return read_only(np.stack([points.min(axis=0), points.max(axis=0)]))

    @once_a_mesh
    def sha256(self) -> str:
        """Hash the arrays and the materials (64 hex digits)."""
        digest = hashlib.sha256()
        for part in self.parts:
            digest.update(part.material.canonical_json().encode())
            given = () if part.colors is None else (part.colors,)
            for array in (part.vertices, part.faces, part.normals, part.uv, *given):
                digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def stacked(pieces: Iterable[tuple[NDArray[Real], NDArray[np.integer]]]) -> tuple[NDArray[Real], Int64]:
    """Join the vertices (V, D) and faces (F, 3) of pieces into one; the faces come as int64."""
    pieces = list(pieces)
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in pieces[:-1]])
    faces = [faces.astype(np.int64) + start for (_, faces), start in zip(pieces, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces)


def read_only(array: NDArray[Number]) -> NDArray[Number]:
    """Return an array that several share, so that none of them can change it."""
    array.setflags(write=False)
    return array


def triangle_crosses(triangles: NDArray[Real]) -> NDArray[Real]:
    """Return the cross products (F, 3) of two edges of triangles (F, 3, 3): along their normals, twice as long as their
    areas [m²].
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.asarray(np.cross(b - a, c - a))


def triangle_areas(triangles: NDArray[Real]) -> NDArray[Real]:
    """Return the areas (F,) of triangles (F, 3, 3) [m²]."""
    return np.asarray(np.linalg.norm(triangle_crosses(triangles), axis=1) / 2)


def sphere_part(shape: Sphere, material: Material) -> MeshPart:
    """Make a smooth sphere of 20,480 triangles, true to within 1e-4 of its radius; uv by longitude and latitude."""
    from trimesh.creation import icosphere  # slow to import, and few need it

    ball = icosphere(subdivisions=5)
    normals = ball.vertices.astype(np.float32)
    # Let the faces' centres lie as much inside the true sphere as the vertices lie outside.
    inner = np.linalg.norm(ball.triangles_center, axis=1).min()
    longitude = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi) + 0.5
    latitude = np.arcsin(np.clip(normals[:, 2], -1, 1)) / np.pi + 0.5
    uv = np.stack([longitude, latitude], axis=1).astype(np.float32)
    vertices = normals * np.float32(shape.radius / np.sqrt(inner))
    return MeshPart("sphere", vertices, ball.faces.astype(np.int32), normals, uv, material)


def rectangle_part(shape: Rectangle, material: Material) -> MeshPart:
    """Make a rectangle that faces +Z, with uv in metres from its centre."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
    corners *= np.array([shape.width, shape.height], np.float32) / 2
    vertices = np.concatenate([corners, np.zeros((4, 1), np.float32)], axis=1)
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    return MeshPart("rectangle", vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), normals, corners, material)


class _Header(Frozen):
    """The JSON line kept inside a mesh file."""

    names: tuple[str, ...]
    materials: tuple[Material, ...]


def save_mesh(mesh: Mesh, path: Path) -> None:
    """Write a mesh as an uncompressed NPZ, whole or not at all."""
    header = _Header(names=tuple(p.name for p in mesh.parts), materials=tuple(p.material for p in mesh.parts))
    arrays: dict[str, NDArray[np.generic]] = {"header": np.frombuffer(header.canonical_json().encode(), np.uint8)}
    for i, part in enumerate(mesh.parts):
        arrays |= {f"v{i}": part.vertices, f"f{i}": part.faces, f"n{i}": part.normals, f"t{i}": part.uv}
        if part.colors is not None:
            arrays[f"c{i}"] = part.colors
    path.parent.mkdir(parents=True, exist_ok=True)
    with write_whole(path) as work:
        np.savez(work, **arrays)


def load_mesh(path: Path) -> Mesh:
    """Read what `save_mesh` wrote; never unpickles.

    A damaged file makes NumPy, `zipfile` or pydantic raise errors of many kinds; `ValueError` where the arrays make no
    mesh.
    """
    with path.open("rb") as file:
        data = np.load(file, allow_pickle=False)
        if not isinstance(data, NpzFile):
            raise ValueError("it is no NPZ file")
        header = _Header.from_json(data["header"].tobytes().decode())
        parts = tuple(
            MeshPart(
                name,
                read_only(data[f"v{i}"]),
                read_only(data[f"f{i}"]),
                read_only(data[f"n{i}"]),
                read_only(data[f"t{i}"]),
                material,
                read_only(data[f"c{i}"]) if f"c{i}" in data else None,
            )
            for i, (name, material) in enumerate(zip(header.names, header.materials, strict=True))
        )
    for part in parts:
        _check_arrays(part)
    return Mesh(parts)


def _check_arrays(part: MeshPart) -> None:
    """Raise `ValueError` where a part's arrays are not of their types and shapes, or a face names no vertex."""
    count = len(part.vertices)
    wanted = [(part.vertices, (count, 3)), (part.normals, (count, 3)), (part.uv, (count, 2))]
    if part.colors is not None:
        wanted.append((part.colors, (count, 3)))
    if part.faces.dtype != np.int32 or part.faces.ndim != 2 or part.faces.shape[1] != 3 or not len(part.faces):
        raise ValueError(f"part {part.name!r} has no faces")
    if any(array.dtype != np.float32 or array.shape != shape for array, shape in wanted):
        raise ValueError(f"part {part.name!r} has arrays of other types or shapes than a mesh's")
    if part.faces.min() < 0 or part.faces.max() >= count:
        raise ValueError(f"part {part.name!r} has faces that name vertices which are not there")
