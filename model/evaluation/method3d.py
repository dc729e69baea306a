"""The 3D stage as a method of the evaluation: all views of a group at once."""

from pathlib import Path

import numpy as np
import torch

from multilight.model.device import chosen_device
from multilight.model.evaluation.cases import Case, Group
from multilight.model.gaussians.refine import refined_scene
from multilight.model.gaussians.splat_scene import SplatScene, splat_scene
from multilight.model.inference.harmonize import harmonize
from multilight.model.networks.checkpoint import load_network, load_network3d
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.networks.compositing3d import SceneNetwork, harmonize_views
from multilight.scenes.arrays import Float32

SIDE = 256  # cells a side of the map: 65,536 Gaussians


class SceneMethod:
    """Harmonize the views of a group together: the 2D stage on each, then the 3D stage on their Gaussians.

    A single view, or views without cameras, are left to the 2D stage. The Gaussians lie on the views' depth; with
    `refine_iterations` they are first refined on the composites, the pictures that a capture with the object would be.
    """

    def __init__(
        self, stage2d: Compositing2D, stage3d: SceneNetwork, side: int = SIDE, refine_iterations: int = 0
    ) -> None:
        self.stage2d, self.stage3d = stage2d, stage3d
        self.side, self.refine_iterations = side, refine_iterations
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
            self._done = self._together(self._group, self._scene(self._group))
        return self._done[case.name]

    def _flat(self, case: Case) -> Float32:
        return harmonize(self.stage2d, case.composite, case.background, case.depth, mask=case.mask)

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

    def _together(self, group: Group, scene: SplatScene) -> dict[str, Float32]:
        pictures = [(case.composite, self._flat(case), case.background) for case in group.cases]
        _, shown = harmonize_views(self.stage3d, scene, *map(np.stack, zip(*pictures, strict=True)))
        return {case.name: picture for case, picture in zip(group.cases, shown, strict=True)}


def scene_method(weights2d: Path, weights3d: Path, device: str = "auto", *, refine_iterations: int = 0) -> SceneMethod:
    """Load both stages; raises `UserError` naming the file that cannot be read."""
    chosen = chosen_device(device)
    stages = load_network(weights2d).to(chosen), load_network3d(weights3d).to(chosen)
    return SceneMethod(*stages, refine_iterations=refine_iterations)
