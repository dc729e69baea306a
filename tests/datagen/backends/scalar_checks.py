"""Checks of Mitsuba's scalar variant, run in a process of its own: a process has one variant.

    python -m tests.scalar_checks FOLDER

`FOLDER` is a cache for assets. Prints one line of JSON: what failed, by the check's name, empty where it passed.
"""

import json
import math
import sys
import traceback
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine import variants
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import EmissiveLight, EnvironmentLight, Light, LightRig, PointLight, SunLight
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import camera_from_fov, look_at, matrix4, unproject
from multilight.scenes.spec import Body, Camera, Material, Rectangle, SceneSpec, Texture
from tests.datagen.backends import backend_contract as contract
from tests.datagen.backends.contract_scenes import (
    BALLS,
    CLOSED_FORMS,
    GROUND,
    POINT,
    SIZE,
    SKY,
    SPOT,
    irradiance,
    oblique_camera,
    overhead_camera,
    placed,
    reference,
)
from tests.datagen.backends.test_contract import CHECKS

# What the vectorized variants keep too.
TOLERANCE = contract.Tolerance(exact=1e-6, noise=0.05, closed=0.02, edges=0.01)
SUN = SunLight(name="sun", direction=(0.3, 0.2, -1.0), irradiance=(1.0, 2.0, 3.0), angle=0.1)
Render = Callable[[RenderJob], LayerStack]


def _job(bodies: tuple[Body, ...], light: Light, camera: Camera, *, variant: str = "all", spp: int = 16) -> RenderJob:
    scene = SceneSpec(kind="spheres", index=2, bodies=bodies, cameras=(camera,))
    return RenderJob(scene, LightRig(lights=(light,)), RenderSettings(spp=spp, max_bounces=2, threads=2), 0, variant)


def _plate(material: Material, pose: np.ndarray, size: float = 1.0, name: str = "plate") -> Body:
    return Body(name=name, role="object", category="test", geometry=Rectangle(width=size, height=size),
                materials=(material,), world_from_body=matrix4(pose), insertable=True)  # fmt: skip


def _cameras() -> dict[str, Camera]:
    camera = oblique_camera()
    aside = camera.model_copy(update={"cx": camera.cx + 7.3, "cy": camera.cy - 4.6})
    oblong = aside.model_copy(update={"fx": camera.fx * 1.27, "fy": camera.fy * 0.9})
    return {
        "pinhole": camera,
        "off_centre": aside,
        "oblong": oblong,
        "lens": aside.model_copy(update={"aperture_radius": 0.05, "focus_distance": 2.2}),
    }


def check_rays_are_those_of_the_picture(name: str, render: Render) -> None:
    """Before a black scene the sky's layer is the sky times the share of samples that met nothing, sample by sample."""
    black = Material(base_color=(0, 0, 0), roughness=1.0, ior=1.0)
    bodies = tuple(b.model_copy(update={"materials": (black,)}) for b in (*BALLS, GROUND))
    camera = _cameras()[name]
    stack = render(_job(bodies, SKY, camera))
    assert stack.geometry is not None
    environment = stack.geometry.environment
    assert ((environment > 0) & (environment < 1)).sum() > 30
    expected = environment[..., None] * np.array(SKY.radiance)
    wrong = np.abs(stack.radiance[0] - expected).max(axis=-1) > 1e-5
    assert wrong.mean() < 2e-3, f"{wrong.sum()} pixels differ"
    seen = reference(_job(bodies, SKY, camera).scene, camera)
    assert (stack.geometry.instance_id == seen.ids).mean() > 0.99
    if name != "lens":
        assert (environment[seen.inner] == (seen.ids == 0)[seen.inner]).all()


def check_texture_lies_where_the_buffers_say(render: Render) -> None:
    """A glowing picture seen by the camera is the picture that the albedo shows."""
    picture = Texture(image="builtin/wood-ash", repeat=(1.3, 0.7))
    material = Material(base_color=(1, 1, 1), base_color_texture=picture, roughness=1.0, ior=1.0)
    plate = _plate(material, np.eye(4), 1.6)
    light = EmissiveLight(name="glow", body="plate", radiance=(1.0, 2.0, 3.0), texture=picture)
    camera = camera_from_fov(look_at((0.2, -0.5, 1.5), (0, 0, 0)), width=SIZE, height=SIZE, fov=math.radians(30))
    stack = render(_job((plate,), light, camera))
    assert stack.guide_albedo is not None
    assert stack.guide_albedo.std() > 0.05
    own = stack.radiance[0] / np.array([1.0, 2.0, 3.0])
    assert np.abs(own - stack.guide_albedo).mean() < 2e-3


