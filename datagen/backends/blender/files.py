"""Files that Blender's importers read, as nodes of triangles, with lights and an account of what is not carried."""

import math
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from multilight.datagen.backends.blender.bake import Shape, bake
from multilight.datagen.backends.blender.surfaces import Finished, ShaderReader, tidy
from multilight.datagen.backends.blender.worlds import read_world
from multilight.scenes.arrays import Float64, Int64
from multilight.scenes.assets.formats.cleaning import RawPart, tinted
from multilight.scenes.assets.formats.coordinates import laid
from multilight.scenes.assets.formats.imported import (
    EMISSION_NITS,
    Emission,
    FoundLight,
    Imported,
    KeepImage,
    Node,
    Note,
)
from multilight.scenes.assets.formats.obj import staged
from multilight.scenes.assets.formats.precheck import check_triangles
from multilight.scenes.assets.info import AssetError
from multilight.scenes.colour import LUMINOUS_EFFICACY
from multilight.scenes.files.confined import OutsideError, held
from multilight.scenes.files.limits import MOST_NODES, LimitError
from multilight.scenes.frozen import Rgb
from multilight.scenes.poses import apply_pose, matrix4
from multilight.scenes.spec import Material

WATTS_TO_INTENSITY = 1 / (4 * math.pi)
"""W/sr on the axis of a Blender point or spot light of one watt, as in `datagen.backends.blender.lights`."""
GLTF_EFFICACY = 683.0
"""lm/W by which Blender's glTF importer divides."""
IMPORTERS: dict[str, Any] = {
    ".glb": ("import_scene", "gltf", {"merge_vertices": False, "disable_bone_shape": True}),
    ".obj": ("wm", "obj_import", {}),
    ".fbx": ("wm", "fbx_import", {}),
    ".ply": ("wm", "ply_import", {"forward_axis": "Y", "up_axis": "Z"}),
    ".stl": ("wm", "stl_import", {"forward_axis": "Y", "up_axis": "Z"}),
}
IMPORTERS[".gltf"] = IMPORTERS[".glb"]
SHAPES = ("MESH", "CURVE", "SURFACE", "META", "FONT")
LEFT_OUT = ("VOLUME", "POINTCLOUD", "CURVES", "GPENCIL", "GREASEPENCIL")
COLOURED = (".glb", ".gltf", ".obj", ".ply", ".fbx")
"""Formats whose vertex colours count whatever the material says."""
_GIVEN = (".blend", ".glb", ".gltf", ".fbx")
"""Formats whose shading is the file's own where it gives no normals."""
_BROUGHT = (
    "objects collections meshes curves armatures lights cameras materials images node_groups actions textures worlds "
    "libraries"
)
_begun: list[bool] = []
_TRIES = 20_000
"""Files that are looked through for a picture that is not where a model says."""


def read_file(path: Path, folder: Path, keep: KeepImage, work: Path, said: str) -> tuple[Imported, list[Path]]:
    """Read a file, which may refer to others in `folder`; returns those as well. Maps of skies go into `work`.

    Raises `AssetError` or `LimitError`.
    """
    return _Reader(path, folder, keep, work, said).read()


