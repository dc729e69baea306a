"""A scene as flat arrays: all its triangles in the world, one row of numbers for each surface.

Everything that differs from scene to scene is data here, so that one compiled kernel renders them all.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from multilight.datagen.backends.body_parts import body_parts, glowing_parts
from multilight.datagen.backends.mitsuba.device import aligned
from multilight.datagen.backends.protocol import BackendError
from multilight.lights.spec import EmissiveLight, LightRig
from multilight.scenes.arrays import Float32, Float64, Mask, UInt32
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.files.limits import open_picture
from multilight.scenes.meshes import MeshPart
from multilight.scenes.poses import apply_pose
from multilight.scenes.spec import Material, SceneSpec, Texture

NONE = 0xFFFFFFFF
"""Stands for no texture and no light."""
VALUES = np.dtype([
    ("base_color", np.float32, 3), ("opacity", np.float32),
    ("roughness", np.float32), ("metallic", np.float32), ("ior", np.float32), ("coat", np.float32),
    ("coat_roughness", np.float32), ("transmission", np.float32), ("metallic_repeat", np.float32, 2),
    ("base_color_repeat", np.float32, 2), ("roughness_repeat", np.float32, 2),
    ("normal_repeat", np.float32, 2), ("glow_repeat", np.float32, 2),
    ("alpha_cutoff", np.float32), ("unused", np.float32, 3),
])  # fmt: skip
"""A surface's numbers. The device reads them four at a time, a line each; so no column may lie in two lines."""
LINKS = np.dtype([
    ("base_color_texture", np.uint32, 3), ("body", np.uint32),
    ("roughness_texture", np.uint32, 3), ("opacity_from_alpha", np.uint32),
    ("normal_texture", np.uint32, 3), ("glow", np.uint32),
    ("glow_texture", np.uint32, 3), ("unused", np.uint32),
    ("metallic_texture", np.uint32, 3), ("unused_too", np.uint32),
])  # fmt: skip
"""What a surface refers to: offset, width and height of textures in `texels`, its body's number from 1, its light's.

The two highest bits of a width say what lies beyond the picture: the number in `WRAPS`.
"""
WRAPS = ("repeat", "clamp", "mirror")
WRAP_BIT = 30
WORD = np.dtype(np.uint32)


@dataclass(frozen=True)
class SceneArrays:
    """Triangles and surfaces.

    vertices (V, 8) float32: position [m], shading normal, uv; faces (F, 4) uint32: three vertices and the surface's
    row; colors (V, 3) float32 multiply the base colour, None where no part has any; faces of a body lie together,
    `spans` holds (first, count) by body. values (R,) of `VALUES` and links (R,) of `LINKS`: a row a surface. texels
    uint32 RGBA8, all textures end to end.
    """

    vertices: Float32
    colors: Float32 | None
    faces: UInt32
    spans: dict[str, tuple[int, int]]
    values: NDArray[np.void]
    links: NDArray[np.void]
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
        surfaces = (self.values["opacity"] < 1) | (self.links["opacity_from_alpha"] != 0)
        return np.asarray(surfaces[self.faces[:, 3]])


