"""USD scenes: meshes, UsdPreviewSurface materials and UsdLux lights; the only room for `pxr`.

Read are Mesh, Cube, Sphere and Cylinder prims as posed at the default time, instances included; curves, points and
point instancers are not. UsdLux: intensity times two to the exposure is a luminance [cd/m²] (OpenUSD, Overview of
UsdLux, "Quantities and units"); where `normalize` is set it is divided by the light's area in m² (a distant light's:
pi sin²(angle / 2)).
"""

import io
import math
import shutil
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import trimesh
from numpy.typing import NDArray
from PIL import Image
from pxr import Tf, Usd, UsdGeom, UsdLux, UsdShade

from scenes.assets.cleaning import Z_UP_FROM_Y_UP, RawPart
from scenes.assets.finishes import part_name
from scenes.assets.gltf import EMISSION_NITS
from scenes.assets.imported import Emission, FoundLight, Imported, KeepImage, Node
from scenes.assets.info import AssetError
from scenes.cameras import matrix4
from scenes.frozen import Rgb
from scenes.spec import Material, Texture

_SHAPES = (UsdGeom.Mesh, UsdGeom.Cube, UsdGeom.Sphere, UsdGeom.Cylinder)

Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


def read_usd(path: Path, keep: KeepImage, folder: Path) -> Imported:
    """Read a USD file; dome textures go into `folder` as EXR.

    Raises `AssetError` in one line with the file, what is wrong and the remedy.
    """
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise AssetError(f"{path} is not a readable USD file ({reason}); export it again") from error
    return _Reader(path, stage, keep, folder).read()