class _Reader:
    """Reads one file."""

    def __init__(self, path: Path, folder: Path, keep: KeepImage, work: Path, said: str) -> None:
        self._path, self._folder, self._work, self._keep = path, folder, work, keep
        self._suffix = path.suffix.lower()
        stated = {"Kd": "Base Color", "Pr": "Roughness", "Pm": "Metallic", "map_d": "Alpha"}
        stated = stated if self._suffix == ".obj" else {}
        self._times_plain = {name for key, name in stated.items() if key in said.split()}
        # Blender writes its own watts into glTF, times a constant for lights.
        self._watts = self._suffix == ".blend" or "Blender" in said
        self._notes: list[Note] = []
        self._used: set[Path] = set()
        self._beside: dict[str, Path] | None = None

    def read(self) -> tuple[Imported, list[Path]]:
        self._load()
        self._check_libraries()
        scene = bpy.context.scene
        units = scene.unit_settings
        self._metres = units.scale_length if self._suffix == ".blend" and units.system != "NONE" else 1.0
        gltf = self._suffix in (".glb", ".gltf")
        self._shaders = ShaderReader(self._keep, self._path_of, self._notes, self._times_plain, gltf=gltf)
        _show_what_is_rendered(scene)
        lights: list[FoundLight] = []
        triangles = 0
        shapes = []
        for number, instance in enumerate(bpy.context.evaluated_depsgraph_get().object_instances):
            if number > MOST_NODES:
                raise LimitError(f"it places more than {MOST_NODES} nodes; join some")
            placed, matrix = instance.object, np.array(instance.matrix_world)
            if placed.type == "LIGHT":
                lights += self._light(placed.original.name, placed.data, instance.matrix_world.copy())
            elif instance.is_instance and placed.type != placed.original.type:
                pass  # what a curve or text was made into, which comes as itself too
            elif placed.type in SHAPES and abs(np.linalg.det(matrix[:3, :3])) > 1e-18:
                mesh = placed.data if instance.is_instance else placed.to_mesh()
                if hasattr(mesh, "loop_triangles"):  # an empty text has none
                    mesh.calc_loop_triangles()
                    triangles += len(mesh.loop_triangles)
                    check_triangles(triangles)
                    shapes.append(self._shape(placed, mesh, matrix))
            elif placed.type in LEFT_OUT:
                what = f"a {placed.type.lower()}"
                note = Note(place=placed.original.name, feature=what, instead="it is left out", remedy="make it a mesh")
                self._notes.append(note)
        nodes = [self._node(shape) for shape in shapes if len(shape.points)]
        if scene.world is not None and self._suffix in (".blend",):
            lights += read_world(scene.world, self._path_of, self._work)
        nodes.sort(key=lambda node: (node.name, [p.vertices.min(axis=0).round(6).tolist() for p in node.parts]))
        lights.sort(key=lambda light: light.name)
        return Imported(tuple(nodes), tuple(lights), tuple(self._notes)), sorted(self._used)

    def _load(self) -> None:
        _empty()
        try:
            if self._suffix == ".blend":
                bpy.ops.wm.open_mainfile(filepath=str(self._path), load_ui=False, use_scripts=False)
            else:
                module, name, options = IMPORTERS[self._suffix]
                path = staged(self._path, self._folder, self._work / "obj") if self._suffix == ".obj" else self._path
                getattr(getattr(bpy.ops, module), name)(filepath=str(path), **options)
        except RuntimeError as error:
            said = [line.strip() for line in str(error).splitlines() if line.strip()] or ["no reason given"]
            reason = said[-1].removeprefix("Error: ")
            raise AssetError(f"{self._path} cannot be read ({reason}); export it again") from None

    def _check_libraries(self) -> None:
        """Refuse what lies outside of the folder, pictures, caches or libraries, and libraries that are missing."""
        for name in bpy.utils.blend_paths(absolute=True):
            if Path(name).exists():
                self._confined(Path(os.path.abspath(name)))
        for library in bpy.data.libraries:
            path = Path(os.path.abspath(bpy.path.abspath(library.filepath)))
            self._confined(path)
            if not path.is_file():
                raise AssetError(
                    f"{self._path} links the library {library.filepath!r}, which is missing; put it there, or append "
                    "what it links"
                )

    def _confined(self, path: Path) -> None:
        try:
            held(self._folder, path)
        except OutsideError as error:
            raise AssetError(
                f"{self._path}: it uses a file outside: {error}; put the file into the folder {self._folder}"
            ) from None
        self._used.add(path)

    def _path_of(self, image: Any) -> Path:
        """Find a picture: where the file says, in other case, or of the same name near by."""
        named = Path(os.path.abspath(bpy.path.abspath(image.filepath.replace("\\", "/"), library=image.library)))
        self._used.add(named)
        if named.is_file():
            self._confined(named)
            return named
        self._used.discard(named) if not named.is_relative_to(self._folder) else None
        found = self._near(named.name)
        if found is None:
            shown = os.path.relpath(named, self._path.parent)
            raise AssetError(f"the picture {shown!r} is missing; put it beside the file, or pack it into it")
        self._used.add(found)
        self._notes.append(Note(
            place=f"picture {named.name!r}", feature="it is not where the file says",
            instead=f"{os.path.relpath(found, self._path.parent)!r} is taken", remedy="put it where the file says",
        ))  # fmt: skip
        return found

    def _near(self, name: str) -> Path | None:
        if self._beside is None:
            above = self._path.parent.parent
            root = above if above.resolve().is_relative_to(self._folder.resolve()) else self._path.parent
            self._beside = {}
            found = sorted(
                (path for path, _ in zip(_files(root), range(_TRIES), strict=False)),
                key=lambda path: (len(os.path.relpath(path, self._path.parent).split(os.sep)), str(path)),
            )
            for path in found:
                self._beside.setdefault(path.name.casefold(), path)
        return self._beside.get(name.casefold())

    def _shape(self, placed: Any, mesh: Any, matrix: Float64) -> Shape:
        """Copy an evaluated mesh: baking makes Blender evaluate anew."""
        count = len(mesh.loop_triangles)
        loops = _read(mesh.loop_triangles, "loops", 3 * count, np.int32)
        polygon = _read(mesh.loop_triangles, "polygon_index", count, np.int32)
        vertex = _read(mesh.loops, "vertex_index", len(mesh.loops), np.int32)[loops]
        normals = None
        if mesh.has_custom_normals or self._suffix in _GIVEN:
            normals = _read(mesh.corner_normals, "vector", 3 * len(mesh.loops), np.float32).reshape(-1, 3)[loops]
        shape = Shape(
            name=placed.original.name,
            matrix=matrix,
            points=_read(mesh.vertices, "co", 3 * len(mesh.vertices), np.float32).reshape(-1, 3)[vertex].astype(float),
            normals=None if normals is None else normals.astype(float),
            slots=_read(mesh.polygons, "material_index", len(mesh.polygons), np.int32)[polygon],
            materials=[slot.material and slot.material.original for slot in placed.material_slots],
            active=next((layer.name for layer in mesh.uv_layers if layer.active_render), ""),
            texspace=(tuple(mesh.texspace_location), tuple(mesh.texspace_size)),
        )
        for layer in mesh.uv_layers:
            shape.uv[layer.name] = _read(layer.uv, "vector", 2 * len(mesh.loops), np.float32).reshape(-1, 2)[loops]
        for found in mesh.color_attributes:
            values = _read(found.data, "color", 4 * len(found.data), np.float32).reshape(-1, 4).astype(float)
            shape.colors[found.name] = values[loops if found.domain == "CORNER" else vertex]
        return shape

    def _node(self, shape: Shape) -> Node:
        """Place a shape in the world, one part for each material on it."""
        points = apply_pose(shape.matrix, shape.points) * self._metres
        normals = None if shape.normals is None else shape.normals @ np.linalg.inv(shape.matrix[:3, :3])
        mirrored = np.linalg.det(shape.matrix[:3, :3]) < 0
        parts, emissions = [], []
        for slot in np.unique(shape.slots).tolist():
            at = shape.corners(slot).reshape(-1, 3)[:, :: -1 if mirrored else 1].ravel()
            finished = self._finished(shape, slot)
            given = shape.uv.get(finished.place.layer, shape.uv.get(shape.active))
            uv = None if given is None else laid(given[at].astype(np.float64), finished.place.affine)
            colors = self._colors(shape, finished, at)
            material = finished.material
            if colors is not None:
                material, colors = tinted(material, colors)
            faces = np.arange(len(at), dtype=np.int64).reshape(-1, 3)
            parts.append(RawPart(material, points[at], faces, None if normals is None else normals[at], uv, colors))
            emissions.append(self._emission(finished))
        return Node(shape.name, tuple(parts), tuple(emissions))

    def _finished(self, shape: Shape, slot: int) -> Finished:
        material = shape.materials[slot] if slot < len(shape.materials) else None
        if material is None:
            plain = (1.0, 1.0, 1.0) if self._suffix in COLOURED and shape.colors else (0.8, 0.8, 0.8)
            return Finished(Material(name="material", base_color=plain))
        try:
            return self._shaders.read(material, partial(bake, shape, slot), shape.active)
        except AssetError as error:
            raise AssetError(f"{self._path}: {str(error).removeprefix(f'{self._path}: ')}") from None

    def _colors(self, shape: Shape, finished: Finished, at: Int64) -> Float64 | None:
        """Return linear vertex colours (N, 3) of corners: those that the material names, or the file's."""
        if finished.colors is None and self._suffix not in COLOURED:
            return None
        named = shape.colors.get(finished.colors or "")
        found = next(iter(shape.colors.values()), None) if named is None else named
        return None if found is None else found[at, :3]

    def _emission(self, finished: Finished) -> Emission | None:
        """Return what a part gives off: Blender's strengths are W/(m² sr); other files', cd/m² where they say."""
        if max(finished.emission) <= 0:
            return None
        # glTF says how strong it is above 1; at 1 and below it says the colour alone, as other files do.
        unit = 1.0 if max(finished.emission) > 1 and self._suffix in (".glb", ".gltf") else EMISSION_NITS
        unit = LUMINOUS_EFFICACY if self._watts else unit
        return Emission(amount=rgb_of(finished.emission, unit), texture=finished.emission_texture)

    def _light(self, name: str, light: Any, matrix: Matrix) -> Iterator[FoundLight]:
        """Translate one light; Blender's watts as `datagen.backends.blender.lights` explains them."""
        place, turn, stretch = matrix.decompose()
        if abs(matrix.to_3x3().determinant()) < 1e-18 and light.type != "POINT":
            self._notes.append(Note(
                place=f"light {name!r}", feature="its scale is 0, so it has no direction", instead="it is left out",
                remedy="give it a scale of 1",
            ))  # fmt: skip
            return
        place *= self._metres
        pose = np.array(Matrix.Translation(place) @ turn.to_matrix().to_4x4())
        if not np.isfinite(pose).all() or light.type == "POINT":
            pose = np.array(Matrix.Translation(place))
        about: dict[str, Any] = {"name": name, "pose": matrix4(pose)}
        colour = np.array(light.color)
        if getattr(light, "use_temperature", False):
            colour *= np.array(light.temperature_color)
        power = float(light.energy) * 2.0 ** float(getattr(light, "exposure", 0.0))
        nearer = power * self._metres**2  # as bright at distances in other units
        gltf = self._suffix in (".glb", ".gltf") and not self._watts
        efficacy = GLTF_EFFICACY if gltf else 1.0
        match light.type:
            case "POINT" | "SPOT":
                about |= {
                    "unit": "cd" if gltf else "W/sr",
                    "radius": light.shadow_soft_size * self._metres if self._suffix == ".blend" else 0.0,
                }
                amount = rgb_of(colour, nearer * WATTS_TO_INTENSITY * efficacy)
                if light.type == "POINT":
                    yield FoundLight(kind="point", amount=amount, **about)
                else:
                    half, soft = min(light.spot_size / 2, 1.49), light.spot_blend
                    if gltf:  # which fades over cosines, from an inner cone to the outer one
                        soft = (math.cos((1 - soft) * half) - math.cos(half)) / (1 - math.cos(half))
                    yield FoundLight(
                        kind="spot", amount=amount, half_angle=half, blend=float(np.clip(soft, 0, 1)), **about
                    )
            case "SUN":
                unit: Any = "lx" if gltf else "W/m2"
                angle = light.angle if self._suffix == ".blend" else 0.0
                yield FoundLight(kind="sun", unit=unit, amount=rgb_of(colour, power * efficacy), angle=angle, **about)
            case _:
                round_one = light.shape in ("DISK", "ELLIPSE")
                height = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
                size = light.size * stretch.x * self._metres, height * stretch.y * self._metres
                area = size[0] * size[1] * (math.pi / 4 if round_one else 1.0)
                amount = rgb_of(colour, nearer / (math.pi * max(area, 1e-9)))
                yield FoundLight(
                    kind="area", unit="W/(m2 sr)", amount=amount, width=size[0], height=size[1], ellipse=round_one,
                    **about,
                )  # fmt: skip


