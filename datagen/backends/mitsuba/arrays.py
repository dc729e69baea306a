"""A scene as flat arrays: one soup of triangles in the world, one row of numbers for each surface.

Everything that differs from scene to scene is data here, so that one compiled kernel renders them all.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilight.datagen.backends.parts import body_parts, glowing_parts
from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.arrays import Float32, Float64, Mask, UInt32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.files.limits import open_picture
from multilight.scenes.meshes import MeshPart
from multilight.scenes.spec import Material, SceneSpec, Texture

NONE = 0xFFFFFFFF
"""Stands for no texture and no light."""


@dataclass(frozen=True)
class SceneArrays:
    """Triangles and surfaces.

    vertices (V, 8) float32: position [m], shading normal, uv; faces (F, 4) uint32: three vertices and the surface's
    row; faces of a body lie together, `spans` holds (first, count) by body. values (R, 20) float32 and links
    (R, 16) uint32: the columns that `surfaces.py` names. texels uint32 RGBA8, all textures end to end.
    """

    vertices: Float32
    faces: UInt32
    spans: dict[str, tuple[int, int]]
    values: Float32
    links: UInt32
    texels: UInt32
    see_through: bool
    glass: bool

    def of_bodies(self, names: Iterable[str]) -> Mask:
        """Tell which triangles belong to some bodies, (F,) bool."""
        mine = np.zeros(len(self.faces), bool)
        for name in names:
            first, count = self.spans[name]
            mine[first : first + count] = True
        return mine

    def let_light_through(self) -> Mask:
        """Tell which triangles are, or may be, less than opaque, (F,) bool."""
        rows = (self.values[:, 3] < 1) | (self.links[:, 7] != 0)
        return rows[self.faces[:, 3]]


class Textures:
    """Bitmaps as RGBA8 words, kept from scene to scene."""

    MOST_BYTES = 1 << 30

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._kept: dict[str, UInt32] = {}

    def load(self, image: str) -> UInt32:
        """Return an image as (H, W) uint32, red in the lowest byte, top row first; raises `BackendError`."""
        if image not in self._kept:
            if sum(words.nbytes for words in self._kept.values()) > self.MOST_BYTES:
                self._kept.clear()
            self._kept[image] = _read_words(self._library.texture_path(image))
        return self._kept[image]


def _read_words(path: Path) -> UInt32:
    try:
        with open_picture(path) as picture:
            rgba = np.asarray(picture.convert("RGBA"))
    except (OSError, ValueError, SyntaxError) as error:
        raise BackendError(f"cannot read image {path}: {error}; fetch or repair its asset") from error
    return np.ascontiguousarray(rgba).view(np.uint32)[..., 0]


def scene_arrays(scene: SceneSpec, rig: LightRig, library: AssetLibrary, textures: Textures) -> SceneArrays:
    """Flatten a scene; raises `BackendError` where an emissive light names no part of it, or an asset has changed."""
    glowing = glowing_parts(scene, rig)
    atlas = _Atlas(textures)
    vertices: list[Float32] = []
    faces: list[UInt32] = []
    values: list[list[float]] = []
    links: list[list[int]] = []
    spans: dict[str, tuple[int, int]] = {}
    vertex = face = 0
    for number, body in enumerate(scene.bodies, start=1):
        first = face
        for part, mesh in enumerate(body_parts(body, library)):
            material = body.materials[part]
            placed = _placed(mesh, np.array(body.world_from_body))
            row = np.full((len(mesh.faces), 1), len(values), np.uint32)
            vertices.append(placed)
            faces.append(np.concatenate([mesh.faces.astype(np.uint32) + np.uint32(vertex), row], axis=1))
            light = glowing.get((body.name, part))
            glow = None if light is None else rig.names.index(light.name)
            values.append(_values(material, light))
            links.append(_links(material, number, glow, light, atlas))
            vertex += len(placed)
            face += len(mesh.faces)
        spans[body.name] = (first, face - first)
    materials = [material for body in scene.bodies for material in body.materials]
    return SceneArrays(
        vertices=np.concatenate(vertices),
        faces=np.concatenate(faces),
        spans=spans,
        values=np.array(values, np.float32),
        links=np.array(links, np.uint32),
        texels=atlas.words(),
        see_through=any(m.opacity < 1 or m.opacity_from_alpha for m in materials),
        glass=any(m.transmission > 0 for m in materials),
    )


def _placed(part: MeshPart, pose: Float64) -> Float32:
    """Place a part in the world: (V, 8) float32 position, unit normal, uv."""
    normals = part.normals @ np.linalg.inv(pose[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    points = part.vertices @ pose[:3, :3].T + pose[:3, 3]
    return np.concatenate([points, normals, part.uv], axis=1).astype(np.float32)


class _Atlas:
    """Lays the textures of a scene end to end."""

    def __init__(self, textures: Textures) -> None:
        self._textures = textures
        self._placed: dict[str, tuple[int, int, int]] = {}
        # Two words at least: Dr.Jit reads an array of one as a constant, in a kernel of its own.
        self._words: list[UInt32] = [np.zeros(2, np.uint32)]
        self._end = 2

    def place(self, texture: Texture | None) -> tuple[int, int, int]:
        """Return (offset, width, height) of a texture's words."""
        if texture is None:
            return NONE, 1, 1
        if texture.image not in self._placed:
            words = self._textures.load(texture.image)
            self._placed[texture.image] = (self._end, words.shape[1], words.shape[0])
            self._words.append(words.ravel())
            self._end += words.size
        return self._placed[texture.image]

    def words(self) -> UInt32:
        return np.concatenate(self._words)


def _values(material: Material, glow: object) -> list[float]:
    """Columns of `values`; see `surfaces.Surfaces`."""
    textures = (material.base_color_texture, material.roughness_texture, material.normal_texture)
    emission = glow.texture if isinstance(glow, EmissiveLight) else None
    repeats = [r for t in (*textures, emission) for r in ((1.0, 1.0) if t is None else t.repeat)]
    return [
        *material.base_color, material.opacity,
        material.roughness, material.metallic, material.ior, material.coat,
        material.coat_roughness, material.transmission, 0.0, 0.0,
        *repeats[:4],
        *repeats[4:],
    ]  # fmt: skip


def _links(material: Material, body: int, glow: int | None, light: object, atlas: _Atlas) -> list[int]:
    """Columns of `links`; see `surfaces.Surfaces`."""
    emission = light.texture if isinstance(light, EmissiveLight) else None
    return [
        *atlas.place(material.base_color_texture), body,
        *atlas.place(material.roughness_texture), int(material.opacity_from_alpha),
        *atlas.place(material.normal_texture), NONE if glow is None else glow,
        *atlas.place(emission), 0,
    ]  # fmt: skip
