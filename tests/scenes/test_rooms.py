"""Rooms: nothing lies in anything, everything is carried, cameras stand free, doors open, light comes in by windows."""

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.creation import box

from multilight.lights.rigs.rooms import MOST_LIGHTS, room_rig
from multilight.lights.rigs.sample import sample_rig
from multilight.lights.spec import AreaLight, EmissiveLight, EnvironmentLight, SpotLight, SunLight
from multilight.scenes.assets.builtin.joinery import EAR, SILL
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.paths import CameraSettings, TrajectoryShares
from multilight.scenes.cameras.pinhole import focal_length_mm
from multilight.scenes.cameras.trajectory import in_frame
from multilight.scenes.geometry.contact import check_contacts
from multilight.scenes.geometry.rays import SceneRays, body_triangles, surface_points
from multilight.scenes.kinds.rooms.sample import RoomSettings, RoomWeights, sample_room
from multilight.scenes.kinds.rooms.shelves import find_shelves
from multilight.scenes.materials import GLOW
from multilight.scenes.meshes import Mesh, MeshPart
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, Material, MeshAsset, SceneSpec

BUILDING = frozenset({"window", "door", "curtains", "rug"})
"""Categories that belong to the building, or lie flat: they carry, and need no check of what carries them."""
SETTINGS = RoomSettings(width=96, height=64, views=8)


@pytest.fixture(scope="module")
def library() -> AssetLibrary:
    return AssetLibrary(packs=("builtin",))


@pytest.fixture(scope="module")
def scenes(library: AssetLibrary) -> list[SceneSpec]:
    return [sample_room(Streams(5, i), library, index=i, settings=SETTINGS) for i in range(5)]


def furniture(scene: SceneSpec) -> list[Body]:
    return [body for body in scene.bodies if isinstance(body.geometry, MeshAsset)]


def loosened(scene: SceneSpec) -> list[Body]:
    """Return a room's bodies with its furniture as objects, which must be carried too."""
    return [
        body.model_copy(update={"role": "object"})
        if isinstance(body.geometry, MeshAsset) and body.category not in BUILDING
        else body
        for body in scene.bodies
    ]


def assert_sound(scene: SceneSpec, library: AssetLibrary) -> None:
    """Check a scene with the exact contact check."""
    report = check_contacts(loosened(scene), library)
    assert not report.overlaps, report.overlaps
    assert not report.unsupported, report.unsupported


def assert_seen(scene: SceneSpec, library: AssetLibrary) -> None:
    """Check that each insertable object is whole and visible in most views."""
    rays = SceneRays(scene.bodies, library)
    rng = np.random.default_rng(0)
    for name in scene.insertable:
        index = scene.instance_id(name) - 1
        points = surface_points(scene.bodies[index], library, rng, 80)
        good = [
            in_frame(camera, points) and rays.visible_share(camera.pose()[:3, 3], index, points) > 0.15
            for camera in scene.cameras
        ]
        assert np.mean(good) >= 0.6, (name, good)


def assert_cameras_free(scene: SceneSpec, library: AssetLibrary) -> None:
    """Check that each camera stands in the room, 10 cm from everything."""
    low, high = room_bounds(scene, library)
    for camera in scene.cameras:
        eye = camera.pose()[:3, 3]
        local = into_room(scene, eye[None])[0]
        assert (local[:2] > low + 0.1).all()
        assert (local[:2] < high - 0.1).all()
        for body in furniture(scene):
            corners = into_room(scene, body_triangles(body, library)[0])
            inside = (local > corners.min(axis=0) - 0.1) & (local < corners.max(axis=0) + 0.1)
            assert not inside.all(), body.name


def into_room(scene: SceneSpec, points: np.ndarray) -> np.ndarray:
    """Turn points into the room's own axes (its south wall's)."""
    pose = np.array(scene.body("wall_south_0").world_from_body)
    return points @ pose[:3, [0, 2, 1]]


