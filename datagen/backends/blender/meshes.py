"""Blender meshes from arrays: parts of library meshes, spheres and rectangles."""

from collections.abc import Sequence

import bmesh
import bpy
import numpy as np

from multilight.scenes.meshes import MeshPart
from multilight.scenes.spec import Rectangle

UV_LAYER, COLORS = "uv", "colors"


def mesh_from_parts(name: str, parts: Sequence[MeshPart]) -> bpy.types.Mesh:
    """Join parts into one Blender mesh; part i gets material slot i. Shading normals are kept as given."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=True)])
    slots = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part.faces) for part in parts])
    vertices = np.concatenate([part.vertices for part in parts])
    mesh = _triangles(name, vertices, faces, np.concatenate([part.uv for part in parts]))
    mesh.polygons.foreach_set("material_index", slots)
    if any(part.colors is not None for part in parts):
        white = (np.ones((len(p.vertices), 3), np.float32) if p.colors is None else p.colors for p in parts)
        colors = np.concatenate(list(white))
        rgba = np.concatenate([colors, np.ones((len(colors), 1), np.float32)], axis=1)
        mesh.color_attributes.new(COLORS, "FLOAT_COLOR", "POINT").data.foreach_set("color", rgba.ravel())
    mesh.normals_split_custom_set_from_vertices(np.concatenate([part.normals for part in parts]))
    return mesh


def unit_sphere(name: str) -> bpy.types.Mesh:
    """Make a smooth sphere of radius 1 from 20,480 triangles, true to within 1e-4 of its radius."""
    grid = bmesh.new()
    bmesh.ops.create_icosphere(grid, subdivisions=6, radius=1.0)
    grid.verts.ensure_lookup_table()
    vertices = np.array([vertex.co for vertex in grid.verts], dtype=np.float32)
    faces = np.array([[vertex.index for vertex in face.verts] for face in grid.faces], dtype=np.int32)
    grid.free()
    uv = _longitude_latitude(vertices)
    # Let the faces' centroids lie as much inside the true sphere as the vertices lie outside.
    inner = np.linalg.norm(vertices[faces].mean(axis=1), axis=1).min()
    return _triangles(name, vertices / np.sqrt(inner), faces, uv)


def rectangle(name: str, shape: Rectangle) -> bpy.types.Mesh:
    """Make a rectangle that faces +Z, with uv in metres from its centre."""
    half = np.array([shape.width, shape.height], np.float32) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32) * half
    vertices = np.concatenate([corners, np.zeros((4, 1), np.float32)], axis=1)
    return _triangles(name, vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), corners)


def _longitude_latitude(directions: np.ndarray) -> np.ndarray:
    longitude = np.arctan2(directions[:, 1], directions[:, 0])
    latitude = np.arcsin(np.clip(directions[:, 2], -1, 1))
    return np.stack([longitude / (2 * np.pi) + 0.5, latitude / np.pi + 0.5], axis=1)


def _triangles(name: str, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> bpy.types.Mesh:
    mesh = bpy.data.meshes.new(name)
    corners = np.ascontiguousarray(faces, dtype=np.int32).ravel()
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, dtype=np.float32).ravel())
    mesh.loops.add(len(corners))
    mesh.loops.foreach_set("vertex_index", corners)
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, len(corners), 3, dtype=np.int32))
    layer = mesh.uv_layers.new(name=UV_LAYER)
    layer.uv.foreach_set("vector", np.ascontiguousarray(uv, dtype=np.float32)[corners].ravel())
    mesh.update(calc_edges=True)
    return mesh