class _Reader:
    """Reads one stage; `world` (4, 4) takes its axes and units to metres, Z-up."""

    def __init__(self, path: Path, stage: Any, keep: KeepImage, folder: Path) -> None:
        self._path, self._stage, self._keep, self._folder = path, stage, keep, folder
        unit = float(UsdGeom.GetStageMetersPerUnit(stage))
        up = Z_UP_FROM_Y_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y else np.eye(3)
        self._world = np.eye(4)
        self._world[:3, :3] = up * unit
        self._places = UsdGeom.XformCache()

    def read(self) -> Imported:
        nodes, lights = [], []
        for prim in Usd.PrimRange(self._stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Imageable) or not _is_shown(prim):
                continue
            if any(prim.IsA(shape) for shape in _SHAPES):
                nodes.append(self._node(prim))
            elif prim.HasAPI(UsdLux.LightAPI):
                lights.append(self._light(prim))
        return Imported(tuple(node for node in nodes if node is not None), tuple(lights))

    def _matrix(self, prim: Any) -> Float64:
        """Return a prim's matrix (4, 4) to our world; USD's own act on rows."""
        return np.asarray(self._world @ np.array(self._places.GetLocalToWorldTransform(prim)).T)

    def _node(self, prim: Any) -> Node | None:
        """Read a shape, one part for each material on it."""
        shape = _shape(prim)
        if shape is None:
            return None
        matrix = self._matrix(prim)
        if abs(np.linalg.det(matrix[:3, :3])) < 1e-18:
            return None
        points = shape.points @ matrix[:3, :3].T + matrix[:3, 3]
        normals = None if shape.normals is None else shape.normals @ np.linalg.inv(matrix[:3, :3])
        order = [2, 1, 0] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]
        parts, emissions = [], []
        for chosen, shader in self._bindings(prim, shape.source):
            material, emission = self._material(shader, prim, has_uv=shape.uv is not None)
            corners = points[shape.faces[chosen][:, order]].reshape(-1, 3)
            shading = None if normals is None else normals[chosen][:, order].reshape(-1, 3)
            uv = None if shape.uv is None else shape.uv[chosen][:, order].reshape(-1, 2)
            faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
            parts.append(RawPart(material, corners, faces, shading, uv))
            emissions.append(emission)
        return Node(prim.GetName(), tuple(parts), tuple(emissions))

    def _bindings(self, prim: Any, source: Int64) -> Iterator[tuple[NDArray[np.bool_], Any]]:
        """Yield for each material of a shape which triangles have it, and its surface shader (None: none given)."""
        rest = np.ones(len(source), bool)
        for subset in UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets():
            chosen = np.isin(source, np.array(subset.GetIndicesAttr().Get() or [], np.int64)) & rest
            rest &= ~chosen
            if chosen.any():
                yield chosen, _surface(subset.GetPrim())
        if rest.any():
            yield rest, _surface(prim)

    def _material(self, shader: Any, prim: Any, *, has_uv: bool) -> tuple[Material, Emission | None]:
        """Translate a UsdPreviewSurface; without one, the shape's display colour."""
        if shader is None:
            colour = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get()
            return Material(base_color=_rgb(colour[0]) if colour else (0.18, 0.18, 0.18)), None
        value, texture = _inputs(shader), {}
        for name in ("diffuseColor", "roughness", "normal", "emissiveColor", "metallic"):
            if has_uv and (found := self._texture(shader, name)) is not None:
                texture[name] = found
        metallic = float(value("metallic", 0.0))
        if "metallic" in texture:
            metallic = float(np.round(np.asarray(texture["metallic"][0].convert("L")).mean() / 255))
        opacity = float(np.clip(value("opacity", 1.0), 0.0, 1.0))
        white = (1.0, 1.0, 1.0)
        material = Material(
            name=part_name(shader.GetPrim().GetParent().GetName()),
            base_color=white if "diffuseColor" in texture else _rgb(value("diffuseColor", (0.18, 0.18, 0.18))),
            base_color_texture=self._kept(texture.get("diffuseColor"), "RGB"),
            roughness=1.0 if "roughness" in texture else float(np.clip(value("roughness", 0.5), 0, 1)),
            roughness_texture=self._kept(texture.get("roughness"), "L"),
            metallic=float(np.clip(metallic, 0, 1)),
            ior=float(np.clip(value("ior", 1.5), 1.0, 3.0)),
            coat=float(np.clip(value("clearcoat", 0.0), 0, 1)),
            coat_roughness=float(np.clip(value("clearcoatRoughness", 0.01), 0, 1)),
            opacity=opacity,
            normal_texture=self._kept(texture.get("normal"), "RGB"),
        )
        glow = white if "emissiveColor" in texture else _rgb(value("emissiveColor", (0.0, 0.0, 0.0)))
        if max(glow) == 0:
            return material, None
        amount = (glow[0] * EMISSION_NITS, glow[1] * EMISSION_NITS, glow[2] * EMISSION_NITS)
        return material, Emission(amount, "nit", self._kept(texture.get("emissiveColor"), "RGB"))

    def _kept(self, found: tuple[Image.Image, tuple[float, float]] | None, mode: str) -> Texture | None:
        if found is None:
            return None
        return self._keep(found[0].convert(mode)).model_copy(update={"repeat": found[1]})

    def _texture(self, shader: Any, name: str) -> tuple[Image.Image, tuple[float, float]] | None:
        """Open the picture that feeds an input: the channel asked for, and how often it repeats."""
        given = shader.GetInput(name)
        source: Any = given.GetConnectedSource() if given else None
        node = UsdShade.Shader(source[0].GetPrim()) if source else None
        if not node or node.GetIdAttr().Get() != "UsdUVTexture":
            return None
        file = node.GetInput("file").Get() if node.GetInput("file") else None
        picture = self._picture(file, node.GetPath())
        if source[1] in ("r", "g", "b") and picture.mode in ("RGB", "RGBA"):
            picture = picture.getchannel(source[1].upper())
        repeat = (1.0, 1.0)
        feed = node.GetInput("st").GetConnectedSource() if node.GetInput("st") else None
        placed = UsdShade.Shader(feed[0].GetPrim()) if feed else None
        if placed and placed.GetIdAttr().Get() == "UsdTransform2d" and placed.GetInput("scale"):
            x, y = placed.GetInput("scale").Get() or (1.0, 1.0)
            repeat = (max(abs(float(x)), 1e-6), max(abs(float(y)), 1e-6))
        return picture, repeat

    def _picture(self, file: Any, where: Any) -> Image.Image:
        resolved = file.resolvedPath if file is not None else ""
        if not resolved:
            named = file.path if file is not None else "nothing"
            raise AssetError(f"{self._path}: {where} names the texture {named!r}, which is missing; put it there")
        try:
            if "[" in resolved:  # inside a .usdz
                return Image.open(_from_package(resolved)).copy()
            with Image.open(resolved) as picture:
                return picture.copy()
        except (OSError, SyntaxError, ValueError) as error:
            raise AssetError(f"{self._path}: texture {file.path!r} cannot be read ({error}); save it as PNG") from error

    def _light(self, prim: Any) -> FoundLight:
        """Translate a light; raises for kinds that have no counterpart."""
        matrix = self._matrix(prim)
        stretch = np.linalg.norm(matrix[:3, :3], axis=0)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = matrix[:3, :3] / stretch, matrix[:3, 3]
        value = _inputs(UsdLux.LightAPI(prim))
        level = float(value("intensity", 1.0)) * 2.0 ** float(value("exposure", 0.0))
        colour = np.array(value("color", (1.0, 1.0, 1.0)), np.float64)
        if value("enableColorTemperature", False):
            colour = colour * np.array(UsdLux.BlackbodyTemperatureAsRgb(float(value("colorTemperature", 6500.0))))
        normalized = bool(value("normalize", False))

        def made(kind: Any, amount: float, unit: Any, **more: Any) -> FoundLight:
            return FoundLight(
                kind=kind, name=prim.GetName(), amount=_rgb(colour * amount), unit=unit, pose=matrix4(pose), **more
            )

        if prim.IsA(UsdLux.SphereLight):
            return _sphere(made, prim, level, float(value("radius", 0.5)) * float(stretch.mean()), normalized)
        if prim.IsA(UsdLux.RectLight):
            size = float(value("width", 1.0)) * stretch[0], float(value("height", 1.0)) * stretch[1]
            area = size[0] * size[1]
            return made("area", level / area if normalized else level, "nit", width=size[0], height=size[1])
        if prim.IsA(UsdLux.DiskLight):
            size = 2 * float(value("radius", 0.5)) * stretch[0], 2 * float(value("radius", 0.5)) * stretch[1]
            area = math.pi / 4 * size[0] * size[1]
            amount = level / area if normalized else level
            return made("area", amount, "nit", width=size[0], height=size[1], ellipse=True)
        if prim.IsA(UsdLux.DistantLight):
            angle = math.radians(float(value("angle", 0.53)))
            spread = math.pi * math.sin(angle / 2) ** 2
            return made("sun", level if normalized or spread == 0 else level * spread, "lx", angle=angle)
        if prim.IsA(UsdLux.DomeLight) or prim.IsA(UsdLux.DomeLight_1):
            return self._dome(made, prim, level)
        raise AssetError(
            f"{self._path}: the light {prim.GetPath()} is a {prim.GetTypeName()}, which is not read; "
            "make it a sphere, rect, disk, distant or dome light"
        )

    def _dome(self, made: Any, prim: Any, level: float) -> FoundLight:
        """Translate a dome, whose map OpenEXR lays out: its pole on +Y, its middle on +Z, its left towards +X."""
        axes = self._matrix(prim)[:3, :3] / np.linalg.norm(self._matrix(prim)[:3, 0])
        pole, middle = axes[:, 1], axes[:, 2]
        if prim.IsA(UsdLux.DomeLight_1) and self._pole(prim) == UsdGeom.Tokens.z:
            pole, middle = axes[:, 2], -axes[:, 1]
        if pole[2] < 0.999:
            raise AssetError(f"{self._path}: the dome light {prim.GetPath()} is tilted; turn its pole upright")
        rotation = math.atan2(middle[1], middle[0])
        file = prim.GetAttribute("inputs:texture:file").Get()
        if file is None or not file.path:
            return made("environment", level, "nit")
        name = f"dome-{len(list(self._folder.glob('dome-*.exr')))}"
        self._write_map(file, prim.GetPath(), self._folder / f"{name}.exr")
        return made("environment", level, "nit", map=name, rotation=rotation)

    def _pole(self, prim: Any) -> str:
        """Return the axis that a dome of the second schema has its pole on."""
        axis = str(prim.GetAttribute("poleAxis").Get() or "scene")
        return str(UsdGeom.GetStageUpAxis(self._stage)) if axis == "scene" else axis

    def _write_map(self, file: Any, where: Any, target: Path) -> None:
        """Bring a dome's texture into the cache as EXR."""
        if file.resolvedPath.lower().endswith(".exr"):
            shutil.copyfile(file.resolvedPath, target)
            return
        if file.path.lower().endswith((".hdr", ".tx")):
            raise AssetError(f"{self._path}: {where} names {file.path!r}; convert it to EXR")
        pixels = np.asarray(self._picture(file, where).convert("RGB"), np.float32) / 255
        linear = np.where(pixels <= 0.04045, pixels / 12.92, ((pixels + 0.055) / 1.055) ** 2.4).astype(np.float32)
        with OpenEXR.File({}, {"RGB": np.ascontiguousarray(linear)}) as picture:
            picture.write(str(target))


