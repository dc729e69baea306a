"""USD's shapes as triangles."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from pxr import Gf, UsdGeom

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.assets.formats.polygons import triangulated
from multilight.scenes.poses import translation

SHAPES = (
    UsdGeom.Mesh, UsdGeom.Cube, UsdGeom.Sphere, UsdGeom.Cylinder, UsdGeom.Cone, UsdGeom.Capsule, UsdGeom.Plane,
)  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Triangles as corners: point of each corner (T, 3), face each came from (T,), and values by corner.

    `uv` has the coordinates (T, 3, 2) of each primvar; `normals` and linear `colors` are (T, 3, 3), or None.
    """

    points: Float64
    faces: Int64
    source: Int64
    uv: dict[str, Float64]
    normals: Float64 | None
    colors: Float64 | None = None


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
    triangles, source = triangulated(points, counts, corners)
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    uv, primvars = {}, UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithValues()
    for primvar in primvars:
        if primvar.GetTypeName().scalarType.type.pythonClass in (Gf.Vec2f, Gf.Vec2d, Gf.Vec2h):
            values = _values(primvar, corners, triangles, 2)
            if values is not None:
                uv[primvar.GetPrimvarName()] = values
    normals = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if normals.HasValue():
        shading = _values(normals, corners, triangles, 3)
    else:
        plain = np.array(mesh.GetNormalsAttr().Get() or [], np.float64).reshape(-1, 3)
        shading = _at_corners(plain, str(mesh.GetNormalsInterpolation()), corners, triangles)
    shown = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor")
    colors = _values(shown, corners, triangles, 3)
    if colors is None and shown and str(shown.GetInterpolation()) == "uniform":
        colors = np.repeat(np.array(shown.ComputeFlattened(), np.float64)[source][:, None], 3, axis=1)
    return Shape(points, corners[triangles], source, uv, shading, colors)


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
    """Make triangles of a shape that is no mesh."""
    if prim.IsA(UsdGeom.Cube):
        side = float(UsdGeom.Cube(prim).GetSizeAttr().Get())
        made = trimesh.creation.box((side, side, side))
    elif prim.IsA(UsdGeom.Sphere):
        made = trimesh.creation.icosphere(subdivisions=4, radius=float(UsdGeom.Sphere(prim).GetRadiusAttr().Get()))
    elif prim.IsA(UsdGeom.Plane):
        sheet = UsdGeom.Plane(prim)
        half = np.array([float(sheet.GetWidthAttr().Get()), float(sheet.GetLengthAttr().Get())]) / 2
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * (*half, 0.0)
        made = _turned(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False), sheet.GetAxisAttr().Get())
    else:
        rod = next(kind(prim) for kind in _RODS if prim.IsA(kind))
        radius, height = float(rod.GetRadiusAttr().Get()), float(rod.GetHeightAttr().Get())
        made = _turned(_RODS[type(rod)](radius, height), rod.GetAxisAttr().Get())
    faces = np.asarray(made.faces, np.int64)
    return Shape(np.asarray(made.vertices, np.float64), faces, np.zeros(len(faces), np.int64), {}, None)


_RODS: dict[Any, Any] = {
    UsdGeom.Cylinder: lambda radius, height: trimesh.creation.cylinder(radius, height, sections=64),
    UsdGeom.Cone: lambda radius, height: trimesh.creation.cone(
        radius, height, sections=64, transform=translation([0, 0, -height / 2])
    ),
    UsdGeom.Capsule: lambda radius, height: trimesh.creation.capsule(
        height, radius, count=[64, 64], transform=translation([0, 0, -height / 2])
    ),
}


def _turned(made: Any, axis: str) -> Any:
    """Turn what stands along Z along another axis."""
    directions = {"X": ([0, 0, 1], [1, 0, 0]), "Y": ([0, 0, 1], [0, 1, 0])}
    if axis in directions:
        made.apply_transform(trimesh.geometry.align_vectors(*directions[axis]))
    return made
