"""Samples of the 3D stage: a scene's views with an object under two lightings, and the scene's Gaussians."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from multilight.datagen.errors import UserError
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.data import MultiLightDataset, SampleSettings
from multilight.model.gaussians.splat_scene import SplatScene, splat_scene
from multilight.scenes.cameras.pinhole import camera_of

ENDLESS = 1 << 40  # samples; the dataset's order is a pure function of the sample's number


@dataclass(frozen=True)
class SceneSample:
    """One object of one scene in V views: pictures (V, 3, H, W) display-encoded, depth and mask (V, 1, H, W)."""

    composite: Tensor
    background: Tensor
    depth: Tensor
    target: Tensor
    mask: Tensor
    effect: Tensor
    scene: SplatScene
    name: str


class SceneSamples:
    """Samples by number, like `MultiLightDataset`; a scene's Gaussians, which no lighting changes, are kept."""

    def __init__(self, config: SceneTrainingConfig, device: torch.device, *, validation: bool = False) -> None:
        """Open the training or the validation samples; raises `UserError` where no scene has as many views."""
        data, size = config.data, config.stages[0].size
        self.config, self.device = config, device
        settings = SampleSettings(
            size=size, views=config.views, seed=data.seed, where=data.where, lighting=data.lighting, length=ENDLESS,
            augment=False, repeat=True,
        )  # fmt: skip
        address = data.train
        if validation:
            address = data.validation or data.train
            settings = SampleSettings(
                size=size, views=config.views, split=data.validation_split, lighting="stored",
                length=max(data.validation_samples, 1), augment=False, repeat=True,
            )  # fmt: skip
        self._data = MultiLightDataset(address, settings)
        self._kept: OrderedDict[tuple[int, bytes], SplatScene] = OrderedDict()

    def __getitem__(self, number: int) -> SceneSample:
        sample = self._data[number]
        meta = sample["meta"]
        order = sorted(range(self.config.views), key=lambda v: sample["c2w"][v].numpy().tobytes())
        pictures = {
            name: sample[name][order].to(self.device)
            for name in ("composite", "background", "depth", "target", "mask", "effect")
        }
        ordered = {name: sample[name][order].numpy() for name in ("K", "c2w", "z_depth")}
        scene = self._scene(meta["scene"], ordered)
        return SceneSample(**pictures, scene=scene, name=f"scene {meta['scene']} object {meta['object']}")

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
