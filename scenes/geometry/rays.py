"""What rays hit in a scene: line of sight for cameras, lights and placement."""

import functools
from collections.abc import Sequence

import numpy as np
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.support_surfaces import stacked_faces
from multilight.scenes.meshes import stacked, triangle_areas, triangle_crosses
from multilight.scenes.poses import apply_pose
from multilight.scenes.random_streams import Rng
from multilight.scenes.spec import Body, MeshAsset, Rectangle, Sphere


def body_triangles(body: Body, library: AssetLibrary) -> tuple[Float64, Int64]:
    """Return a body's vertices in the world, (V, 3) float64 metres, and its faces (F, 3) int64."""
    match body.geometry:
        case MeshAsset(asset=asset):
            mesh = library.mesh(asset)
            vertices, faces = mesh.vertices().astype(np.float64), stacked_faces(mesh)
        case Rectangle(width=width, height=height):
            signs = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
            vertices, faces = signs * [width / 2, height / 2, 0.0], np.array([[0, 1, 2], [0, 2, 3]])
        case Sphere(radius=radius):
            around, faces = _ball()
            vertices = radius * around
    return apply_pose(np.array(body.world_from_body), vertices), np.asarray(faces, np.int64)


@functools.cache
def _ball() -> tuple[Float64, Int64]:
    """Return the vertices (V, 3) and faces (F, 3) of a sphere of radius 1."""
    angle = np.linspace(0.0, np.pi, 13)
    ring = np.linspace(0.0, 2 * np.pi, 24, endpoint=False)
    around = np.stack([np.cos(ring), np.sin(ring)], axis=-1)
    flat = np.sin(angle)[:, None, None] * around
    vertices = np.concatenate([flat, np.broadcast_to(np.cos(angle)[:, None, None], (13, 24, 1))], -1)
    hull = Trimesh(vertices.reshape(-1, 3), process=False).convex_hull
    return np.asarray(hull.vertices), np.asarray(hull.faces, np.int64)


def part_triangles(body: Body, part: int, library: AssetLibrary) -> Float64:
    """Return the triangles of one part of a body in the world, (F, 3, 3) metres."""
    vertices, faces = body_triangles(body, library)
    if isinstance(body.geometry, MeshAsset):
        sizes = [len(p.faces) for p in library.mesh(body.geometry.asset).parts]
        faces = faces[sum(sizes[:part]) : sum(sizes[: part + 1])]
    return vertices[faces]


class SceneRays:
    """Casts rays at bodies; the index of a body is its position in the sequence given."""

    def __init__(self, bodies: Sequence[Body], library: AssetLibrary) -> None:
        pieces = [body_triangles(body, library) for body in bodies]
        self._solid = Trimesh(*stacked(pieces), process=False)
        self._body_of_face = np.repeat(np.arange(len(pieces)), [len(faces) for _, faces in pieces])
        self._tracer = RayMeshIntersector(self._solid)

    def first_hit(self, origins: Float64, directions: Float64) -> tuple[Int64, Float64]:
        """Return the body hit first (N,), -1 for none, and the distance (N,) [m], inf for none.

        `origins` (N, 3) metres; `directions` (N, 3) of any length but zero.
        """
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        face = self._tracer.intersects_first(origins, unit)
        a, normal = self._solid.triangles[face, 0], triangle_crosses(self._solid.triangles[face])
        facing = (normal * unit).sum(axis=1)
        distance = ((a - origins) * normal).sum(axis=1) / np.where(np.abs(facing) > 1e-30, facing, 1e-30)
        return np.where(face >= 0, self._body_of_face[face], -1), np.where(face >= 0, distance, np.inf)

    def sees(self, eye: Float64, points: Float64, *, slack: float = 0.01) -> Mask:
        """Tell for points (N, 3) whether the line from `eye` (3,) to `slack` [m] before them is free."""
        line = points - eye
        _, distance = self.first_hit(np.broadcast_to(eye, line.shape), line)
        return np.asarray(distance >= np.linalg.norm(line, axis=1) - slack)

    def visible_share(self, eye: Float64, body: int, points: Float64) -> float:
        """Return the fraction of the rays from `eye` (3,) to a body's surface points (N, 3) that hit that body first.

        An object hides part of itself; that does not count against it, what stands before it does.
        """
        hit, _ = self.first_hit(np.broadcast_to(eye, points.shape), points - eye)
        return float((hit == body).sum() / max(1, (hit >= 0).sum()))


def surface_points(body: Body, library: AssetLibrary, rng: Rng, count: int) -> Float64:
    """Draw `count` points evenly over a body's surface, (count, 3) float64 world metres."""
    vertices, faces = body_triangles(body, library)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = triangle_areas(vertices[faces])
    face = np.searchsorted(np.cumsum(area), rng.random(count) * area.sum())
    face = np.minimum(face, len(faces) - 1)
    u, v = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return np.asarray((1 - u) * a[face] + u * (1 - v) * b[face] + u * v * c[face])


def extreme_points(body: Body, library: AssetLibrary) -> Float64:
    """Return the vertices of a body that lie furthest along 26 directions, (26, 3) float64 world metres.

    What holds them in frame holds nearly all of the body; a few points of its surface do not tell.
    """
    vertices, _ = body_triangles(body, library)
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step != (1, 1, 1)]) - 1.0
    directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return np.asarray(vertices[np.argmax(vertices @ directions.T, axis=0)])
