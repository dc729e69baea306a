"""Outdoor scenes: on a ground without walls that reaches the horizon, with furniture beside the objects."""

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.geometry.rays import SceneRays, body_triangles
from multilight.scenes.kinds.outdoor import GROUND, INSERTABLE, LONGEST, sample_outdoor
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Rectangle, SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings

COUNT = 4


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def scenes(library: AssetLibrary) -> list[SceneSpec]:
    settings = StillLifeSettings(width=64, height=64, views=3)
    return [sample_outdoor(Streams(4, i), library, index=i, settings=settings) for i in range(COUNT)]


def test_what_is_there(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        assert scene.kind == "outdoor"
        assert not [body for body in scene.bodies if body.category in ("wall", "backdrop")]
        assert len(scene.insertable) == 3
        ground = scene.body("ground")
        assert isinstance(ground.geometry, Rectangle)
        assert ground.geometry.width == GROUND
        assert ground.materials[0].base_color_texture is not None
        large = [b for b in scene.bodies if b.role == "surrounding" and b.geometry.shape == "mesh"]
        assert 1 <= len(large) <= 3
        for body in scene.bodies:
            if body.role == "object":
                longest = max(library.info(body.geometry.asset).size or (0,))
                assert LONGEST[0] <= longest <= LONGEST[1]
                assert longest >= INSERTABLE or not body.insertable


def test_horizon_is_at_eye_level(scenes: list[SceneSpec]) -> None:
    for scene in scenes:
        for camera in scene.cameras:
            eye = camera.pose()[:3, 3]
            edge = GROUND / 2 - np.linalg.norm(eye[:2])
            assert np.degrees(np.arctan(eye[2] / edge)) < 1.0


def test_things_stand_on_the_ground_and_keep_apart(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        flat = [body for body in scene.bodies if isinstance(body.geometry, Rectangle)]
        rays, manager = SceneRays(flat, library), CollisionManager()
        for body in scene.bodies:
            if body in flat:
                continue
            points = body_triangles(body, library)[0]
            lowest = points[points[:, 2] <= points[:, 2].min() + 1e-5]
            _, gap = rays.first_hit(lowest + [0, 0, 0.002], np.tile([0.0, 0.0, -1.0], (len(lowest), 1)))
            assert gap.min() >= 0.0019, (scene.index, body.name)
            assert gap.max() <= 0.0025, (scene.index, body.name)
            manager.add_object(body.name, Trimesh(*body_triangles(body, library), process=False).convex_hull)
        assert manager.min_distance_internal() >= 0.0035


def test_same_streams_same_scene(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    settings = StillLifeSettings(width=64, height=64, views=3)
    assert sample_outdoor(Streams(4, 1), library, index=1, settings=settings).sha256() == scenes[1].sha256()
