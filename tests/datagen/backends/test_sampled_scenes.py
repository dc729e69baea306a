"""Scenes of all kinds as they are drawn, without rendering: no overlap, everything carried, in frame, cameras free."""

import numpy as np
import pytest

from multilight.datagen.config.dataset import load_config
from multilight.datagen.config.presets import Preset
from multilight.datagen.production.scene import contact_faults, sample_scene
from multilight.lights.spec import EmissiveLight
from multilight.scenes.assets.fetch import is_fetched
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import focal_length_mm, matrix4, pixel_rays
from multilight.scenes.cameras.trajectory import SEEN, in_frame
from multilight.scenes.geometry.rays import SceneRays, surface_points
from multilight.scenes.random_streams import Streams
from multilight.scenes.spec import Body, SceneSpec
from tests.scenes.test_rooms import assert_cameras_free, loosened

COUNTS: dict[Preset, int] = {"room": 5, "tabletop": 8, "studio": 5, "outdoor": 5}
VIEWS = 8


def view_faults(scene: SceneSpec, library: AssetLibrary, *, share: float, lens: tuple[float, float]) -> list[str]:
    """Name what is wrong with the views; `share` is that of the views in which each insertable must be seen."""
    found = []
    rays = SceneRays(scene.bodies, library)
    rng = np.random.default_rng(0)
    for name in scene.insertable:
        index = scene.instance_id(name) - 1
        points = surface_points(scene.bodies[index], library, rng, 200)
        good = [
            in_frame(camera, points) and rays.visible_share(camera.pose()[:3, 3], index, points) > 0.5 * SEEN
            for camera in scene.cameras
        ]
        # Fewer points stood for the object when it was drawn: one view may differ.
        if sum(good) < share * len(good) - 1:
            found.append(f"{name} is seen in {sum(good)} of {len(good)} views")
    for number, camera in enumerate(scene.cameras):
        if not lens[0] - 0.1 <= focal_length_mm(camera) <= lens[1] + 0.1:
            found.append(f"view {number} has a lens of {focal_length_mm(camera):.0f} mm")
        small = camera.model_copy(update={"width": 8, "height": 8, "fx": camera.fx * 8 / camera.width,
                                          "fy": camera.fy * 8 / camera.height, "cx": 4.0, "cy": 4.0})  # fmt: skip
        origins, ways = (array.reshape(-1, 3) for array in pixel_rays(small))
        if rays.first_hit(origins, ways)[1].min() < 0.05:
            found.append(f"view {number} is blocked")
    return found


@pytest.mark.slow
def test_scenes_of_all_kinds_are_sound() -> None:
    library = AssetLibrary()
    if not is_fetched("sweethome3d", library.cache):
        pytest.skip("needs the pack sweethome3d; run `multilight assets fetch sweethome3d`")
    faults, lights, glows = [], set(), []
    for preset, count in COUNTS.items():
        config = load_config(None, {"seed": 31, "scenes": 1000, "views": VIEWS, "width": 96, "height": 72}, preset)
        for index in range(count):
            scene, rig = sample_scene(config, library, Streams(config.seed, index))
            found = view_faults(scene, library, share=config.cameras.min_visible_share, lens=config.cameras.lens_mm)
            if scene.kind == "room":
                scene = scene.model_copy(update={"bodies": tuple(loosened(scene))})
                assert_cameras_free(scene, library)
            found += [fault.message for fault in contact_faults(scene, library)]
            if not config.lights[0] <= len(rig.lights) <= config.lights[1]:
                found.append(f"{len(rig.lights)} lights")
            faults += [f"{preset} {index}: {fault}" for fault in found]
            lights.add(len(rig.lights))
            glowing = {light.body for light in rig.lights if isinstance(light, EmissiveLight)}
            glows.append(bool(glowing & set(scene.insertable)))
    assert faults == []
    assert len(lights) >= 5
    # All kinds draw from the streams of the same few indices: too few for the probability of a third.
    assert 0 < np.mean(glows) <= 0.6


def test_what_is_wrong_is_found() -> None:
    config = load_config(None, {"seed": 3, "scenes": 10, "views": VIEWS, "width": 96, "height": 72}, "studio")
    library = AssetLibrary(packs=("builtin",))
    scene, _ = sample_scene(config, library, Streams(3, 1))
    assert view_faults(scene, library, share=0.7, lens=(35.0, 85.0)) == []
    name = scene.insertable[0]
    lifted = [raised(body, 0.005) if body.name == name else body for body in scene.bodies]
    wrong = contact_faults(scene.model_copy(update={"bodies": tuple(lifted)}), library)
    assert [fault.message for fault in wrong] == [f"nothing carries {name}"]
    sunk = [raised(body, -0.004) if body.name == name else body for body in scene.bodies]
    wrong = contact_faults(scene.model_copy(update={"bodies": tuple(sunk)}), library)
    assert any("mm in each other" in fault.message for fault in wrong)
    high = [np.array(camera.c2w) + np.outer([0, 0, 9, 0], [0, 0, 0, 1]) for camera in scene.cameras]
    away = [c.model_copy(update={"c2w": matrix4(pose)}) for c, pose in zip(scene.cameras, high, strict=True)]
    found = view_faults(scene.model_copy(update={"cameras": tuple(away)}), library, share=0.7, lens=(35.0, 60.0))
    assert any("is seen in 0" in fault for fault in found)


def raised(body: Body, height: float) -> Body:
    """Lift a body [m]."""
    pose = np.array(body.world_from_body)
    pose[2, 3] += height
    return body.model_copy(update={"world_from_body": matrix4(pose)})