def check_bumps_lie_where_the_buffers_say(render: Render) -> None:
    """A bumpy plate under a sun is lit as the normals say, sample by sample."""
    bumps = Texture(image="builtin/weave-basket-normal", repeat=(0.15, 0.1))
    plate = _plate(Material(base_color=(0.5,) * 3, roughness=1.0, ior=1.0, normal_texture=bumps), np.eye(4), 1.6)
    light = SUN.model_copy(update={"angle": 0.0, "direction": (0.7, 0.4, -1.0)})
    camera = camera_from_fov(look_at((0.0, 0.0, 1.5), (0, 0, 0), up=(0, 1, 0)), width=SIZE, height=SIZE, fov=0.5)
    stack = render(_job((plate,), light, camera))
    assert stack.guide_normal is not None
    towards = -np.array(light.direction) / np.linalg.norm(light.direction)
    expected = 0.5 / math.pi * np.maximum(stack.guide_normal @ towards, 0)[..., None] * np.array(light.irradiance)
    relief = expected.std(axis=(0, 1))
    assert relief.min() > 1e-3
    assert (np.abs(stack.radiance[0] - expected).mean(axis=(0, 1)) < 0.05 * relief).all()


def check_see_through_plate_passes_its_share(render: Render) -> None:
    """A quarter of the light stays in a plate of a quarter's opacity, and it covers a quarter of what it hides."""
    black = Material(base_color=(0, 0, 0), roughness=1.0, ior=1.0, opacity=0.25)
    pane = _plate(black, placed(0, 0, 1.0), 4.0)
    sun = SUN.model_copy(update={"direction": (0.0, 0.0, -1.0), "angle": 0.0})
    camera = overhead_camera()
    bare = render(_job((GROUND,), sun, camera, spp=64)).radiance[0].mean(axis=(0, 1))
    jobs = [_job((GROUND, pane), sun, camera, variant=v, spp=64) for v in ("all", "foreground_plate")]
    everything, foreground = (render(j) for j in jobs)
    np.testing.assert_allclose(everything.radiance[0].mean(axis=(0, 1)), bare * 0.75**2, rtol=0.02)
    assert foreground.coverage is not None
    assert foreground.coverage.mean() == pytest.approx(0.25, rel=0.03)
    assert everything.geometry is not None
    assert (everything.geometry.instance_id == 1).all()
    assert not everything.geometry.environment.any()


def check_lamps_are_neither_seen_nor_in_the_way(name: str, render: Render) -> None:
    """A lamp right before the camera leaves the ground's picture as its closed form has it."""
    lamps: dict[str, Light] = {
        "bulb": PointLight(name="bulb", position=(0, 0, 1.0), intensity=(1, 2, 3), radius=0.05),
        "profile": POINT.model_copy(update={"position": (0, 0, 1.0), "profile": (0.2, 1.0, 0.4)}),
        "spot": SPOT.model_copy(update={"position": (0, 0, 1.0), "radius": 0.02, "direction": (0.1, 0, -1.0)}),
    }
    light = lamps[name]
    camera = overhead_camera()
    got = render(_job((GROUND,), light, camera)).radiance[0]
    ground = unproject(camera, np.full((SIZE, SIZE), 2.0))
    want = np.array(GROUND.materials[0].base_color) / math.pi * irradiance(light, ground)
    contract._assert_close(got[4:-4, 4:-4], want[4:-4, 4:-4], 0.03, name)


def check_sun_disc_is_even(render: Render) -> None:
    got = render(_job((GROUND,), SUN, overhead_camera())).radiance[0].mean(axis=(0, 1))
    cosine = -SUN.direction[2] / math.hypot(*SUN.direction)
    want = np.array(GROUND.materials[0].base_color) / math.pi * np.array(SUN.irradiance) * cosine
    np.testing.assert_allclose(got, want, rtol=0.01)


