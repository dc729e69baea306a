"""Bodies as USD meshes, one material subset a part."""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from pxr import Gf, Sdf, UsdGeom, UsdShade, Vt

from multilight.datagen.storage.records import AssetCredit
from multilight.datagen.usd.layout import set_own
from multilight.datagen.usd.materials import Materials
from multilight.lights.spec import EmissiveLight
from multilight.scenes.arrays import Float32, Int64
from multilight.scenes.meshes import MeshPart
from multilight.scenes.spec import Body, MeshAsset, Rectangle, Sphere

_TYPES = Sdf.ValueTypeNames


def add_body(
    stage: Any,
    path: str,
    body: Body,
    parts: Sequence[MeshPart],
    *,
    materials: Materials,
    glows: dict[int, EmissiveLight],
) -> dict[int, str]:
    """Write a body; return the path of each of its parts: a subset's, or the mesh's own where there is only one."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=False)])
    points = np.concatenate([part.vertices for part in parts])
    mesh.CreatePointsAttr(_vectors(Vt.Vec3fArray, points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.ascontiguousarray(faces, np.int32).ravel()))
    mesh.CreateNormalsAttr(_vectors(Vt.Vec3fArray, np.concatenate([part.normals for part in parts])))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", _TYPES.TexCoord2fArray, UsdGeom.Tokens.vertex)
    st.Set(_vectors(Vt.Vec2fArray, np.concatenate([part.uv for part in parts])))
    mesh.CreateExtentAttr(_vectors(Vt.Vec3fArray, np.stack([points.min(axis=0), points.max(axis=0)])))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.AddTransformOp().Set(Gf.Matrix4d(*np.array(body.world_from_body).T.ravel().tolist()))
    _describe(mesh.GetPrim(), body)
    counts = np.cumsum([0, *(len(part.faces) for part in parts)])
    places = _bind(mesh, body, counts, materials, glows)
    set_own(mesh.GetPrim(), "geometry", _TYPES.String, geometry_digest(mesh))
    return places


def _bind(
    mesh: Any, body: Body, counts: Int64, materials: Materials, glows: dict[int, EmissiveLight]
) -> dict[int, str]:
    shaders = [materials.get(material, glows.get(part)) for part, material in enumerate(body.materials)]
    if len(shaders) == 1:
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(shaders[0])
        return {0: str(mesh.GetPath())}
    places = {}
    api = UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim())
    for part, shader in enumerate(shaders):
        indices = Vt.IntArray.FromNumpy(np.arange(counts[part], counts[part + 1], dtype=np.int32))
        subset = api.CreateMaterialBindSubset(f"part_{part:03d}", indices)
        UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(shader)
        places[part] = str(subset.GetPath())
    api.SetMaterialBindSubsetsFamilyType(UsdGeom.Tokens.partition)
    return places


def _describe(prim: Any, body: Body) -> None:
    """Write what USD has no word for: the body's part in the scene, and what its triangles stand for."""
    set_own(prim, "role", _TYPES.Token, body.role)
    set_own(prim, "category", _TYPES.String, body.category)
    set_own(prim, "insertable", _TYPES.Bool, body.insertable)
    set_own(prim, "shape", _TYPES.Token, body.geometry.shape)
    match body.geometry:
        case Sphere() as shape:
            set_own(prim, "radius", _TYPES.Double, shape.radius)
        case Rectangle() as shape:
            set_own(prim, "size", _TYPES.Double2, Gf.Vec2d(shape.width, shape.height))
        case MeshAsset() as shape:
            set_own(prim, "asset", _TYPES.String, shape.asset)
            set_own(prim, "meshSha256", _TYPES.String, shape.mesh_sha256)


def credit(prim: Any, asset: AssetCredit) -> None:
    """Write an asset's creator and licence into the prim that shows it."""
    prim.SetAssetInfo({"identifier": asset.id, "name": asset.name, "creator": asset.creator, "licence": asset.licence})


def geometry_digest(mesh: Any) -> str:
    """Hash a mesh's arrays and subsets as the stage holds them (64 hex digits)."""
    digest = hashlib.sha256()
    attributes = [
        mesh.GetPointsAttr(),
        mesh.GetFaceVertexCountsAttr(),
        mesh.GetFaceVertexIndicesAttr(),
        mesh.GetNormalsAttr(),
        UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st"),
    ]
    attributes += [subset.GetIndicesAttr() for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()]
    for attribute in attributes:
        value = attribute.Get()
        digest.update(b"-" if value is None else np.ascontiguousarray(np.array(value)).tobytes())
    return digest.hexdigest()


def _vectors(kind: Any, values: Float32) -> Any:
    return kind.FromNumpy(np.ascontiguousarray(values, np.float32))
