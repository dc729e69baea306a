"""The contract that every backend keeps; `tests/datagen/backends/backend_contract.py` holds the checks."""

import importlib.util
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from multilight.datagen.backends.analytic import AnalyticBackend
from multilight.datagen.backends.choose import open_backend
from multilight.datagen.backends.machine.mitsuba_variant import choose_variant
from multilight.datagen.backends.protocol import Backend, BackendError, RenderJob
from multilight.datagen.storage.layers import LayerStack
from multilight.scenes.assets.library import AssetLibrary
from multilight.scenes.cameras.pinhole import ray_distance_from_z_depth
from tests.datagen.backends import backend_contract as contract
from tests.datagen.backends.contract_scenes import CLOSED_FORMS

TOLERANCES = {
    "analytic": contract.Tolerance(exact=0.0, noise=0.0, closed=0.01, edges=0.0),
    "cycles": contract.Tolerance(exact=1e-6, noise=0.05, closed=0.02, edges=0.01),
    "mitsuba": contract.Tolerance(exact=1e-6, noise=0.05, closed=0.02, edges=0.01),
}
CHECKS = [
    contract.check_shapes_and_types,
    contract.check_bad_jobs_are_refused,
    contract.check_layers_sum_to_combined,
    contract.check_layers_scale_with_their_light,
    contract.check_each_light_alone_gives_its_layer,
    contract.check_hidden_object_leaves_no_trace,
    contract.check_untouched_pixels_come_out_equal,
    contract.check_without_equals_a_scene_that_never_had_it,
    contract.check_guides_know_what_was_removed,
    contract.check_foreground_is_the_object_alone,
    contract.check_geometry_matches_closed_form,
    contract.check_normals_and_albedo,
    contract.check_environment_mask,
    contract.check_what_the_camera_sees_of_lights,
]
UNSUPPORTED = {
    "analytic": {"area", "disk", "profile", "profile_aside", "profile_up", "gobo"},
    "cycles": set(),
    "mitsuba": set(),
}


class Subject:
    """A backend under test; `render` keeps what it has rendered, `backend.render` does not."""

    def __init__(self, name: str, backend: Backend) -> None:
        self.name, self.backend, self.tolerance = name, backend, TOLERANCES[name]
        self._kept: dict[tuple[object, ...], LayerStack] = {}

    def render(self, job: RenderJob) -> LayerStack:
        key = (job.scene.sha256(), job.rig.sha256(), job.settings.sha256(), job.view, job.variant)
        if key not in self._kept:
            self._kept[key] = self.backend.render(job)
        return self._kept[key]


@pytest.fixture(scope="module", params=sorted(TOLERANCES))
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    if request.param == "cycles" and importlib.util.find_spec("bpy") is None:
        pytest.skip("the package bpy is not installed")
    if request.param == "mitsuba" and choose_variant().variant is None:
        pytest.skip(f"Mitsuba cannot run here: {choose_variant().why}")
    with open_backend(request.param, AssetLibrary(packs=("builtin",))) as backend:
        yield Subject(request.param, backend)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__.removeprefix("check_"))
def test_contract(subject: Subject, check: Callable[..., None]) -> None:
    check(subject.render, subject.tolerance)


def test_same_job_same_bytes(subject: Subject) -> None:
    contract.check_same_job_same_bytes(subject.backend.render, subject.tolerance)


@pytest.mark.parametrize("kind", CLOSED_FORMS)
def test_closed_form_irradiance(subject: Subject, kind: str) -> None:
    light, bodies = CLOSED_FORMS[kind]
    if kind in UNSUPPORTED[subject.name]:
        with pytest.raises(BackendError, match=light.name):
            contract.check_closed_form_irradiance(subject.render, subject.tolerance, light, *bodies)
    else:
        contract.check_closed_form_irradiance(subject.render, subject.tolerance, light, *bodies)


def test_backend_is_named(subject: Subject) -> None:
    assert subject.backend.name == subject.name


# --- the contract can fail: each fault below must be caught by the check beside it ---


def _geometry(stack: LayerStack, **changes: np.ndarray) -> LayerStack:
    return replace(stack, geometry=stack.geometry and replace(stack.geometry, **changes))


def _ray_distance(stack: LayerStack, job: RenderJob) -> LayerStack:
    if stack.geometry is None:
        return stack
    return _geometry(stack, z_depth=ray_distance_from_z_depth(job.scene.cameras[job.view], stack.geometry.z_depth))


FAULTS = {
    "swapped_channels": (contract.check_normals_and_albedo, lambda s, j: s.geometry and _geometry(
        s, albedo=s.geometry.albedo[..., ::-1])),
    "ray_distance_for_z_depth": (contract.check_geometry_matches_closed_form, _ray_distance),
    "filtered_ids": (contract.check_geometry_matches_closed_form, lambda s, j: s.geometry and _geometry(
        s, instance_id=s.geometry.instance_id // 2 + np.roll(s.geometry.instance_id, 1) // 2)),
    "flipped_normals": (contract.check_normals_and_albedo, lambda s, j: s.geometry and _geometry(
        s, normal_world=-s.geometry.normal_world)),
    "inverted_mask": (contract.check_environment_mask, lambda s, j: s.geometry and _geometry(
        s, environment=1 - s.geometry.environment)),
    "shifted_mask": (contract.check_environment_mask, lambda s, j: s.geometry and _geometry(
        s, environment=np.roll(s.geometry.environment, 3, axis=0))),
    "tone_mapped_layers": (contract.check_layers_scale_with_their_light, lambda s, j: replace(
        s, radiance=s.radiance / (1 + s.radiance))),
    "lost_light": (contract.check_layers_sum_to_combined, lambda s, j: replace(s, combined=s.radiance[1:].sum(0))),
    "straight_alpha": (contract.check_foreground_is_the_object_alone, lambda s, j: s if s.coverage is None else (
        replace(s, radiance=s.radiance / np.maximum(s.coverage, 0.05)[..., None]))),
    "double_precision": (contract.check_shapes_and_types, lambda s, j: replace(
        s, radiance=s.radiance.astype(np.float64))),
    "noise": (contract.check_hidden_object_leaves_no_trace, lambda s, j: replace(
        s, radiance=s.radiance * (1 + 1e-3 * len(j.variant)))),
    "nothing_removed": (contract.check_without_equals_a_scene_that_never_had_it, None),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_contract_catches(name: str) -> None:
    check, spoil = FAULTS[name]
    backend = AnalyticBackend()

    def render(job: RenderJob) -> LayerStack:
        if spoil is None:
            return backend.render(replace(job, variant="all" if job.variant.startswith("without") else job.variant))
        stack = backend.render(job)
        return spoil(stack, job) or stack

    with pytest.raises(AssertionError):
        check(render, TOLERANCES["cycles"])


@pytest.mark.parametrize("kind", ["sun", "point", "spot", "environment", "emissive"])
def test_contract_catches_a_light_too_strong(kind: str) -> None:
    light, bodies = CLOSED_FORMS[kind]

    def render(job: RenderJob) -> LayerStack:
        stack = AnalyticBackend().render(job)
        return replace(stack, radiance=stack.radiance * np.float32(1.05))

    with pytest.raises(AssertionError):
        contract.check_closed_form_irradiance(render, TOLERANCES["cycles"], light, *bodies)
