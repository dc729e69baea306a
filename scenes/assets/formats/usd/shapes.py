"""USD's shapes as triangles."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from pxr import UsdGeom

from multilight.scenes.arrays import Float64, Int64

SHAPES = (UsdGeom.Mesh, UsdGeom.Cube, UsdGeom.Sphere, UsdGeom.Cylinder)


@dataclass(frozen=True)
class Shape:
    """Triangles as corners: point of each corner (T, 3), face each came from (T,), and values by corner, or None."""

    points: Float64
    faces: Int64
    source: Int64
    uv: Float64 | None
    normals: Float64 | None


def read_shape(prim: Any) -> Shape | None:
    """Read a prim's triangles; None where it has none."""
    if not prim.IsA(UsdGeom.Mesh):
        return _solid(prim)
    mesh = UsdGeom.Mesh(prim)
    points = np.array(mesh.GetPointsAttr().Get() or [], np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
    if not len(points) or not len(counts) or counts.sum() != len(corners) or not len(corners):
        return None
    if counts.min() < 0 or corners.min() < 0 or corners.max() >= len(points):
        return None
    start = np.cumsum(counts) - counts
    fans = np.maximum(counts - 2, 0)
    source = np.repeat(np.arange(len(counts)), fans)
    step = np.arange(len(source)) - np.repeat(np.cumsum(fans) - fans, fans)
    triangles = start[source][:, None] + np.stack([np.zeros_like(step), step + 1, step + 2], axis=1)
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    uv = _values(UsdGeom.PrimvarsAPI(prim).GetPrimvar("st"), corners, triangles, 2)
    normals = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if normals.HasValue():
        shading = _values(normals, corners, triangles, 3)
    else:
        plain = np.array(mesh.GetNormalsAttr().Get() or [], np.float64).reshape(-1, 3)
        shading = _at_corners(plain, str(mesh.GetNormalsInterpolation()), corners, triangles)
    return Shape(points, corners[triangles], source, uv, shading)


def _values(primvar: Any, corners: Int64, triangles: Int64, width: int) -> Float64 | None:
    """Return a primvar at each corner of each triangle, (T, 3, width); None where it varies otherwise."""
    if not primvar or not primvar.HasValue():
        return None
    values = np.array(primvar.ComputeFlattened(), np.float64).reshape(-1, width)
    return _at_corners(values, str(primvar.GetInterpolation()), corners, triangles)


def _at_corners(values: Float64, interpolation: str, corners: Int64, triangles: Int64) -> Float64 | None:
    match interpolation:
        case "faceVarying" if len(values) == len(corners):
            return np.asarray(values[triangles])
        case "vertex" | "varying" if len(values) > corners.max():
            return np.asarray(values[corners[triangles]])
        case _:
            return None


def _solid(prim: Any) -> Shape:
    """Make triangles of a cube, a sphere or a cylinder."""
    if prim.IsA(UsdGeom.Cube):
        side = float(UsdGeom.Cube(prim).GetSizeAttr().Get())
        made = trimesh.creation.box((side, side, side))
    elif prim.IsA(UsdGeom.Sphere):
        made = trimesh.creation.icosphere(subdivisions=4, radius=float(UsdGeom.Sphere(prim).GetRadiusAttr().Get()))
    else:
        rod = UsdGeom.Cylinder(prim)
        made = trimesh.creation.cylinder(rod.GetRadiusAttr().Get(), rod.GetHeightAttr().Get(), sections=64)
        directions = {"X": ([0, 0, 1], [1, 0, 0]), "Y": ([0, 0, 1], [0, 1, 0])}
        if rod.GetAxisAttr().Get() in directions:
            made.apply_transform(trimesh.geometry.align_vectors(*directions[rod.GetAxisAttr().Get()]))
    faces = np.asarray(made.faces, np.int64)
    return Shape(np.asarray(made.vertices, np.float64), faces, np.zeros(len(faces), np.int64), None, None)
