"""Methods of the evaluation that harmonize all views of a group at once: under one set of lights, and the 3D stage."""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from multilight.model.configs.stage3d import SLIM3D
from multilight.model.device import chosen_device
from multilight.model.evaluation.cases import Case, Group
from multilight.model.gaussians.refine import refined_scene
from multilight.model.gaussians.splat_scene import SplatScene, splat_scene
from multilight.model.inference.harmonize import harmonize, lights_of_views
from multilight.model.networks.checkpoint import load_network, load_network3d
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import Compositing3D, SceneNetwork, harmonize_views
from multilight.scenes.arrays import Float32

SIDE = 256  # cells a side of the map: 65,536 Gaussians


class GroupMethod(ABC):
    """Harmonize the views of a group together; a single view, or views without cameras, by the 2D stage alone."""

    def __init__(self, stage2d: Compositing2D) -> None:
        self.stage2d = stage2d
        self._group: Group | None = None
        self._done: dict[str, Float32] = {}

    def begin(self, group: Group) -> None:
        """Say which group the next cases are of."""
        self._group, self._done = group, {}

    def __call__(self, case: Case) -> Float32:
        """Return a case's picture, (H, W, 3) in [0, 1]; the first case of a group takes the time of all."""
        if self._group is None or len(self._group.cameras) < 2:
            return self._flat(case)
        if not self._done:
            pictures = self._together(self._group)
            self._done = {case.name: picture for case, picture in zip(self._group.cases, pictures, strict=True)}
        return self._done[case.name]

    @abstractmethod
    def _together(self, group: Group) -> Iterable[Float32]:
        """Return a picture for each of the group's cases, (H, W, 3) in [0, 1]."""

    def _flat(self, case: Case, numbers: Tensor | None = None) -> Float32:
        return harmonize(self.stage2d, case.composite, case.background, case.depth, mask=case.mask, numbers=numbers)


class SharedLights(GroupMethod):
    """The 2D stage under one set of lights for all views of a group."""

    def _together(self, group: Group) -> Iterable[Float32]:
        composites, backgrounds = [case.composite for case in group.cases], [case.background for case in group.cases]
        depths, masks = [case.depth for case in group.cases], [case.mask for case in group.cases]
        rotations = np.stack([camera.pose()[:3, :3] for camera in group.cameras])
        lights = lights_of_views(self.stage2d, composites, backgrounds, depths, masks, rotations)
        return [self._flat(case, numbers) for case, numbers in zip(group.cases, lights, strict=True)]


class SceneMethod(GroupMethod):
    """The 2D stage on each view of a group, then the 3D stage on their Gaussians.

    The Gaussians lie on the views' depth; with `refine_iterations` they are first refined on the composites, the
    pictures that a capture with the object would be.
    """

    def __init__(
        self, stage2d: Compositing2D, stage3d: SceneNetwork, side: int = SIDE, refine_iterations: int = 0
    ) -> None:
        super().__init__(stage2d)
        self.stage3d, self.side, self.refine_iterations = stage3d, side, refine_iterations

    def _scene(self, group: Group) -> SplatScene:
        depths = np.stack(group.z_depth)
        scene = splat_scene(group.cameras, depths, side=self.side, order=self.stage3d.config.order).to(self._device)
        if not self.refine_iterations:
            return scene
        pictures = np.stack([case.composite for case in group.cases])
        steps, device = self.refine_iterations, self._device
        return refined_scene(scene, group.cameras, pictures, depths, steps=steps, device=device)

    @property
    def _device(self) -> torch.device:
        return next(self.stage3d.parameters()).device

    def _together(self, group: Group) -> Iterable[Float32]:
        pictures = [(case.composite, self._flat(case), case.background) for case in group.cases]
        _, shown = harmonize_views(self.stage3d, self._scene(group), *map(np.stack, zip(*pictures, strict=True)))
        return shown


def scene_method(weights2d: Path, weights3d: Path, device: str = "auto", *, refine_iterations: int = 0) -> SceneMethod:
    """Load both stages; raises `UserError` naming the file that cannot be read."""
    chosen = chosen_device(device)
    stages = load_network(weights2d).to(chosen), load_network3d(weights3d).to(chosen)
    return SceneMethod(*stages, refine_iterations=refine_iterations)


def without_network(name: str, weights2d: Path, device: str = "auto") -> dict[str, GroupMethod]:
    """Return what makes views alike without weights of the 3D stage: the mean over views, one set of lights."""
    chosen = chosen_device(device)
    stage2d = load_network(weights2d).to(chosen)
    averaged = SceneMethod(stage2d, Compositing3D(SLIM3D).eval().to(chosen))
    found: dict[str, GroupMethod] = {f"{name}, averaged over views": averaged}
    if stage2d.config.head == "light":
        found[f"{name}, one set of lights"] = SharedLights(stage2d)
    return found
