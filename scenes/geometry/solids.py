"""Meshes as solids: what is inside, how far the surface is, and where they stand.

A mesh's closed pieces enclose its inside; open pieces are sheets without one (a paper, a single-walled bowl).
"""

from dataclasses import dataclass
from functools import cached_property

import fcl
import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError
from trimesh import Trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.geometry.support_surfaces import stacked_faces
from multilight.scenes.meshes import Mesh, once_a_mesh, triangle_areas, triangle_crosses
from multilight.scenes.poses import apply_pose

MOST_HITS = 200
"""Surfaces that a ray is followed through."""

_DIRECTIONS = tuple(np.array(d) / np.linalg.norm(d) for d in ((0.31, 0.42, 0.853), (-0.67, 0.21, -0.712)))
"""Directions that no axis-aligned edge runs along."""


class Solid:
    """Triangles in a body's frame, ready for questions: vertices (V, 3) metres, faces (F, 3) seen from outside."""

    def __init__(self, vertices: Float64, faces: Int64) -> None:
        used, index = np.unique(faces, return_inverse=True)
        self.vertices = np.ascontiguousarray(vertices[used], np.float64)
        self.faces = np.ascontiguousarray(index.reshape(-1, 3), np.int64)
        self.triangles: Float64 = self.vertices[self.faces]
        self.low, self.high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        self._closed, self._piece, self.probes = _pieces(self.vertices, self.faces)

    @property
    def is_closed(self) -> bool:
        """Whether any piece encloses an inside."""
        return bool(self._closed.any())

    @property
    def is_sheet(self) -> bool:
        """Whether most of the surface belongs to open pieces."""
        return bool(self._closed.sum() < 0.5 * len(self.faces))

    def pieces(self) -> list[Float64]:
        """Return the vertices (N, 3) of each connected piece."""
        order = np.argsort(self._piece, kind="stable")
        cuts = np.flatnonzero(np.diff(self._piece[order])) + 1
        return [self.vertices[np.unique(self.faces[faces])] for faces in np.split(order, cuts)]

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    @cached_property
    def model(self) -> fcl.BVHModel:
        """The mesh as the collision library holds it."""
        return bvh(self.vertices, self.faces)

    @cached_property
    def centre_of_mass(self) -> Float64:
        """Centre of mass (3,) [m]: of the volume where every piece is closed, else of the hull (flat: of the box)."""
        if self._closed.all():
            solid = Trimesh(self.vertices, self.faces, process=False)
            if solid.volume > 0:
                return np.asarray(solid.center_mass)
        try:
            hull = ConvexHull(self.vertices)
        except QhullError:
            return np.asarray((self.low + self.high) / 2)
        inside = self.vertices[hull.vertices].mean(axis=0)
        a, b, c = np.moveaxis(self.vertices[hull.simplices] - inside, 1, 0)
        volume = np.abs((a * np.cross(b, c)).sum(axis=1))
        return np.asarray(inside + (volume[:, None] * (a + b + c)).sum(axis=0) / (4 * volume.sum()))

    def distance(self, points: Float64) -> tuple[Float64, Int64]:
        """Return the distance [m] of points (N, 3) to the surface and the nearest face, (N,) each."""
        squared, face, _ = self._tree.squared_distance(self.vertices, self.faces, np.ascontiguousarray(points))
        return np.sqrt(np.maximum(np.atleast_1d(squared), 0.0)), np.atleast_1d(np.asarray(face, np.int64))

    def nearest(self, point: Float64) -> Float64:
        """Return the point of the surface nearest to a point, (3,) each."""
        _, _, found = self._tree.squared_distance(self.vertices, self.faces, point[None])
        return np.asarray(found, np.float64).reshape(3)

    @cached_property
    def _tracer(self) -> RayMeshIntersector:
        return RayMeshIntersector(Trimesh(self.vertices, self.faces[self._closed], process=False))

    def contains(self, points: Float64) -> Mask:
        """Tell which points (N, 3) lie inside a closed piece, by the winding number about them.

        Rays in two directions count it; where they disagree (an edge, a slit) the solid angle decides.
        """
        if not self.is_closed or not len(points):
            return np.zeros(len(points), bool)
        first, second = (self._winding(points, direction) > 0 for direction in _DIRECTIONS)
        doubtful = first != second
        if doubtful.any():
            faces = np.ascontiguousarray(self.faces[self._closed])
            exact = igl.fast_winding_number(self.vertices, faces, np.ascontiguousarray(points[doubtful]))
            first[doubtful] = np.atleast_1d(exact) > 0.5
        return np.asarray(first)

    def _winding(self, points: Float64, direction: Float64) -> Int64:
        """Count how often a ray from each point leaves a closed piece more than it enters one, (N,)."""
        triangles = self.triangles[self._closed]
        step = 1e-5 * float((self.high - self.low).max())
        count = np.zeros(len(points), np.int64)
        alive, origins = np.arange(len(points)), np.array(points)
        for _ in range(MOST_HITS):
            face = self._tracer.intersects_first(origins, np.broadcast_to(direction, origins.shape))
            hit = face >= 0
            alive, origins, face = alive[hit], origins[hit], face[hit]
            if not len(alive):
                break
            a, normal = triangles[face, 0], triangle_crosses(triangles[face])
            facing = normal @ direction
            count[alive] += np.sign(facing).astype(np.int64)
            ahead = ((a - origins) * normal).sum(axis=1) / np.where(np.abs(facing) > 1e-30, facing, 1e-30)
            origins = origins + np.clip(ahead, 0.0, None)[:, None] * direction + step * direction
        return count


