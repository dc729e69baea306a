"""A scene under one light at a time, whole or without a body: one of Mitsuba's scenes for each."""

from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from trimesh import Trimesh

from multilight.datagen.backends.mitsuba.arrays import Textures, glowing_parts, parts_of, place_part
from multilight.datagen.backends.mitsuba.scalar.lights import Emitters, emitters
from multilight.datagen.backends.mitsuba.scalar.materials import coloured, surface
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.spec import SceneSpec

INNER_SIDE = 2e-5
"""Metres between the two shining sides of a glowing sheet."""


class Worlds:
    """The scenes of one `SceneSpec` and rig, made when first asked for; they share surfaces and shapes."""

    def __init__(self, scene: SceneSpec, rig: LightRig, library: AssetLibrary, textures: Textures) -> None:
        self._rig, self._library, self._textures = rig, library, textures
        glowing_parts(scene, rig)  # refuses lights that name no part
        self._placed: dict[tuple[str, int], tuple[Float32, NDArray[np.int32]]] = {}
        self._surfaces: dict[tuple[str, int], mi.BSDF] = {}
        self._shapes: dict[tuple[str, int], mi.Mesh] = {}
        for body in scene.bodies:
            for number, part in enumerate(parts_of(body, library)):
                key = (body.name, number)
                self._placed[key] = place_part(part, np.array(body.world_from_body)), part.faces
                self._surfaces[key] = surface(body.materials[number], textures)
                self._shapes[key] = _mesh(*self._placed[key], self._surfaces[key])
        points = np.concatenate([vertices[:, :3] for vertices, _ in self._placed.values()])
        self._bounds = np.stack([points.min(axis=0), points.max(axis=0)]).astype(np.float64)
        self._lights: dict[int, Emitters] = {}
        self._made: dict[tuple[int, str | None], mi.Scene | None] = {}

    def lit(self, number: int, removed: str | None = None) -> mi.Scene | None:
        """Return the scene lit by a light alone, without a body or whole; None where the light went with the body."""
        key = (number, removed)
        if key not in self._made:
            self._made[key] = self._make(number, removed)
        return self._made[key]

    def _make(self, number: int, removed: str | None) -> mi.Scene | None:
        light = self._rig.lights[number]
        if isinstance(light, EmissiveLight) and light.body == removed:
            return None
        shapes = {_id(*key): shape for key, shape in self._shapes.items() if key[0] != removed}
        if number not in self._lights:
            self._lights[number] = (
                self._glowing(light)
                if isinstance(light, EmissiveLight)
                else emitters(light, self._library, self._bounds)
            )
        return mi.load_dict({"type": "scene"} | shapes | self._lights[number])

    def _glowing(self, light: EmissiveLight) -> Emitters:
        """Make a part that shines; Mitsuba's emitters have one side, so a sheet gets a second behind it."""
        key = (light.body, light.part)
        vertices, faces = self._placed[key]
        radiance = coloured(light.texture, light.radiance, self._textures)
        sides = {_id(*key): _mesh(vertices, faces, self._surfaces[key], radiance)}
        if not Trimesh(vertices[:, :3], faces).is_watertight:
            behind = vertices * np.array([1, 1, 1, -1, -1, -1, 1, 1], np.float32)
            behind[:, :3] += behind[:, 3:6] * np.float32(INNER_SIDE)
            sides["behind"] = _mesh(behind, faces[:, ::-1], self._surfaces[key], radiance)
        return sides


def _id(body: str, part: int) -> str:
    return f"{body}/{part}"


def _mesh(
    vertices: Float32, faces: NDArray[np.int32], surface: mi.BSDF, radiance: dict[str, Any] | None = None
) -> mi.Mesh:
    """Make a shape of (V, 8) position, normal, uv and (F, 3) faces; with a radiance it shines."""
    props = mi.Properties()
    props["mesh_bsdf"] = surface
    if radiance is not None:
        props["mesh_emitter"] = mi.load_dict({"type": "area", "radiance": radiance})
    mesh = mi.Mesh("part", len(vertices), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=props)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices[:, :3]).ravel()
    parameters["vertex_normals"] = np.ascontiguousarray(vertices[:, 3:6]).ravel()
    parameters["vertex_texcoords"] = np.ascontiguousarray(vertices[:, 6:]).ravel()
    parameters["faces"] = np.ascontiguousarray(faces, np.uint32).ravel()
    parameters.update()
    return mesh