def _empty() -> None:
    """Take away what the last file brought; a .blend file brings settings too, so that all starts anew."""
    if bpy.data.filepath or not _begun:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.filepaths.use_scripts_auto_execute = False
        _begun.append(True)
    else:  # ten times faster
        bpy.data.batch_remove([made for kind in _BROUGHT.split() for made in getattr(bpy.data, kind)])


def rgb_of(colour: Any, strength: float) -> Rgb:
    """Return a colour times a strength, neither below 0."""
    return tidy([max(float(v), 0.0) * max(strength, 0.0) for v in list(colour)[:3]])


def _files(root: Path) -> Iterator[Path]:
    """Yield the files up to three levels below a folder."""
    for place, folders, names in os.walk(root):
        if len(Path(place).relative_to(root).parts) >= 3:
            folders.clear()
        folders.sort()
        yield from (Path(place) / name for name in sorted(names))


def _read(collection: Any, name: str, count: int, kind: Any) -> np.ndarray:
    values = np.empty(count, kind)
    collection.foreach_get(name, values)
    return values


def _show_what_is_rendered(scene: Any) -> None:
    """Let Blender evaluate what is rendered, as it is rendered, whatever was hidden while editing."""
    for placed in scene.objects:
        placed.hide_viewport = placed.hide_render
        if placed.name in bpy.context.view_layer.objects:
            placed.hide_set(False)
        for modifier in placed.modifiers:
            modifier.show_viewport = modifier.show_render
            if modifier.type in ("SUBSURF", "MULTIRES"):
                modifier.levels = modifier.render_levels
    for collection in bpy.data.collections:
        collection.hide_viewport = collection.hide_render
    bpy.context.view_layer.update()
