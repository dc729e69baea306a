"""How a model stands as it comes, and where things can stand on it; worked out once a process for each mesh."""

from dataclasses import dataclass

import numpy as np
from trimesh import Trimesh

from multilight.scenes.arrays import Float64
from multilight.scenes.geometry.support_surfaces import convex_polygon, inside_convex, stacked_faces
from multilight.scenes.kinds.rooms.shelves import Shelf, find_shelves
from multilight.scenes.meshes import Mesh

TOUCHES = 0.0008
"""Vertices this close [m] to the lowest one carry a body."""


@dataclass(frozen=True)
class Standing:
    """How a body stands: its lowest height and its height [m], and its outline from above (N, 2) [m]."""

    lowest: float
    height: float
    footprint: Float64


_standing: dict[str, Standing | None] = {}
_shelves: dict[str, list[Shelf]] = {}


def standing_of(mesh: Mesh) -> Standing | None:
    """Tell how a mesh stands as it comes; None where it would fall over.

    Its centre of mass must lie over what touches the ground: that of the solid where it is closed, else that of its
    convex hull, and that of its surface as well.
    """
    key = mesh.sha256()
    if key not in _standing:
        _standing[key] = _stand(mesh)
    return _standing[key]


def hangs(mesh: Mesh) -> bool:
    """Tell whether a mesh can hang on a wall at its back (+Y): what touches there reaches above its middle."""
    vertices = mesh.vertices().astype(np.float64)
    back = vertices[vertices[:, 1] >= vertices[:, 1].max() - TOUCHES]
    solid = Trimesh(vertices, stacked_faces(mesh), process=False)
    middle = max(float(solid.convex_hull.center_mass[2]), float(solid.center_mass[2]) if solid.is_watertight else 0.0)
    return float(back[:, 2].max()) > middle


def shelves_of(mesh: Mesh) -> list[Shelf]:
    """Return where things can stand on a mesh (see `find_shelves`)."""
    key = mesh.sha256()
    if key not in _shelves:
        _shelves[key] = find_shelves(mesh)
    return _shelves[key]


def _stand(mesh: Mesh) -> Standing | None:
    vertices = mesh.vertices().astype(np.float64)
    faces = stacked_faces(mesh)
    lowest = float(vertices[:, 2].min())
    carried = convex_polygon(vertices[vertices[:, 2] <= lowest + TOUCHES, :2])
    footprint = convex_polygon(vertices[:, :2])
    if carried is None or footprint is None:
        return None
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    middle = ((a + b + c) / 3 * area[:, None]).sum(axis=0) / max(float(area.sum()), 1e-12)
    if not inside_convex(carried, middle[:2]):
        return None
    solid = Trimesh(vertices, faces, process=False)
    centres = [solid.convex_hull.center_mass, *([solid.center_mass] if solid.is_watertight else [])]
    if not all(inside_convex(carried, np.asarray(centre)[:2]) for centre in centres):
        return None
    return Standing(lowest, float(vertices[:, 2].max()) - lowest, footprint)
