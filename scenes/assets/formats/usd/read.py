"""A USD stage as nodes of triangles and lights."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Ar, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdShade, UsdSkel, UsdUtils

from multilight.scenes.arrays import Float64, Int64, Mask
from multilight.scenes.assets.environments import keep_map
from multilight.scenes.assets.formats.cleaning import Z_UP_FROM_Y_UP, RawPart, tinted
from multilight.scenes.assets.formats.coordinates import Place, laid
from multilight.scenes.assets.formats.imported import Imported, KeepImage, Node, Note
from multilight.scenes.assets.formats.precheck import check_triangles
from multilight.scenes.assets.formats.usd.lights import KINDS, LightReader, read_map, tube_of, upright
from multilight.scenes.assets.formats.usd.materials import (
    NOW,
    Picture,
    Surface,
    bound_surface,
    package_of,
    read_material,
    rgb_of,
    title_of,
)
from multilight.scenes.assets.formats.usd.shapes import SHAPES, Shape, read_shape, tube
from multilight.scenes.assets.info import AssetError, unreadable
from multilight.scenes.files.confined import OutsideError, held
from multilight.scenes.files.limits import MOST_NODES, LimitError, check_file
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import apply_pose, pose_of
from multilight.scenes.spec import Material, Texture


def open_stage(path: Path) -> Any:
    """Open a USD file; raises `AssetError` in one line with the file, what is wrong and the remedy."""
    try:
        check_file(path)
        _check_layers(path)
        stage = Usd.Stage.Open(str(path))
        for error in stage.GetCompositionErrors():
            said = str(error).replace(f"{path.parent}/", "").replace("@", "'")
            raise AssetError(f"{path} cannot be composed: {said}; put what is missing there, or flatten the stage")
        return stage
    except (OSError, LimitError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise AssetError(f"{path} cannot be read: {reason}") from error
    except OutsideError as error:
        raise AssetError(
            f"{path} refers to a layer outside of its folder: {error}; flatten it, or pack it as USDZ"
        ) from None
    except Tf.ErrorException as error:
        raise unreadable(path, error) from error


def _check_layers(path: Path) -> None:
    """Raise `OutsideError` where a stage is composed of a layer outside of its folder, before that is opened."""
    waiting, seen = [str(path)], set[str]()
    while waiting:
        name = waiting.pop()
        held(path.parent, Path(package_of(name)))
        layer = None if name in seen else Sdf.Layer.FindOrOpen(name)
        seen.add(name)
        if layer is None:
            continue  # what is missing is told where the stage is composed
        for asset in filter(None, layer.GetCompositionAssetDependencies()):  # of the stage itself: without a name
            if asset.startswith("`"):
                raise OutsideError(f"{asset} is worked out only while reading")
            resolved = Ar.GetResolver().Resolve(Sdf.ComputeAssetPathRelativeToLayer(layer, asset))
            waiting.append(str(resolved) or str(path))


def world_from_stage(stage: Any) -> Float64:
    """Return what takes a stage's axes and units to metres, Z-up: (4, 4)."""
    up = Z_UP_FROM_Y_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(3)
    return pose_of(up * float(UsdGeom.GetStageMetersPerUnit(stage)), np.zeros(3))


def read_usd(path: Path, keep: KeepImage, folder: Path) -> tuple[Imported, list[Path]]:
    """Read a USD file, and return the files that it refers to as well; maps of domes go into `folder` as EXR.

    Raises `AssetError` in one line with the file, what is wrong and the remedy.
    """
    try:
        found = _Reader(path, open_stage(path), keep, folder).read()
        layers, assets, _ = UsdUtils.ComputeAllDependencies(str(path))
        files = {Path(package_of(name)) for name in (*(layer.realPath for layer in layers), *map(str, assets)) if name}
        return found, sorted(files - {path})
    except AssetError:
        raise
    except LimitError as error:
        raise AssetError(f"{path}: {error}") from error
    except Exception as error:  # whatever a broken stage makes the above stumble over
        raise unreadable(path, error) from error