@once_a_mesh
def solid_of(mesh: Mesh) -> Solid:
    """Return a whole mesh as a solid."""
    return Solid(mesh.vertices().astype(np.float64), stacked_faces(mesh))


def bvh(vertices: Float64, faces: Int64) -> fcl.BVHModel:
    """Build the collision library's tree of triangles."""
    model = fcl.BVHModel()
    model.beginModel(len(faces), len(vertices))
    model.addSubModel(vertices, faces)
    model.endModel()
    return model


def _pieces(vertices: Float64, faces: Int64) -> tuple[Mask, NDArray[np.int32], Float64]:
    """Tell which faces belong to closed pieces (F,), the piece of each face (F,), and a vertex of each piece (P, 3).

    A piece counts as closed where its open edges, if any, are short against its size: models have slits.
    """
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    x, y, z = np.round((vertices - vertices.min(axis=0)) / (size * 1e-6)).astype(np.int64).T
    _, weld = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
    welded = weld[faces]
    count = int(welded.max()) + 1
    edges = welded[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    links = coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count))
    pieces, label = connected_components(links, directed=False)
    piece = label[welded[:, 0]]
    _, inverse, uses = np.unique(edges.min(axis=1) * count + edges.max(axis=1), return_inverse=True, return_counts=True)
    open_edge = uses[inverse] == 1
    ends = vertices[faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) * open_edge
    border = np.bincount(np.repeat(piece, 3), length, pieces)
    area = np.bincount(piece, triangle_areas(vertices[faces]), pieces)
    closed = border <= 0.1 * np.sqrt(np.maximum(area, 1e-30))
    _, face = np.unique(piece, return_index=True)
    return closed[piece], piece, vertices[faces[face, 0]]


@dataclass(frozen=True)
class Placed:
    """A solid where it stands: `pose` (4, 4) takes its frame to the world, rotation and translation [m] only."""

    solid: Solid
    pose: Float64

    @cached_property
    def box(self) -> tuple[Float64, Float64]:
        """Lowest and highest corner of the box about it in the world, (3,) each, metres."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def vertices(self) -> Float64:
        """The vertices in the world, (V, 3) [m]."""
        return apply_pose(self.pose, self.solid.vertices)

    @cached_property
    def triangles(self) -> Float64:
        """The triangles in the world, (F, 3, 3) [m]."""
        return self.vertices[self.solid.faces]

    @cached_property
    def _boxes(self) -> tuple[Float64, Float64]:
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)

    def triangles_near(self, low: Float64, high: Float64) -> Float64:
        """Return the triangles in the world whose boxes meet a box, (T, 3, 3) [m]."""
        lowest, highest = self._boxes
        meets = np.ones(len(lowest), bool)
        for axis in range(3):
            meets &= (lowest[:, axis] <= high[axis]) & (highest[:, axis] >= low[axis])
        return self.triangles[meets]

    @property
    def centre_of_mass(self) -> Float64:
        """Centre of mass in the world, (3,) [m]."""
        return np.asarray(self.pose[:3, :3] @ self.solid.centre_of_mass + self.pose[:3, 3])

    @cached_property
    def collider(self) -> fcl.CollisionObject:
        """What the collision library wants to know."""
        return fcl.CollisionObject(self.solid.model, fcl.Transform(self.pose[:3, :3], self.pose[:3, 3]))

    def moved(self, offset: Float64) -> "Placed":
        """Return the same solid shifted by `offset` (3,) [m]."""
        pose = self.pose.copy()
        pose[:3, 3] += offset
        return Placed(self.solid, pose)
