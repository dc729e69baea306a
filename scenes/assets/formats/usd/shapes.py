"""USD's shapes as triangles."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from pxr import Gf, UsdGeom

from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.assets.formats.polygons import triangulated
from multilight.scenes.assets.formats.usd.materials import NOW
from multilight.scenes.poses import translation

SHAPES = (
    UsdGeom.Mesh, UsdGeom.Cube, UsdGeom.Sphere, UsdGeom.Cylinder, UsdGeom.Cone, UsdGeom.Capsule, UsdGeom.Plane,
)  # fmt: skip


@dataclass(frozen=True)
class Shape:
    """Triangles as corners: point of each corner (T, 3), face each came from (T,), and values by corner.

    `uv` has the coordinates (T, 3, 2) of each primvar, `colors` those (T, 3, 3) that are linear colours; `normals` are
    (T, 3, 3), or None.
    """

    points: Float64
    faces: Int64
    source: Int64
    uv: dict[str, Float64]
    normals: Float64 | None
    colors: dict[str, Float64] = field(default_factory=dict)


def read_shape(prim: Any) -> Shape | None:
    """Read a prim's triangles; None where it has none."""
    if not prim.IsA(UsdGeom.Mesh):
        return _solid(prim)
    mesh = UsdGeom.Mesh(prim)
    points = np.array(mesh.GetPointsAttr().Get(NOW) or [], np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(NOW) or [], np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(NOW) or [], np.int64)
    if not len(points) or not len(counts) or counts.sum() != len(corners) or not len(corners):
        return None
    if counts.min() < 0 or corners.min() < 0 or corners.max() >= len(points):
        return None
    triangles, source = triangulated(points, counts, corners)
    if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        triangles = triangles[:, ::-1]
    uv, colors = dict[str, Float64](), dict[str, Float64]()
    for primvar in UsdGeom.PrimvarsAPI(prim).FindPrimvarsWithInheritance():
        kind = primvar.GetTypeName()
        for made, width, wanted in (
            (uv, 2, kind.scalarType.type.pythonClass in (Gf.Vec2f, Gf.Vec2d, Gf.Vec2h)),
            (colors, 3, kind.role == "Color"),
        ):
            values = _values(primvar, corners, triangles, source) if wanted else None
            if values is not None:
                made[primvar.GetPrimvarName()] = values[..., :width]
    normals = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if normals.HasValue():
        shading = _values(normals, corners, triangles, source)
    else:
        plain = np.array(mesh.GetNormalsAttr().Get(NOW) or [], np.float64).reshape(-1, 3)
        shading = _at_corners(plain, str(mesh.GetNormalsInterpolation()), corners, triangles, source)
    return Shape(points, corners[triangles], source, uv, shading, colors)


def _values(primvar: Any, corners: Int64, triangles: Int64, source: Int64) -> Float64 | None:
    """Return a primvar at each corner of each triangle, (T, 3, ...); None where its length is another's."""
    found = primvar.ComputeFlattened(NOW) if primvar else None
    values = np.array([] if found is None else found, np.float64)
    return _at_corners(values, str(primvar.GetInterpolation()), corners, triangles, source)


def _at_corners(values: Float64, interpolation: str, corners: Int64, triangles: Int64, source: Int64) -> Float64 | None:
    match interpolation:
        case "faceVarying" if len(values) == len(corners):
            return np.asarray(values[triangles])
        case "vertex" | "varying" if len(values) > corners.max():
            return np.asarray(values[corners[triangles]])
        case "uniform" if len(values) > source.max():
            return np.repeat(values[source][:, None], 3, axis=1)
        case "constant" if len(values) == 1:
            return np.broadcast_to(values, (*triangles.shape, values.shape[1]))
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
    shape, shown = _plain(made), UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
    if shown.HasValue():
        colour = np.array(shown.ComputeFlattened(NOW), np.float64)[0]
        shape.colors["displayColor"] = np.broadcast_to(colour, (len(shape.faces), 3, 3))
    return shape


def tube(length: float, radius: float) -> Shape:
    """Make the round side of a cylinder along X."""
    made = trimesh.creation.cylinder(radius, length, sections=32)
    made.update_faces(np.abs(made.face_normals[:, 2]) < 0.5)
    return _plain(_turned(made, "X"))


def _plain(made: Any) -> Shape:
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
