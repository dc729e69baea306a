import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from multilight.scenes.assets.builtin.pack import OBJECTS, builtin_mesh, builtin_models
from multilight.scenes.assets.builtin.primitives import (
    Surface,
    lathe,
    merge,
    prism,
    rotation,
    rounded,
    rounded_box,
    sphere,
    torus,
    tube,
)
from multilight.scenes.assets.builtin.textures import surfaces as textures
from multilight.scenes.assets.derived_maps import MEAN_ROUGHNESS

SHAPES = {
    "sphere": sphere(0.5),
    "torus": torus(0.4, 0.1),
    "box": rounded_box((0.3, 0.2, 0.1), 0.02),
    "tube": tube([(0, 0, 0), (0, 0, 0.2), (0.1, 0, 0.3)], 0.02),
    "prism": prism(rounded([(0, 0), (0.1, 0), (0, 0.1)], 0.01, closed=True), 0.05, 0.003),
    "lathe": lathe(rounded([(0, 0), (0.1, 0), (0.05, 0.2), (0, 0.2)], 0.01)),
    "fluted": lathe(rounded([(0, 0), (0.1, 0), (0.05, 0.2), (0, 0.2)], 0.01), lobes=8, depth=0.05),
}


def solid(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices.round(7), surface.faces, process=True)


@pytest.mark.parametrize("name", SHAPES)
def test_shapes_are_closed_and_face_outwards(name: str) -> None:
    mesh = solid(SHAPES[name])
    assert mesh.is_watertight
    assert mesh.volume > 0


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_unit_and_agree_with_the_faces(name: str) -> None:
    surface = SHAPES[name]
    assert np.allclose(np.linalg.norm(surface.normals, axis=1), 1, atol=1e-6)
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    cross = np.cross(b - a, c - a)
    cross /= np.linalg.norm(cross, axis=1, keepdims=True)
    along = np.einsum("fi,fci->fc", cross, surface.normals[surface.faces])
    assert along.min() > 0.5


def test_volumes_match_closed_forms() -> None:
    assert solid(sphere(0.5, segments=128)).volume == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=5e-3)
    assert solid(torus(0.4, 0.1, segments=128)).volume == pytest.approx(2 * np.pi**2 * 0.4 * 0.1**2, rel=5e-3)
    assert solid(lathe([(0, 0), (0.1, 0), (0.1, 0.3), (0, 0.3)], segments=256)).volume == pytest.approx(
        np.pi * 0.01 * 0.3, rel=1e-3
    )
    assert solid(rounded_box((0.3, 0.2, 0.1), 1e-5)).volume == pytest.approx(0.006, rel=1e-3)


def test_sphere_normals_are_exact() -> None:
    ball = sphere(0.5)
    assert np.allclose(ball.normals, (ball.vertices - [0, 0, 0.5]) / 0.5, atol=2e-2)


def test_uv_runs_in_metres() -> None:
    box = rounded_box((0.4, 0.3, 0.02), 0.002)
    top = box.normals[:, 2] > 0.999
    assert np.ptp(box.uv[top], axis=0) == pytest.approx([0.4, 0.3], rel=0.02)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(0.05, 0.4), min_size=3, max_size=3), st.floats(1e-4, 0.3))
def test_rounded_box_keeps_its_size(size: list[float], radius: float) -> None:
    box = rounded_box(size, radius)
    assert np.allclose(np.ptp(box.vertices, axis=0), size, atol=1e-9)
    assert box.vertices[:, 2].min() == pytest.approx(0, abs=1e-9)


def test_rounding_stays_inside_the_corners() -> None:
    line = rounded([(0, 0), (1, 0), (1, 1)], 0.25)
    assert np.linalg.norm(line - [0.75, 0.25], axis=1).min() == pytest.approx(0.25, abs=1e-9)
    assert line[0].tolist() == [0, 0]
    assert line[-1].tolist() == [1, 1]


def test_merge_and_moved() -> None:
    ball = sphere(0.1)
    pair = merge([ball, ball.moved((1, 0, 0), rotation("z", 0.3))])
    assert len(pair.faces) == 2 * len(ball.faces)
    assert pair.vertices[:, 0].max() == pytest.approx(1.1, abs=1e-3)


def test_every_builtin_model_is_sound() -> None:
    infos = builtin_models()
    assert len({info.id for info in infos}) == len(infos) > sum(model.variants for model in OBJECTS.values())
    for info in infos:
        mesh = builtin_mesh(info.id.removeprefix("builtin/"))
        low, high = mesh.bounds()
        assert abs(low[2]) < 1e-6, info.id
        assert np.abs((low + high)[:2]).max() < 1e-5, info.id
        assert all(np.isfinite(part.uv).all() and np.isfinite(part.normals).all() for part in mesh.parts), info.id
        if info.emissive_part is not None:
            assert info.emissive_part in [part.name for part in mesh.parts]
        if info.role == "table":
            assert mesh.parts[0].name == "top"
            assert mesh.parts[0].vertices[:, 2].max() == high[2]
            assert 0.8 <= max(high[0] - low[0], high[1] - low[1]) <= 1.6, info.id
        elif info.role == "object":
            assert 0.01 < (high - low).max() < 0.46, info.id


def test_builtin_models_are_the_same_every_time() -> None:
    assert builtin_mesh("vase-03").sha256() == builtin_mesh("vase-03").sha256()
    assert builtin_mesh("vase-03").sha256() != builtin_mesh("vase-04").sha256()


@pytest.mark.parametrize("name", textures.TEXTURES)
def test_textures_tile_and_repeat_exactly(name: str) -> None:
    albedo, normals, roughness = textures.make_texture(name, resolution=128)
    again, *_ = textures.make_texture(name, resolution=128)
    assert np.array_equal(albedo, again)
    assert albedo.shape == normals.shape == (128, 128, 3)
    assert albedo.std() > 1
    assert roughness.mean() / 255 == pytest.approx(MEAN_ROUGHNESS, abs=0.02)
    assert roughness.std() > 5
    for image in (
        albedo.astype(float),
        normals.astype(float),
        np.repeat(roughness[..., None], 3, axis=2).astype(float),
    ):
        for axis in (0, 1):
            seam = np.abs(np.take(image, 0, axis) - np.take(image, -1, axis)).mean()
            inside = np.abs(np.diff(image, axis=axis)).mean(axis=(1 - axis, 2)).max()
            assert seam <= 1.5 * inside + 1


def test_normal_map_of_a_slope() -> None:
    height = np.tile(np.sin(2 * np.pi * np.arange(64) / 64), (64, 1)) * 1e-3
    normals = textures.normal_map(height, metres=0.064) / 255.0 * 2 - 1
    assert normals[:, 0, 0].mean() < -0.05, "rising to the right leans to the left"
    assert np.abs(normals[..., 1]).max() < 0.01
    flipped = textures.normal_map(height.T, metres=0.064) / 255.0 * 2 - 1
    assert flipped[0, :, 1].mean() > 0.05, "rising down the image leans up: +Y"
