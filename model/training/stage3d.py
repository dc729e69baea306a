"""The training of the 3D stage: one scene a step, on one device."""

from collections.abc import Iterable

import torch
from torch import Tensor

from multilight.datagen.files.outputs import check_folder
from multilight.datagen.report import Report, silent
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.device import chosen_device
from multilight.model.networks.checkpoint import load_network, load_network3d
from multilight.model.networks.compositing3d import SceneNetwork, harmonize_scene, scene_network
from multilight.model.training.optimization import denormals_as_zero
from multilight.model.training.samples3d import SceneSample, SceneSamples
from multilight.model.training.trainer import Images, Trainer, remove_run


class Trainer3D(Trainer[SceneSample]):
    """A training of the 3D stage."""

    config: SceneTrainingConfig
    network: SceneNetwork
    average: SceneNetwork

    def __init__(self, config: SceneTrainingConfig, device: torch.device) -> None:
        super().__init__(config, device)
        self.samples = SceneSamples(config, device)

    def _make_network(self) -> SceneNetwork:
        self.stage2d = load_network(self.config.weights_2d).to(self.device).requires_grad_(False)
        start = self.config.start
        return load_network3d(start) if start else scene_network(self.config.network)

    def _validation(self) -> Iterable[SceneSample]:
        count = self.config.data.validation_samples
        return SceneSamples(self.config, self.device, validation=True) if count else ()

    def _next_sample(self, done: float) -> SceneSample:
        return self.samples[self.progress.step]

    def _losses(self, sample: SceneSample) -> dict[str, Tensor]:
        colors, views = self._together(self.network, sample, self._alone(sample))
        on_map = ((colors - sample.scene.carry(sample.target)) ** 2).mean()
        on_views = self.loss(views, sample.target, sample.mask, sample.effect)["loss"].mean()
        return {"loss": 0.5 * on_map + 0.5 * on_views}

    def _images(self, sample: SceneSample) -> Images:
        alone = self._alone(sample)
        return {"composite": sample.composite, "2D": alone, "3D": self._together(self.average, sample, alone)[1]}

    @torch.no_grad()
    def _alone(self, sample: SceneSample) -> Tensor:
        return self.stage2d(sample.composite, sample.background, sample.depth, sample.mask)

    def _together(self, network: SceneNetwork, sample: SceneSample, harmonized: Tensor) -> tuple[Tensor, Tensor]:
        return harmonize_scene(network, sample.scene, sample.composite, harmonized, sample.background)


@denormals_as_zero()
def train_scenes(config: SceneTrainingConfig, *, fresh: bool = False, report: Report = silent) -> dict[str, float]:
    """Train the 3D stage, and write the averaged weights to `model.safetensors`; returns the last validation.

    Goes on from the newest checkpoint in `config.out`, unless `fresh`. Raises `UserError` for weights or data that
    cannot be read and for a loss that is not finite.
    """
    check_folder(config.out)
    if fresh:
        remove_run(config)
    return Trainer3D(config, chosen_device(config.device)).run(report)