def _sphere(made: Any, prim: Any, level: float, radius: float, normalized: bool) -> FoundLight:
    """Translate a sphere light: its intensity is its luminance times the disc that one sees; a cone makes it a spot."""
    seen = math.pi * radius**2
    intensity = level / 4 if normalized else level * seen
    size = 0.0 if prim.GetAttribute("treatAsPoint").Get() else radius
    if not prim.HasAPI(UsdLux.ShapingAPI):
        return made("point", intensity, "cd", radius=size)
    shaping = UsdLux.ShapingAPI(prim)
    half = math.radians(float(shaping.GetShapingConeAngleAttr().Get() or 90.0))
    if half >= 1.49:
        return made("point", intensity, "cd", radius=size)
    soft = float(np.clip(shaping.GetShapingConeSoftnessAttr().Get() or 0.0, 0, 1))
    return made("spot", intensity, "cd", radius=size, half_angle=half, blend=soft)


def _is_shown(prim: Any) -> bool:
    imageable = UsdGeom.Imageable(prim)
    shown = imageable.ComputeVisibility() != UsdGeom.Tokens.invisible
    return shown and imageable.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


def _surface(prim: Any) -> Any:
    """Return the UsdPreviewSurface bound to a prim, or None."""
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    shader = material.ComputeSurfaceSource()[0] if material else None
    return shader if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface" else None


