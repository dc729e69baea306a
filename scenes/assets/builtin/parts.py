"""What built-in objects are made of: parts, their colours and materials, and the mesh they make together."""

import numpy as np

from multilight.scenes.assets.builtin.primitives import Surface
from multilight.scenes.assets.derived_maps import MEAN_ROUGHNESS
from multilight.scenes.meshes import Mesh, MeshPart
from multilight.scenes.random_streams import Rng, pick
from multilight.scenes.spec import Material, Rgb, Texture

Part = tuple[Surface, Material]

GLAZES: tuple[Rgb, ...] = (
    (0.80, 0.78, 0.72), (0.07, 0.16, 0.24), (0.36, 0.09, 0.05), (0.10, 0.20, 0.12), (0.62, 0.38, 0.10),
    (0.03, 0.03, 0.035), (0.45, 0.55, 0.58), (0.55, 0.28, 0.22),
)  # fmt: skip
PAINTS: tuple[Rgb, ...] = (
    (0.60, 0.05, 0.03), (0.03, 0.13, 0.45), (0.75, 0.42, 0.03), (0.04, 0.28, 0.09), (0.70, 0.68, 0.63),
    (0.25, 0.08, 0.32),
)  # fmt: skip
METALS: tuple[Rgb, ...] = ((0.91, 0.92, 0.92), (0.95, 0.64, 0.54), (0.89, 0.72, 0.33), (0.56, 0.57, 0.58))
CLEAR_TINTS: tuple[Rgb, ...] = ((0.98, 0.99, 0.99), (0.85, 0.95, 0.90), (0.90, 0.95, 0.99), (0.97, 0.93, 0.88))
BOTTLE_TINTS: tuple[Rgb, ...] = ((0.98, 0.99, 0.99), (0.45, 0.78, 0.52), (0.82, 0.52, 0.20), (0.55, 0.74, 0.90))
PAPER = Material(name="paper", base_color=(0.78, 0.72, 0.60), roughness=0.9)
CERAMIC_TEXTURES = ("ceramic-speckled-cream", "ceramic-speckled-blue", "ceramic-speckled-stone")


def tiled(name: str, size: float) -> Texture:
    """Repeat a built-in texture every `size` metres over uv in metres."""
    return Texture(image=f"builtin/{name}", repeat=(1 / size, 1 / size))


def patterned(name: str, texture: str, size: float, roughness: float, *, coat: float = 0.0) -> Material:
    """Make a material of a built-in texture with its bumps and its roughness map, `size` metres a repeat."""
    return Material(
        name=name,
        base_color=(1, 1, 1),
        base_color_texture=tiled(texture, size),
        normal_texture=tiled(f"{texture}-normal", size),
        roughness=min(1.0, roughness / MEAN_ROUGHNESS),
        roughness_texture=tiled(f"{texture}-roughness", size),
        coat=coat,
    )


def ceramic(rng: Rng) -> Material:
    """Draw a glazed ceramic: plain, or speckled."""
    coat = float(rng.uniform(0.4, 1.0))
    roughness = float(rng.uniform(0.25, 0.55))
    if rng.random() < 0.5:
        return patterned("ceramic", pick(rng, CERAMIC_TEXTURES), 0.1, roughness, coat=coat)
    return Material(name="ceramic", base_color=pick(rng, GLAZES), roughness=roughness, coat=coat)


def glass(rng: Rng, tints: tuple[Rgb, ...] = CLEAR_TINTS) -> Material:
    """Draw a clear or tinted glass."""
    return Material(name="glass", base_color=pick(rng, tints), roughness=0.01, transmission=1.0, ior=1.5)


def metal(rng: Rng) -> Material:
    """Draw steel, copper, brass or zinc, polished to brushed."""
    roughness = float(rng.uniform(0.12, 0.38))
    return Material(name="metal", base_color=pick(rng, METALS), metallic=1.0, roughness=roughness)


def paint(rng: Rng, name: str = "paint") -> Material:
    """Draw a painted or plastic surface."""
    roughness, coat = float(rng.uniform(0.2, 0.5)), float(rng.choice([0.0, 0.6]))
    return Material(name=name, base_color=pick(rng, PAINTS), roughness=roughness, coat=coat)


def to_mesh(parts: list[Part]) -> Mesh:
    """Turn parts into a mesh that is centred in x and y and stands on z = 0."""
    points = np.concatenate([surface.vertices for surface, _ in parts])
    low, high = points.min(axis=0), points.max(axis=0)
    offset = np.array([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    made = []
    for surface, material in parts:
        vertices, normals, uv = (a.astype(np.float32) for a in (surface.vertices + offset, surface.normals, surface.uv))
        made.append(MeshPart(material.name, vertices, surface.faces.astype(np.int32), normals, uv, material))
    return Mesh(tuple(made))