def room_bounds(scene: SceneSpec, library: AssetLibrary) -> tuple[np.ndarray, np.ndarray]:
    boards = [body for body in scene.bodies if body.category == "skirting"]
    corners = np.concatenate([into_room(scene, body_triangles(body, library)[0]) for body in boards])[:, :2]
    return corners.min(axis=0), corners.max(axis=0)


def test_nothing_overlaps_and_everything_is_carried(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes[:2]:
        assert_sound(scene, library)


def test_insertable_objects_are_seen(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        assert len(scene.insertable) == 3
        assert scene.kind == "room"
        assert len(scene.cameras) == 8
        assert_seen(scene, library)


def test_cameras_stand_free(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        assert_cameras_free(scene, library)


def test_doors_can_be_reached(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    for scene in scenes:
        door = next(body for body in scene.bodies if body.category == "door")
        door_from_world = np.linalg.inv(np.array(door.world_from_body))
        for body in furniture(scene):
            if body.role == "object" or body.category in BUILDING:
                continue
            points = body_triangles(body, library)[0] @ door_from_world[:3, :3].T + door_from_world[:3, 3]
            blocked = (
                (np.abs(points[:, 0]) < 0.4) & (points[:, 1] > -0.85) & (points[:, 2] > 0.05) & (points[:, 2] < 2.0)
            )
            assert not blocked.any(), body.name


def test_light_comes_in_by_windows_only(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    rng = np.random.default_rng(1)
    ways = rng.normal(size=(20000, 3))
    for scene in scenes:
        eye = scene.cameras[0].pose()[:3, 3]
        hit, _ = SceneRays(scene.bodies, library).first_hit(np.broadcast_to(eye, ways.shape), ways)
        out = ways[hit < 0]
        assert 0 < len(out) < 6000
        through = np.zeros(len(out), bool)
        for window in (body for body in scene.bodies if body.category == "window"):
            pose = np.array(window.world_from_body)
            start, way = (eye - pose[:3, 3]) @ pose[:3, :3], out @ pose[:3, :3]
            reach = -start[1] / np.where(way[:, 1] > 1e-9, way[:, 1], np.nan)
            place = start + reach[:, None] * way
            assert isinstance(window.geometry, MeshAsset)
            high = library.mesh(window.geometry.asset).bounds()[1]
            inside = (
                (np.abs(place[:, 0]) < high[0] - EAR + 0.001) & (place[:, 2] > SILL - 0.001) & (place[:, 2] < high[2])
            )
            through |= inside
        assert through.all()


def test_same_streams_give_the_same_room(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    again = sample_room(Streams(5, 1), AssetLibrary(packs=("builtin",)), index=1, settings=SETTINGS)
    assert again.sha256() == scenes[1].sha256()


def test_kinds_of_room_follow_their_weights(library: AssetLibrary) -> None:
    only = SETTINGS.model_copy(update={"rooms": RoomWeights(living=0, kitchen=0, bedroom=0, study=1)})
    scene = sample_room(Streams(5, 9), library, index=9, settings=only)
    assert any(body.category in ("desk", "trestle", "bistro") for body in scene.bodies)
    with pytest.raises(ValueError, match="at least one of living, kitchen"):
        RoomWeights(living=0, kitchen=0, bedroom=0, study=0)


def test_rigs_light_rooms(scenes: list[SceneSpec], library: AssetLibrary) -> None:
    kinds: set[str] = set()
    for scene in scenes:
        for seed in range(8):
            rig = room_rig(Streams(seed, scene.index), scene, library)
            assert 1 <= len(rig.lights) <= MOST_LIGHTS
            kinds |= {light.kind for light in rig.lights}
            for light in rig.lights:
                if isinstance(light, EmissiveLight):
                    assert scene.body(light.body).materials[light.part].name == GLOW
                elif isinstance(light, SunLight):
                    assert light.direction[2] < 0
                else:
                    assert isinstance(light, EnvironmentLight | SpotLight | AreaLight)
    assert {"environment", "sun", "emissive", "spot"} <= kinds


@pytest.mark.parametrize("wanted", [(1, 1), (3, 3), (8, 8)])
def test_rigs_of_rooms_keep_to_the_number_of_lights(
    scenes: list[SceneSpec], library: AssetLibrary, wanted: tuple[int, int]
) -> None:
    for scene in scenes[:3]:
        rig = room_rig(Streams(2, scene.index), scene, library, lights=wanted)
        assert len(rig.lights) == wanted[0]
        low, high = room_bounds(scene, library)
        for light in rig.lights:
            if isinstance(light, SpotLight):
                place = into_room(scene, np.array(light.position)[None])[0]
                outside = (place[:2] <= low) | (place[:2] >= high)
                assert not outside.any(), "a lamp behind a wall lights nothing"
    many = [sample_rig(Streams(s, scenes[0].index), scenes[0], library, lights=(2, 4)) for s in range(6)]
    assert {len(rig.lights) for rig in many} == {2, 3, 4}


@pytest.mark.parametrize("kind", ["orbit", "handheld", "random"])
def test_cameras_of_rooms_follow_their_settings(library: AssetLibrary, kind: str) -> None:
    shares = dict.fromkeys(("approach", "orbit", "handheld", "random"), 0.0) | {kind: 1.0}
    cameras = CameraSettings(
        trajectories=TrajectoryShares(**shares), lens_mm=(28.0, 40.0), min_visible_share=0.9, depth_of_field=1.0
    )
    scene = sample_room(Streams(6, 1), library, index=1, settings=SETTINGS.model_copy(update={"cameras": cameras}))
    assert all(27.9 < focal_length_mm(camera) < 40.1 for camera in scene.cameras)
    assert all(camera.aperture_radius > 0 for camera in scene.cameras)
    eyes = np.array([camera.pose()[:3, 3] for camera in scene.cameras])
    steps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
    spread = np.ptp(eyes, axis=0).max()
    if kind == "handheld":
        assert spread < 0.35
    else:
        assert spread > 0.3
    if kind == "orbit":
        assert steps.max() < 3 * steps.min() + 0.05


def cabinet(*, shut: bool) -> Mesh:
    """Make a case of 0.8 x 0.3 x 1.2 m, open before, with boards in it; `shut` puts a door before the lowest."""
    sides = [((0.02, 0.3, 1.2), (x, 0, 0.6)) for x in (-0.39, 0.39)]
    boards = [((0.76, 0.28, 0.02), (0, -0.005, z)) for z in (0.03, 0.41, 0.8)]
    shells = [*sides, *boards, ((0.8, 0.02, 1.2), (0, 0.16, 0.6)), ((0.8, 0.34, 0.02), (0, 0, 1.21))]
    shells += [((0.8, 0.02, 0.4), (0, -0.17, 0.2))] if shut else []
    parts = []
    for size, place in shells:
        solid: Trimesh = box(size)
        solid.apply_translation(place)
        vertices = np.asarray(solid.vertices, np.float32)
        faces = np.asarray(solid.faces, np.int32)
        parts.append(MeshPart("part", vertices, faces, np.zeros_like(vertices), vertices[:, :2].copy(), Material()))
    return Mesh(tuple(parts))


def test_shelves_are_found_where_they_are_open() -> None:
    heights = [round(shelf.surface.height, 2) for shelf in find_shelves(cabinet(shut=False))]
    assert heights == [0.04, 0.42, 0.81, 1.22]
    rooms = [shelf.headroom for shelf in find_shelves(cabinet(shut=False))]
    assert rooms[:3] == pytest.approx([0.36, 0.37, 0.39], abs=0.01)
    assert np.isinf(rooms[3])
    shut = [round(shelf.surface.height, 2) for shelf in find_shelves(cabinet(shut=True))]
    assert shut == [0.42, 0.81, 1.22]
