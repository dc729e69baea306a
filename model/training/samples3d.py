"""Samples of the 3D stage: a scene's views with an object under two lightings, and the scene's Gaussians."""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from multilight.datagen.errors import UserError
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.gaussians.splat_scene import SplatScene, splat_scene
from multilight.model.training.batches import FIELDS, Batch, training_samples, validation_samples
from multilight.scenes.cameras.pinhole import camera_of


@dataclass(frozen=True)
class SceneSample(Batch):
    """One object of one scene in V views: pictures (V, 3, S, S) display-encoded, depth and mask (V, 1, S, S)."""

    scene: SplatScene

    def names(self, wrong: Tensor | None = None) -> str:
        """Name the scene and the object."""
        return f"scene {self.meta['scene']} object {self.meta['object']}"


class SceneSamples:
    """Samples by number, like `MultiLightDataset`; a scene's Gaussians, which no lighting changes, are kept."""

    def __init__(self, config: SceneTrainingConfig, device: torch.device, *, validation: bool = False) -> None:
        """Open the training or the validation samples; raises `UserError` where no scene has as many views."""
        opened = validation_samples if validation else training_samples
        self.config, self.device = config, device
        self._data = opened(config.data, config.stages[0].size, views=config.views)
        self._kept: OrderedDict[tuple[int, bytes], SplatScene] = OrderedDict()

    def __iter__(self) -> Iterator[SceneSample]:
        return (self[number] for number in range(len(self._data)))

    def __getitem__(self, number: int) -> SceneSample:
        sample = self._data[number]
        meta = sample["meta"]
        order = sorted(range(self.config.views), key=lambda v: sample["c2w"][v].numpy().tobytes())
        pictures = {name: sample[name][order].to(self.device) for name in FIELDS}
        ordered = {name: sample[name][order].numpy() for name in ("K", "c2w", "z_depth")}
        return SceneSample(**pictures, meta=meta, scene=self._scene(meta["scene"], ordered))

    def _scene(self, index: int, views: dict[str, NDArray[Any]]) -> SplatScene:
        key = (index, views["c2w"].tobytes())
        if key not in self._kept:
            depths = views["z_depth"][:, 0]
            cameras = [camera_of(k, c, depths.shape[1:]) for k, c in zip(views["K"], views["c2w"], strict=True)]
            try:
                made = splat_scene(cameras, depths, side=self.config.side, order=self.config.network.order)
            except ValueError as error:
                raise UserError(f"scene {index}: {error}; leave it out with data.where = 'index != {index}'") from None
            self._kept[key] = made.to(self.device)
            if len(self._kept) > self.config.kept_scenes:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]