class Textures:
    """Bitmaps as RGBA8 words end to end, kept from scene to scene: what is there is not read again, nor copied."""

    ROOM, MOST_KEPT = 1 << 28, 3 << 26
    """Words that there is room for, of which those not yet used take no memory; above how many all is forgotten."""

    def __init__(self, library: AssetLibrary) -> None:
        self._library = library
        self._forget()

    def _forget(self) -> None:
        # Two words at least: Dr.Jit reads an array of one as a constant, in a kernel of its own.
        self._words, self._end = aligned(self.ROOM, WORD), 2
        self._words[:2] = 0
        self._placed: dict[str, tuple[int, int, int]] = {}

    def begin(self) -> None:
        """Begin a scene: where too much is kept, it is forgotten."""
        if self._end > self.MOST_KEPT:
            self._forget()

    def place(self, texture: Texture | None) -> tuple[int, int, int]:
        """Return (offset, width, height) of a texture's words, the highest bits of the width for what lies beyond it.

        Raises `BackendError` where it cannot be read.
        """
        if texture is None:
            return NONE, 1, 1
        if texture.image not in self._placed:
            words = _read_words(self._library.texture_path(texture.image))
            start, self._end = self._end, self._end + words.size
            if self._end > len(self._words):
                grown = aligned(self._end * 3 // 2, WORD)
                grown[:start] = self._words[:start]
                self._words = grown
            self._words[start : self._end] = words.ravel()
            self._placed[texture.image] = start, words.shape[1], words.shape[0]
        offset, width, height = self._placed[texture.image]
        return offset, width | WRAPS.index(texture.wrap) << WRAP_BIT, height

    def words(self) -> UInt32:
        """Return all words, red in the lowest byte, top rows first; what is added later changes none of them."""
        return self._words[: self._end]


def _read_words(path: Path) -> UInt32:
    try:
        with open_picture(path) as picture:
            rgba = np.asarray(picture.convert("RGBA"))
    except (OSError, ValueError, SyntaxError) as error:
        raise BackendError(f"cannot read image {path}: {error}; fetch or repair its asset") from error
    return np.ascontiguousarray(rgba).view(np.uint32)[..., 0]


def scene_arrays(scene: SceneSpec, rig: LightRig, library: AssetLibrary, textures: Textures) -> SceneArrays:
    """Flatten a scene; raises `BackendError` where an emissive light names no part of it, or an asset has changed."""
    materials = [material for body in scene.bodies for material in body.materials]
    glowing = glowing_parts(scene, rig)
    textures.begin()
    vertices: list[Float32] = []
    colors: list[Float32] = []
    coloured = False
    faces: list[UInt32] = []
    values, links = np.zeros(len(materials), VALUES), np.zeros(len(materials), LINKS)
    spans: dict[str, tuple[int, int]] = {}
    vertex = face = row = 0
    for number, body in enumerate(scene.bodies, start=1):
        first = face
        for part, mesh in enumerate(body_parts(body, library)):
            light = glowing.get((body.name, part))
            _write_surface(values[row], links[row], body.materials[part], light, textures)
            links[row]["body"] = number
            links[row]["glow"] = NONE if light is None else rig.names.index(light.name)
            vertices.append(_placed(mesh, np.array(body.world_from_body)))
            coloured |= mesh.colors is not None
            colors.append(np.ones((len(mesh.vertices), 3), np.float32) if mesh.colors is None else mesh.colors)
            surface = np.full((len(mesh.faces), 1), row, np.uint32)
            faces.append(np.concatenate([mesh.faces.astype(np.uint32) + np.uint32(vertex), surface], axis=1))
            vertex += len(mesh.vertices)
            face += len(mesh.faces)
            row += 1
        spans[body.name] = (first, face - first)
    return SceneArrays(
        vertices=np.concatenate(vertices),
        colors=np.concatenate(colors) if coloured else None,
        faces=np.concatenate(faces),
        spans=spans,
        values=values,
        links=links,
        texels=textures.words(),
        see_through=any(m.opacity < 1 or m.opacity_from_alpha for m in materials),
        glass=any(m.transmission > 0 for m in materials),
    )


def _placed(part: MeshPart, pose: Float64) -> Float32:
    """Place a part in the world: (V, 8) float32 position, unit normal, uv."""
    normals = part.normals @ np.linalg.inv(pose[:3, :3])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return np.concatenate([apply_pose(pose, part.vertices), normals, part.uv], axis=1).astype(np.float32)


def _write_surface(
    values: np.void, links: np.void, material: Material, light: EmissiveLight | None, textures: Textures
) -> None:
    """Fill a surface's row in with its material, and with the picture that it glows in."""
    numbers = ("opacity", "roughness", "metallic", "ior", "coat", "coat_roughness", "transmission", "alpha_cutoff")
    for name in ("base_color", *numbers):
        values[name] = getattr(material, name)
    links["opacity_from_alpha"] = material.opacity_from_alpha
    pictures = {
        "base_color": material.base_color_texture,
        "roughness": material.roughness_texture,
        "metallic": material.metallic_texture,
        "normal": material.normal_texture,
        "glow": None if light is None else light.texture,
    }
    for name, texture in pictures.items():
        values[f"{name}_repeat"] = (1.0, 1.0) if texture is None else texture.repeat
        links[f"{name}_texture"] = textures.place(texture)
