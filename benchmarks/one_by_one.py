"""Cycles as other pipelines use it: one render for each lighting condition, with its own denoiser."""

from typing import Any, Protocol

import bpy
import numpy as np

from multilight.datagen.backends.blender.backend import BlenderBackend, hidden
from multilight.datagen.backends.blender.film import beauty_filter, render_passes
from multilight.datagen.backends.blender.scene import place_camera
from multilight.datagen.backends.protocol import RenderJob, RenderSettings
from multilight.lights.spec import LightingCondition, LightRig
from multilight.scenes.arrays import Float32
from multilight.scenes.spec import SceneSpec


class Case(Protocol):
    """The scene, its rig, and the view (`options.view`)."""

    scene: SceneSpec
    rig: LightRig
    options: Any


def relit(rig: LightRig, condition: LightingCondition) -> LightRig:
    """Build the rig that a renderer would be given for one condition (gains' mean: the cost does not depend on hue)."""
    lights = [
        light.scaled(float(np.mean(condition.gains[light.name])))
        for light in rig.lights
        if np.any(condition.gains.get(light.name, 0))
    ]
    return LightRig(lights=tuple(lights))


def grey_gains(condition: LightingCondition) -> LightingCondition:
    """Return the condition that `relit` renders, without its exposure."""
    gains = {name: (float(np.mean(gain)),) * 3 for name, gain in condition.gains.items()}
    return condition.model_copy(update={"gains": gains, "exposure_ev": 0.0})


class OneByOne:
    """Renders whole pictures: no light groups, Cycles' denoiser with guides that it has cleaned first (its default)."""

    def __init__(self, backend: Any) -> None:
        assert isinstance(backend, BlenderBackend)
        self._backend = backend
        self._loaded: tuple[LightingCondition, int] | None = None
        self._synced: Any = None

    def load(self, case: Case, condition: LightingCondition, spp: int) -> None:
        """Put the scene into Blender, with the condition's lights."""
        if self._loaded == (condition, spp) and self._backend.synced is self._synced:
            return
        job = RenderJob(case.scene, relit(case.rig, condition), RenderSettings(spp=spp), case.options.view)
        self._synced = self._backend.sync(job, keep=False)  # what follows is not what its next job may find
        scene = bpy.context.scene
        groups = scene.view_layers[0].lightgroups
        for group in list(groups):
            groups.remove(group)
        scene.cycles.use_denoising, scene.cycles.denoiser = True, "OPENIMAGEDENOISE"
        scene.cycles.denoising_input_passes, scene.cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "ACCURATE"
        place_camera(case.scene.cameras[case.options.view])
        scene.cycles.seed = 1
        beauty_filter(1)
        render_passes()
        beauty_filter(spp)
        self._loaded = (condition, spp)

    def render(self, case: Case, condition: LightingCondition, spp: int, without: str | None) -> Float32:
        """Render everything, or all but one object: (H, W, 3)."""
        self.load(case, condition, spp)
        if without is None:
            return np.ascontiguousarray(render_passes()["Combined"][..., :3])
        with hidden(self._synced, without):
            return np.ascontiguousarray(render_passes()["Combined"][..., :3])