def check_sheet_glows_on_both_sides(render: Render) -> None:
    black = Material(base_color=(0, 0, 0), roughness=1.0, ior=1.0)
    light = EmissiveLight(name="glow", body="plate", radiance=(1.0, 2.0, 3.0))
    for height in (1.0, -1.0):
        pose = look_at((0, 0, height), (0, 0, 0), up=(0, 1, 0))
        camera = camera_from_fov(pose, width=16, height=16, fov=0.5)
        stack = render(_job((_plate(black, np.eye(4)),), light, camera, spp=1))
        np.testing.assert_allclose(stack.radiance[0], np.broadcast_to(light.radiance, (16, 16, 3)), rtol=1e-5)


def check_light_goes_with_its_body(render: Render) -> None:
    grey = Material(base_color=(0.5, 0.5, 0.5), roughness=1.0, ior=1.0)
    lamp = _plate(grey, placed(0, 0, 0.5), 0.2, name="lamp")
    light = EmissiveLight(name="glow", body="lamp", radiance=(1.0, 2.0, 3.0))
    jobs = [_job((GROUND, lamp), light, overhead_camera(), variant=v, spp=1) for v in ("all", "without_lamp")]
    everything, without = (render(j) for j in jobs)
    assert everything.radiance.any()
    assert not without.radiance.any()


def check_threads_change_nothing(render: Render) -> None:
    plain = _job((GROUND, *BALLS), SKY, oblique_camera(), variant="without_near", spp=2)
    alone = replace(plain, settings=plain.settings.model_copy(update={"threads": 1}))
    np.testing.assert_array_equal(render(plain).radiance, render(alone).radiance)


def check_white_furnace_keeps_its_light(render: Render) -> None:
    """A white plate under an even sky, lit from everywhere, looks like the sky."""
    white = Material(base_color=(1, 1, 1), roughness=1.0, ior=1.0)
    sky = EnvironmentLight(name="sky", radiance=(0.2, 0.3, 0.4))
    stack = render(_job((_plate(white, np.eye(4), 4.0),), sky, overhead_camera(), spp=64))
    np.testing.assert_allclose(stack.radiance[0].mean(axis=(0, 1)), sky.radiance, rtol=5e-3)


def all_checks(render: Render, fresh: Render) -> dict[str, Callable[[], None]]:
    """List the contract's checks and those of this file by name."""
    checks: dict[str, Callable[[], None]] = {c.__name__: partial(c, render, TOLERANCE) for c in CHECKS}
    checks["check_same_job_same_bytes"] = partial(contract.check_same_job_same_bytes, fresh, TOLERANCE)
    for kind, (light, bodies) in CLOSED_FORMS.items():
        checks[f"light_{kind}"] = partial(contract.check_closed_form_irradiance, render, TOLERANCE, light, *bodies)
    for name in _cameras():
        checks[f"rays_{name}"] = partial(check_rays_are_those_of_the_picture, name, render)
    for name in ("bulb", "profile", "spot"):
        checks[f"lamp_{name}"] = partial(check_lamps_are_neither_seen_nor_in_the_way, name, render)
    own = (
        check_texture_lies_where_the_buffers_say,
        check_bumps_lie_where_the_buffers_say,
        check_see_through_plate_passes_its_share,
        check_sun_disc_is_even,
        check_sheet_glows_on_both_sides,
        check_light_goes_with_its_body,
        check_threads_change_nothing,
        check_white_furnace_keeps_its_light,
    )
    return checks | {check.__name__: partial(check, render) for check in own}


def _fault(check: Callable[[], None]) -> str:
    try:
        check()
    except Exception:
        return traceback.format_exc()
    return ""


def main(folder: Path) -> None:
    """Run every check and print what failed."""
    variants.choose_variant = lambda: variants.Choice("scalar_rgb", "a test asks for it")  # type: ignore[assignment]
    kept: dict[tuple[str, str, str, int, str], LayerStack] = {}
    with open_backend("mitsuba", AssetLibrary(cache=folder)) as backend:

        def render(job: RenderJob) -> LayerStack:
            key = (job.scene.sha256(), job.rig.sha256(), job.settings.sha256(), job.view, job.variant)
            if key not in kept:
                kept[key] = backend.render(job)
            return kept[key]

        checks = all_checks(render, backend.render)
        print(json.dumps({name: _fault(check) for name, check in checks.items()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