def _inputs(owner: Any) -> Any:
    """Return a function that looks an input's value up: (name, fallback) -> value."""

    def value(name: str, fallback: Any) -> Any:
        found = owner.GetInput(name)
        given = found.Get() if found else None
        return fallback if given is None else given

    return value


def _rgb(colour: Any) -> Rgb:
    red, green, blue = (max(float(v), 0.0) for v in colour)
    return red, green, blue


@dataclass(frozen=True)
class _Shape:
    """Triangles as corners: point of each corner (T, 3), face each came from (T,), and values by corner, or None."""

    points: Float64
    faces: Int64
    source: Int64
    uv: Float64 | None
    normals: Float64 | None


def _shape(prim: Any) -> _Shape | None:
    """Read a prim's triangles; None where it has none."""
    if not prim.IsA(UsdGeom.Mesh):
        return _solid(prim)
    mesh = UsdGeom.Mesh(prim)
    points = np.array(mesh.GetPointsAttr().Get() or [], np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], np.int64)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
    if not len(points) or not len(counts) or counts.sum() != len(corners) or corners.max() >= len(points):
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
    shading = _values(normals, corners, triangles, 3) if normals.HasValue() else None
    return _Shape(points, corners[triangles], source, uv, shading)


def _values(primvar: Any, corners: Int64, triangles: Int64, width: int) -> Float64 | None:
    """Return a primvar at each corner of each triangle, (T, 3, width); None where it varies otherwise."""
    if not primvar or not primvar.HasValue():
        return None
    values = np.array(primvar.ComputeFlattened(), np.float64).reshape(-1, width)
    match primvar.GetInterpolation():
        case "faceVarying" if len(values) == len(corners):
            return np.asarray(values[triangles])
        case "vertex" | "varying" if len(values) > corners.max():
            return np.asarray(values[corners[triangles]])
        case _:
            return None


def _solid(prim: Any) -> _Shape:
    """Make triangles of a cube, a sphere or a cylinder."""
    if prim.IsA(UsdGeom.Cube):
        side = float(UsdGeom.Cube(prim).GetSizeAttr().Get())
        made = trimesh.creation.box((side, side, side))
    elif prim.IsA(UsdGeom.Sphere):
        made = trimesh.creation.icosphere(subdivisions=4, radius=float(UsdGeom.Sphere(prim).GetRadiusAttr().Get()))
    else:
        rod = UsdGeom.Cylinder(prim)
        made = trimesh.creation.cylinder(rod.GetRadiusAttr().Get(), rod.GetHeightAttr().Get(), sections=64)
        turns = {"X": ([0, 0, 1], [1, 0, 0]), "Y": ([0, 0, 1], [0, 1, 0])}
        if rod.GetAxisAttr().Get() in turns:
            made.apply_transform(trimesh.geometry.align_vectors(*turns[rod.GetAxisAttr().Get()]))
    faces = np.asarray(made.faces, np.int64)
    return _Shape(np.asarray(made.vertices, np.float64), faces, np.zeros(len(faces), np.int64), None, None)


def _from_package(resolved: str) -> io.BytesIO:
    """Open a file inside a .usdz."""
    package, _, inner = resolved.rstrip("]").partition("[")
    with zipfile.ZipFile(package) as archive:
        return io.BytesIO(archive.read(inner))