class _Reader:
    """Reads one stage."""

    def __init__(self, path: Path, stage: Any, keep: KeepImage, folder: Path) -> None:
        self._path, self._stage, self._keep, self._folder = path, stage, keep, folder
        self._world = world_from_stage(stage)
        self._places = UsdGeom.XformCache(NOW)
        self._lights = LightReader(path, self._keep_map, self._note)
        self._triangles = 0
        self._notes: list[Note] = []

    def read(self) -> Imported:
        nodes: list[Node | None] = []
        lights = []
        prims = iter(Usd.PrimRange(self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
        for number, prim in enumerate(prims):
            if number > MOST_NODES:
                raise LimitError(f"it has more than {MOST_NODES} prims, each instance counted; join some")
            if not prim.IsA(UsdGeom.Imageable) or not _is_shown(prim):
                continue
            if prim.IsA(UsdGeom.PointInstancer):
                nodes += self._instances(UsdGeom.PointInstancer(prim))
                prims.PruneChildren()
            elif any(prim.IsA(shape) for shape in SHAPES):
                nodes.append(self._node(prim, self._matrix(prim), read_shape(prim)))
            elif prim.IsA(UsdLux.CylinderLight):
                self._note(prim.GetPath(), "a CylinderLight", "it is a glowing tube that is seen", "none")
                nodes.append(self._node(prim, self._matrix(prim), tube(*tube_of(prim))))
            elif any(prim.IsA(kind) for kind in KINDS):
                lights.append(self._lights.read(prim, self._matrix(prim)))
            elif prim.IsA(UsdGeom.Gprim) or prim.HasAPI(UsdLux.LightAPI):
                self._note(prim.GetPath(), f"a {prim.GetTypeName()}", "it is left out", "make it a mesh")
        made = sorted((node for node in nodes if node is not None), key=lambda node: node.name)
        lights.sort(key=lambda light: light.name)
        return Imported(tuple(made), tuple(lights), tuple(self._notes))

    def _note(self, place: Any, feature: str, instead: str, remedy: str) -> None:
        self._notes.append(Note(place=str(place), feature=feature, instead=instead, remedy=remedy))

    def _instances(self, instancer: Any) -> Iterator[Node | None]:
        """Place what a point instancer repeats."""
        base, numbers = self._matrix(instancer.GetPrim()), instancer.GetProtoIndicesAttr().Get(NOW) or []
        placed = instancer.ComputeInstanceTransformsAtTime(NOW, NOW) or []
        prototypes = [self._stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetTargets()]
        for number, pose in zip(numbers, placed, strict=False):
            root = prototypes[number]
            to_root = np.linalg.inv(np.array(self._places.GetLocalToWorldTransform(root)).T)
            for prim in Usd.PrimRange(root, Usd.TraverseInstanceProxies()):
                if any(prim.IsA(shape) for shape in SHAPES):
                    local = to_root @ np.array(self._places.GetLocalToWorldTransform(prim)).T
                    yield self._node(prim, base @ np.array(pose).T @ local, read_shape(prim))

    def _matrix(self, prim: Any) -> Float64:
        """Return a prim's matrix (4, 4) to our world; USD's own act on rows."""
        return np.asarray(self._world @ np.array(self._places.GetLocalToWorldTransform(prim)).T)

    def _node(self, prim: Any, matrix: Float64, shape: Shape | None) -> Node | None:
        """Place a prim's shape by `matrix`, one part for each material on it."""
        if shape is None:
            self._note(
                prim.GetPath(), "it holds no triangles, or numbers that contradict", "it is left out", "repair it"
            )
            return None
        self._name_what_is_left(prim)
        self._triangles += len(shape.faces)
        check_triangles(self._triangles)
        if abs(np.linalg.det(matrix[:3, :3])) < 1e-18:
            return None
        points = apply_pose(matrix, shape.points)
        normals = None if shape.normals is None else shape.normals @ np.linalg.inv(matrix[:3, :3])
        order = [2, 1, 0] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]
        parts, emissions = [], []
        glow = self._lights.glow(prim, matrix) if prim.HasAPI(UsdLux.LightAPI) else None
        for chosen, shader in _bindings(prim, shape.source):
            surface = self._material(shader, prim, shape)
            given = shape.uv.get(surface.place.layer, next(iter(shape.uv.values()), None))
            material, colors = surface.material, shape.colors.get(surface.colors or "")
            if shader is not None and surface.colors is None and shape.colors.keys() - {"displayColor"}:
                what = f"vertex colours {', '.join(sorted(shape.colors))}, which its material does not name"
                self._note(prim.GetPath(), what, "they are left out", "bake them into a picture")
            if colors is not None:
                material, colors = tinted(material, colors[chosen][:, order].reshape(-1, 3))
            corners = points[shape.faces[chosen][:, order]].reshape(-1, 3)
            shading = None if normals is None else normals[chosen][:, order].reshape(-1, 3)
            uv = None if given is None else laid(given[chosen][:, order].reshape(-1, 2), surface.place.affine)
            faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
            parts.append(RawPart(material, corners, faces, shading, uv, colors))
            emissions.append(glow or surface.emission)
        return Node(title_of(prim), tuple(parts), tuple(emissions))

    def _name_what_is_left(self, prim: Any) -> None:
        if prim.HasAPI(UsdSkel.BindingAPI):
            self._note(prim.GetPath(), "a skin", "it stands as it was bound", "bake the pose")
        scheme = UsdGeom.Mesh(prim).GetSubdivisionSchemeAttr() if prim.IsA(UsdGeom.Mesh) else None
        if scheme is not None and scheme.HasAuthoredValue() and scheme.Get() != UsdGeom.Tokens.none:
            self._note(prim.GetPath(), "a subdivision surface", "its cage is shown", "subdivide it before exporting")

    def _material(self, shader: Any, prim: Any, shape: Shape) -> Surface:
        """Translate a surface; without one, the shape's display colour."""
        if shader is not None:
            return read_material(self._path, shader, self._kept, has_uv=bool(shape.uv), tell=self._note)
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        if bound:
            remedy = "give it a UsdPreviewSurface"
            self._note(bound.GetPath(), "its shader is none that is read", "a plain surface is shown", remedy)
        plain = Material(base_color=(1.0, 1.0, 1.0) if "displayColor" in shape.colors else (0.18, 0.18, 0.18))
        return Surface(plain, None, Place(), "displayColor")

    def _kept(self, picture: Picture, mode: str) -> Texture:
        return self._keep(picture.image.convert(mode))

    def _keep_map(self, file: Any, prim: Any, axes: Float64 | None) -> tuple[str | None, Rgb]:
        image = read_map(self._path, file, prim.GetPath())
        image = image if axes is None else upright(image, axes)
        if float(np.ptp(image, axis=(0, 1)).max()) == 0:
            return None, rgb_of(image[0, 0])
        return keep_map(image, f"{self._path}: its sky {file.path!r}", self._folder), (1.0, 1.0, 1.0)


def _bindings(prim: Any, source: Int64) -> Iterator[tuple[Mask, Any]]:
    """Yield for each material of a shape which triangles have it, and its surface shader (None: none given)."""
    rest = np.ones(len(source), bool)
    for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
        chosen = np.isin(source, np.array(subset.GetIndicesAttr().Get() or [], np.int64)) & rest
        rest &= ~chosen
        if chosen.any():
            yield chosen, bound_surface(subset.GetPrim())
    if rest.any():
        yield rest, bound_surface(prim)


def _is_shown(prim: Any) -> bool:
    imageable = UsdGeom.Imageable(prim)
    shown = imageable.ComputeVisibility(NOW) != UsdGeom.Tokens.invisible
    return shown and imageable.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
