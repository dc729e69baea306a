"""What every backend must do, as plain checks over a `render` function."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from multilight.datagen.backends.protocol import BackendError, RenderJob
from multilight.datagen.storage.layers import LayerStack
from multilight.lights.spec import Light, LightRig
from multilight.scenes.cameras.pinhole import pixel_rays, unproject
from multilight.scenes.spec import Body, Rectangle
from tests.datagen.backends.contract_scenes import (
    GLOW,
    GROUND,
    RIG,
    SIZE,
    SKY,
    irradiance,
    job,
    oblique_camera,
    overhead_camera,
    plate_scene,
    reference,
    still_life,
)

Render = Callable[[RenderJob], LayerStack]


@dataclass(frozen=True)
class Tolerance:
    """How far a backend may be off: `exact` for identities, `noise` between renders with other random numbers,
    `closed` from closed forms (relative), `edges` the share of pixels that may fall on the other side of an edge."""

    exact: float
    noise: float
    closed: float
    edges: float


# --- form ---


def check_shapes_and_types(render: Render, _: Tolerance) -> None:
    image = (SIZE, SIZE + 8)
    for variant in ("all", "without_near", "foreground_near"):
        stack = render(job(variant))
        assert stack.lights == RIG.names
        assert stack.radiance.shape == (len(RIG.lights), *image, 3)
        assert stack.combined.shape == (*image, 3)
        for array in (stack.radiance, stack.combined):
            assert array.dtype == np.float32
            assert np.isfinite(array).all()
            assert array.min() >= 0
        for guide in (stack.guide_albedo, stack.guide_normal):
            assert guide is None or (guide.shape == (*image, 3) and guide.dtype == np.float32)
    coverage = render(job("foreground_near")).coverage
    assert coverage is not None
    assert coverage.shape == image
    assert coverage.dtype == np.float32
    geometry = render(job()).geometry
    assert geometry is not None
    for name in ("z_depth", "roughness", "metallic", "environment"):
        array = getattr(geometry, name)
        assert array.shape == image, name
        assert array.dtype == np.float32, name
    assert geometry.normal_world.shape == geometry.albedo.shape == (*image, 3)
    assert geometry.instance_id.shape == image
    assert geometry.instance_id.dtype == np.uint16


def check_same_job_same_bytes(render_fresh: Render, _: Tolerance) -> None:
    first = render_fresh(job())
    render_fresh(job("foreground_far"))
    render_fresh(job(view=1))
    again = render_fresh(job())
    np.testing.assert_array_equal(first.radiance, again.radiance)
    np.testing.assert_array_equal(first.combined, again.combined)
    for name in vars(first.geometry):
        np.testing.assert_array_equal(getattr(first.geometry, name), getattr(again.geometry, name), err_msg=name)


def check_bad_jobs_are_refused(render: Render, _: Tolerance) -> None:
    for variant in ("without_ground", "without_nothing", "shadow_near", "", "all_near"):
        with pytest.raises(BackendError, match="near"):
            render(job(variant))
    for view in (-1, 2):
        with pytest.raises(BackendError, match=rf"view {view}\b"):
            render(job(view=view))


# --- light adds up ---


def check_layers_sum_to_combined(render: Render, tolerance: Tolerance) -> None:
    for variant in ("all", "without_near", "foreground_near"):
        stack = render(job(variant))
        scale = stack.combined + stack.combined.mean()
        assert (np.abs(stack.radiance.sum(axis=0) - stack.combined) / scale).max() < max(tolerance.exact, 1e-6)


def check_layers_scale_with_their_light(render: Render, tolerance: Tolerance) -> None:
    factor = np.array([2.0, 1.0, 0.5])
    keys = {"sky": "radiance", "sun": "irradiance", "point": "intensity", "spot": "intensity", "glow": "radiance"}
    changed = tuple(
        light.model_copy(update={keys[light.name]: tuple(np.array(getattr(light, keys[light.name])) * factor)})
        for light in RIG.lights
    )
    plain, scaled = render(job()), render(job(rig=LightRig(lights=changed)))
    for name, before, after in zip(RIG.names, plain.radiance, scaled.radiance, strict=True):
        assert before.mean() > 1e-3, f"{name} lights nothing"
        _assert_close(after, before * factor, tolerance.noise, name)


def check_each_light_alone_gives_its_layer(render: Render, tolerance: Tolerance) -> None:
    together = render(job())
    for i in (0, 2):
        alone = render(job(rig=LightRig(lights=(RIG.lights[i],))))
        _assert_close(alone.radiance[0], together.radiance[i], tolerance.noise, RIG.names[i])


# --- removing and keeping ---


def check_hidden_object_leaves_no_trace(render: Render, tolerance: Tolerance) -> None:
    """The ball under the ground neither shows nor shadows nor reflects: taking it away changes nothing."""
    everything, without = render(job()), render(job("without_under"))
    assert np.abs(everything.radiance - without.radiance).max() <= tolerance.exact
    alone = render(job("foreground_under"))
    assert alone.coverage is not None
    assert not alone.coverage.any()
    assert not alone.radiance.any()


def check_untouched_pixels_come_out_equal(render: Render, tolerance: Tolerance) -> None:
    """What cannot be reached by light from or past the object is the same: the environment seen directly."""
    everything, without = render(job()), render(job("without_near"))
    sky = render(job()).geometry.environment == 1
    assert sky.any()
    assert np.abs(everything.radiance - without.radiance)[:, sky].max() <= tolerance.exact
    sun = RIG.names.index("sun")
    assert (without.radiance[sun] - everything.radiance[sun]).max() > 0.05, "the shadow did not go"


def check_without_equals_a_scene_that_never_had_it(render: Render, tolerance: Tolerance) -> None:
    without, never = render(job("without_near")), render(job(scene=still_life(without="near")))
    for name, a, b in zip(RIG.names, without.radiance, never.radiance, strict=True):
        _assert_close(a, b, tolerance.noise, name)


def check_guides_know_what_was_removed(render: Render, tolerance: Tolerance) -> None:
    """What guides the denoiser must not show an object that is gone: its outline would come back as a ghost."""
    without, never = render(job("without_near")), render(job(scene=still_life(without="near")))
    everything = render(job())
    if without.guide_albedo is None:
        return
    for name in ("guide_albedo", "guide_normal"):
        gone, absent, present = (getattr(stack, name) for stack in (without, never, everything))
        assert np.abs(gone - absent).mean() < 0.3 * np.abs(gone - present).mean(), name


def check_foreground_is_the_object_alone(render: Render, tolerance: Tolerance) -> None:
    everything, seen = render(job()), reference(still_life(), oblique_camera())
    for name in ("near", "far"):
        stack = render(job(f"foreground_{name}"))
        assert stack.coverage is not None
        inside, outside = stack.coverage == 1, stack.coverage == 0
        mine = seen.ids == still_life().instance_id(name)
        assert stack.coverage.min() >= 0
        assert stack.coverage.max() <= 1
        assert inside[seen.inner & mine].mean() >= 1 - tolerance.edges
        assert outside[seen.inner & ~mine].all()
        assert stack.coverage.sum() == pytest.approx(mine.sum(), rel=0.05)
        scale = everything.radiance + everything.radiance.mean()
        excess = (stack.radiance - everything.radiance) / scale
        assert np.abs(excess[:, inside]).max() <= tolerance.exact
        assert excess.max() <= max(tolerance.exact, 1e-6), "an object cannot outshine the picture it is part of"
        assert not stack.radiance[:, outside].any()


# --- geometry ---


def check_geometry_matches_closed_form(render: Render, tolerance: Tolerance) -> None:
    scene, camera = still_life(), oblique_camera()
    geometry, seen = render(job()).geometry, reference(scene, camera)
    assert (geometry.instance_id == seen.ids).mean() >= 1 - tolerance.edges
    assert set(np.unique(geometry.instance_id)) <= set(range(len(scene.bodies) + 1))
    same = geometry.instance_id == seen.ids
    off = np.abs(geometry.z_depth - seen.z_depth)[same] / np.maximum(seen.z_depth[same], 1)
    assert np.quantile(off, 0.98) < 2e-3
    assert np.median(off) < 1e-4
    assert (geometry.z_depth[geometry.instance_id == 0] == 0).all()


def check_normals_and_albedo(render: Render, tolerance: Tolerance) -> None:
    scene, camera = still_life(), oblique_camera()
    geometry, seen = render(job()).geometry, reference(scene, camera)
    hit = geometry.instance_id > 0
    _, rays = pixel_rays(camera)
    np.testing.assert_allclose(np.linalg.norm(geometry.normal_world[hit], axis=-1), 1.0, atol=1e-3)
    assert np.sum(geometry.normal_world * rays, axis=-1)[hit].max() < 1e-3
    assert not geometry.normal_world[~hit].any()
    points = unproject(camera, seen.z_depth)
    for item in scene.bodies:
        mine = (geometry.instance_id == scene.instance_id(item.name)) & seen.inner
        if not mine.any():
            continue
        colour = np.broadcast_to(item.materials[0].base_color, (mine.sum(), 3))
        np.testing.assert_allclose(geometry.albedo[mine], colour, atol=2e-3)
        np.testing.assert_allclose(geometry.roughness[mine], 1.0, atol=2e-3)
        centre = np.array(item.world_from_body)[:3, 3]
        flat = isinstance(item.geometry, Rectangle)
        expected = np.array([0, 0, 1.0]) if flat else (points[mine] - centre) / item.geometry.radius
        assert np.abs(geometry.normal_world[mine] - expected).max() < 0.03
    assert not geometry.metallic.any()
    assert (seen.inner & hit).mean() > 0.3


def check_environment_mask(render: Render, _: Tolerance) -> None:
    environment = render(job()).geometry.environment
    seen = reference(still_life(), oblique_camera())
    assert (environment[seen.inner & (seen.ids == 0)] == 1).all()
    assert (environment[seen.inner & (seen.ids > 0)] == 0).all()
    assert environment.mean() == pytest.approx((seen.ids == 0).mean(), abs=0.01)
    assert environment.min() >= 0
    assert environment.max() <= 1


def check_what_the_camera_sees_of_lights(render: Render, tolerance: Tolerance) -> None:
    """The environment and glowing bodies show their radiance; no other light shows."""
    stack, seen = render(job()), reference(still_life(), oblique_camera())
    sky = seen.inner & (seen.ids == 0)
    bulb = seen.inner & (seen.ids == still_life().instance_id("bulb"))
    assert sky.any()
    assert bulb.any()
    np.testing.assert_allclose(stack.radiance[0][sky], np.tile(SKY.radiance, (sky.sum(), 1)), rtol=1e-3)
    np.testing.assert_allclose(stack.radiance[4][bulb], np.tile(GLOW.radiance, (bulb.sum(), 1)), rtol=1e-3)
    assert np.abs(stack.radiance[1:][:, sky]).max() <= tolerance.exact


# --- irradiance in closed form, on a plate that nothing else lights ---


def check_closed_form_irradiance(render: Render, tolerance: Tolerance, light: Light, *more: Body) -> None:
    stack = render(job(scene=plate_scene(*more), rig=LightRig(lights=(light,))))
    camera = overhead_camera()
    points = unproject(camera, np.full((SIZE, SIZE), 2.0))
    expected = np.array(GROUND.materials[0].base_color) / math.pi * irradiance(light, points)
    inner = slice(4, -4)
    got, want = stack.radiance[0][inner, inner], expected[inner, inner]
    assert want.max() > 1e-3
    _assert_close(got, want, tolerance.closed, light.kind)


def _assert_close(a: np.ndarray, b: np.ndarray, tolerance: float, name: str) -> None:
    """Compare two pictures: their channels' means, and the means of 8 x 8 blocks, where noise has averaged out."""
    tolerance = max(tolerance, 1e-5)  # float32 rounds
    a, b = a.astype(np.float64), b.astype(np.float64)
    assert a.mean(axis=(0, 1)) == pytest.approx(b.mean(axis=(0, 1)), rel=tolerance), name
    assert np.abs(_blocks(a) - _blocks(b)).mean() <= 2 * tolerance * b.mean(), name


def _blocks(picture: np.ndarray) -> np.ndarray:
    height, width, _ = picture.shape
    cut = picture[: height // 8 * 8, : width // 8 * 8]
    return cut.reshape(height // 8, 8, width // 8, 8, 3).mean(axis=(1, 3))
