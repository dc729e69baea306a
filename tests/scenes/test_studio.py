"""Studio scenes: on paper or plinths, before the backdrop, through longer lenses."""

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.collision import CollisionManager

from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import SENSOR_MM
from multilight.scenes.geometry.rays import SceneRays, body_triangles
from multilight.scenes.kinds.studio import LENS_MM, sample_studio
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import SceneSpec
from multilight.scenes.still_life.sample import StillLifeSettings

COUNT = 4


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def scenes(library: AssetLibrary) -> list[SceneSpec]:
    settings = StillLifeSettings(width=64, height=64, views=3)
    return [sample_studio(Streams(4, i), library, index=i, settings=settings) for i in range(COUNT)]


def test_what_is_there(scenes: list[SceneSpec]) -> None:
    assert len({body.geometry for s in scenes for body in s.bodies if body.name == "backdrop"}) > 1
    assert any(body.category == "plinth" for scene in scenes for body in scene.bodies)
    for scene in scenes:
        assert scene.kind == "studio"
        assert "backdrop" in [body.name for body in scene.bodies]
        assert len(scene.insertable) == 3
        assert 3 <= sum(body.role == "object" for body in scene.bodies) <= 6


def test_lenses_are_those_of_a_studio(scenes: list[SceneSpec]) -> None:
    for scene in scenes:
        for camera in scene.cameras:
            lens = camera.fx * SENSOR_MM / max(camera.width, camera.height)
            assert LENS_MM[0] * 0.99 <= lens <= LENS_MM[1] * 1.01


def test_objects_stand_on_something_and_keep_apart(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        others = [body for body in scene.bodies if body.role != "object"]
        rays = SceneRays(others, library)
        manager = CollisionManager()
        for body in scene.bodies:
            if body.role != "object" and body.category != "plinth":
                continue
            points = body_triangles(body, library)[0]
            lowest = points[points[:, 2] <= points[:, 2].min() + 1e-5]
            if body.role == "object":
                _, gap = rays.first_hit(lowest + [0, 0, 0.002], np.tile([0.0, 0.0, -1.0], (len(lowest), 1)))
                assert gap.min() >= 0.0019, (scene.index, body.name)
                assert gap.min() <= 0.0025, (scene.index, body.name)
            manager.add_object(body.name, Trimesh(*body_triangles(body, library), process=False))
        _, pairs = manager.in_collision_internal(return_names=True)
        assert not pairs


def test_same_streams_same_scene(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    settings = StillLifeSettings(width=64, height=64, views=3)
    assert sample_studio(Streams(4, 2), library, index=2, settings=settings).sha256() == scenes[2].sha256()
    assert sample_studio(Streams(5, 2), library, index=2, settings=settings).sha256() != scenes[2].sha256()
