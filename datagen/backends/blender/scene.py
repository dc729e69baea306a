"""A `SceneSpec` and a `LightRig` as a Blender scene, and the camera that moves in it."""

from itertools import product

import bpy
import numpy as np
from mathutils import Matrix

from multilight.datagen.backends.blender import lights as blender_lights
from multilight.datagen.backends.blender import meshes
from multilight.datagen.backends.blender.materials import Materials
from multilight.datagen.backends.body_parts import body_parts, glowing_parts
from multilight.lights.spec import EmissiveLight, EnvironmentLight, LightRig
from multilight.scenes.arrays import Float64
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import SENSOR_MM, circle_of_confusion
from multilight.scenes.poses import apply_pose
from multilight.scenes.spec import Body, Camera, MeshAsset, Rectangle, SceneSpec, Sphere


class SyncedScene:
    """A scene as Blender holds it: the objects of each body, its lamps and its sky."""

    def __init__(self, scene: SceneSpec, rig: LightRig, library: AssetLibrary) -> None:
        """Empty Blender's file and build the scene anew, from data only."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._library = library
        self._materials = Materials(library)
        self._meshes: dict[object, bpy.types.Mesh] = {}
        self.objects: dict[str, list[bpy.types.Object]] = {}
        glowing = glowing_parts(scene, rig)
        for number, body in enumerate(scene.bodies, start=1):
            glows = {part: light for (name, part), light in glowing.items() if name == body.name}
            self.objects[body.name] = self._add_body(body, number, glows)
        self.lamps: list[bpy.types.Object] = []
        for light in rig.lights:
            if not isinstance(light, EnvironmentLight | EmissiveLight):
                self.lamps.append(blender_lights.add_light(light, library))
        self.sky = blender_lights.Sky([light for light in rig.lights if isinstance(light, EnvironmentLight)], library)
        camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        bpy.context.scene.collection.objects.link(camera)
        bpy.context.scene.camera = camera

    def box(self, name: str) -> Float64:
        """Return the eight corners of boxes round a body's objects, (8 n, 3) float64, world metres."""
        corners = []
        for placed in self.objects[name]:
            points = np.empty(len(placed.data.vertices) * 3, np.float32)
            placed.data.vertices.foreach_get("co", points)
            low, high = points.reshape(-1, 3).min(axis=0), points.reshape(-1, 3).max(axis=0)
            local = np.array(list(product(*zip(low, high, strict=True))))
            corners.append(apply_pose(np.array(placed.matrix_world), local))
        return np.concatenate(corners)

    def _add_body(self, body: Body, number: int, glows: dict[int, EmissiveLight]) -> list[bpy.types.Object]:
        """Add a body; a light group belongs to a whole Blender object, so each glowing part becomes one."""
        parts = range(len(body.materials))
        groups = [[part for part in parts if part not in glows], *([part] for part in parts if part in glows)]
        return [self._add_object(body, tuple(parts), number, glows.get(parts[0])) for parts in filter(None, groups)]

    def _add_object(
        self, body: Body, parts: tuple[int, ...], number: int, light: EmissiveLight | None
    ) -> bpy.types.Object:
        placed = bpy.data.objects.new(body.name, self._mesh(body, parts))
        scale = body.geometry.radius if isinstance(body.geometry, Sphere) else 1.0
        placed.matrix_world = Matrix(body.world_from_body) @ Matrix.Diagonal((scale, scale, scale, 1.0))
        for slot, part in enumerate(parts):
            coloured = meshes.COLORS in placed.data.color_attributes
            shader = self._materials.get(body.materials[part], light, coloured=coloured)
            # Slots belong to the object, so that bodies may share a mesh and yet differ in material.
            placed.material_slots[slot].link = "OBJECT"
            placed.material_slots[slot].material = shader
        placed.pass_index = number
        if light is not None:
            placed.lightgroup = light.name
        bpy.context.scene.collection.objects.link(placed)
        return placed

    def _mesh(self, body: Body, parts: tuple[int, ...]) -> bpy.types.Mesh:
        """Make a mesh of some of a body's parts, or return the one that another body has; all spheres share one."""
        key = "sphere" if isinstance(body.geometry, Sphere) else (body.geometry, parts)
        if key not in self._meshes:
            match body.geometry:
                case Sphere():
                    made = meshes.unit_sphere(body.name)
                case Rectangle() as shape:
                    made = meshes.rectangle(body.name, shape)
                case MeshAsset():
                    own = body_parts(body, self._library)
                    made = meshes.mesh_from_parts(body.name, [own[part] for part in parts])
            for _ in parts:
                made.materials.append(None)
            self._meshes[key] = made
        return self._meshes[key]


def place_camera(camera: Camera) -> None:
    """Set Blender's camera and picture size: same axes, the principal point as a shift of the sensor."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = camera.width, camera.height
    # A pixel is 1/fx wide and 1/fy high; Blender takes the ratio as two numbers of at least one.
    scene.render.pixel_aspect_x = max(1.0, camera.fy / camera.fx)
    scene.render.pixel_aspect_y = max(1.0, camera.fx / camera.fy)
    placed, data = scene.camera, scene.camera.data
    placed.matrix_world = Matrix(camera.c2w)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = camera.fx * SENSOR_MM / camera.width
    data.shift_x = (camera.width / 2 - camera.cx) / camera.width
    data.shift_y = (camera.cy - camera.height / 2) * (camera.fx / camera.fy) / camera.width
    data.clip_start, data.clip_end = 1e-4, 1e5
    data.dof.use_dof = camera.aperture_radius > 0
    if camera.aperture_radius > 0:
        data.dof.focus_distance = camera.focus_distance
        # Cycles makes the lens's radius from the focal length: lens / (2 fstop), in millimetres.
        data.dof.aperture_fstop = data.lens / 1000.0 / (2.0 * camera.aperture_radius)


def projected_border(camera: Camera, corners: Float64) -> tuple[int, int, int, int] | None:
    """Return the pixels that may see a box: (left, top, right, bottom), right and bottom excluded.

    The whole picture where a corner lies behind the camera; None where the box is out of sight.
    """
    pose = camera.pose()
    local = (corners - pose[:3, 3]) @ pose[:3, :3]
    if (local[:, 2] > -1e-6).any():
        return (0, 0, camera.width, camera.height)
    x = camera.cx - camera.fx * local[:, 0] / local[:, 2]
    y = camera.cy + camera.fy * local[:, 1] / local[:, 2]
    # Out of focus, an object spreads over its outline by half a disc of confusion.
    margin = 2 + int(np.ceil(circle_of_confusion(camera, -local[:, 2]).max() / 2.0))
    left, right = max(0, int(x.min()) - margin), min(camera.width, int(x.max()) + 1 + margin)
    top, bottom = max(0, int(y.min()) - margin), min(camera.height, int(y.max()) + 1 + margin)
    return (left, top, right, bottom) if left < right and top < bottom else None
