"""How a model stands as it comes, whether it hangs, and where things can stand on it."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from trimesh import Trimesh

from multilight.scenes.arrays import Float64
from multilight.scenes.geometry.support_surfaces import convex_hull, convex_polygon, stacked_faces, stands
from multilight.scenes.kinds.rooms.shelves import Shelf, find_shelves
from multilight.scenes.meshes import Mesh, once_a_mesh, triangle_areas

TOUCHES = 0.0008
"""Vertices this close [m] to the lowest one carry a body."""


@dataclass(frozen=True)
class Footing:
    """How a body stands: its lowest height and its height [m], and its outline from above (N, 2) [m]."""

    lowest: float
    height: float
    footprint: Float64


@once_a_mesh
def footing_of(mesh: Mesh) -> Footing | None:
    """Tell how a mesh stands as it comes; None where it would fall over.

    Its centre of mass must lie over what touches the ground: that of the solid where it is closed, else that of its
    convex hull, and that of its surface as well.
    """
    vertices = mesh.vertices().astype(np.float64)
    footprint = convex_polygon(vertices[:, :2])
    if footprint is None or not stands(vertices, _centres(vertices, mesh), contact=TOUCHES):
        return None
    lowest = float(vertices[:, 2].min())
    return Footing(lowest, float(vertices[:, 2].max()) - lowest, footprint)


@once_a_mesh
def shelves_of(mesh: Mesh) -> list[Shelf]:
    """Return where things can stand on a mesh (see `find_shelves`)."""
    return find_shelves(mesh)


@once_a_mesh
def hangs(mesh: Mesh) -> bool:
    """Tell whether a mesh can hang on a wall at its back (+Y): what touches there reaches above its centres of mass."""
    vertices = mesh.vertices().astype(np.float64)
    back = vertices[vertices[:, 1] >= vertices[:, 1].max() - TOUCHES]
    _, *centres = _centres(vertices, mesh)
    return float(back[:, 2].max()) > max(float(centre[2]) for centre in centres)


def _centres(vertices: Float64, mesh: Mesh) -> Iterator[Float64]:
    """Yield centres of mass (3,): of the surface, of the convex hull, and of the solid where it is closed."""
    faces = stacked_faces(mesh)
    triangles = vertices[faces]
    area = triangle_areas(triangles)
    yield (triangles.mean(axis=1) * area[:, None]).sum(axis=0) / max(float(area.sum()), 1e-12)
    solid = Trimesh(vertices, faces, process=False)
    yield np.asarray(convex_hull(mesh).center_mass)
    if solid.is_watertight:
        yield np.asarray(solid.center_mass)
