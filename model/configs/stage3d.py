"""The typed configuration of a training of the 3D stage; imports no torch."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from multilight.model.configs.stage2d import Head, NetworkConfig, TrainingConfig

Order = Literal["hilbert", "morton", "arbitrary"]

Layout = Literal["map", "map+points", "points"]

Carry = Literal["average", "pixel"]


class SceneNetworkConfig(NetworkConfig):
    """The shape of the network of the 3D stage, and what it works on: 0.4 M parameters, unless told otherwise."""

    body: Literal["pyramid", "attention"] = "attention"
    """What reads the map: here always attention."""
    stride: Literal[1, 2, 4, 8] = 4
    """Map cells a side of a token."""
    width: Annotated[int, Field(ge=8, le=1024)] = 64
    """Channels of a token."""
    blocks: Annotated[int, Field(ge=1, le=32)] = 2
    """Blocks a group; every second one shifts its windows."""
    heads: Annotated[int, Field(ge=1, le=64)] = 4
    """Attention heads a block; must divide `width`."""
    head: Head = "residual"
    """What is predicted: here always a residual."""
    cues: bool = False
    """Not used: the map has none."""
    layout: Layout = "map"
    """The Gaussians' colours on a map, their places and normals besides, or no map: clusters (`networks.points3d`)."""
    order: Order = "hilbert"
    """Order of the Gaussians on the map: along the Hilbert curve, the Z-order curve, or at random."""
    carry: Carry = "average"
    """A Gaussian's colours: the mean over all views that show it, or, as published, the one pixel it came from."""


SLIM3D = SceneNetworkConfig()
"""Our network of the 3D stage."""


class SceneTrainingConfig(TrainingConfig):
    """A training of the 3D stage: a step is one object of one scene, in all its views, under one pair of lightings."""

    weights_2d: Path
    """Finished weights of the 2D stage, which stays as it is: a file, or ready-made ones by name."""
    network: SceneNetworkConfig = SLIM3D
    """The network on the Gaussians."""
    views: Annotated[int, Field(ge=1, le=64)] = 4
    """Views of a scene that its Gaussians are made from."""
    side: Annotated[int, Field(ge=16, le=1024)] = 128
    """Cells a side of the map, a power of two: 256 is 65,536 Gaussians."""
    learning_rate: Annotated[float, Field(gt=0)] = 3e-4
    """Largest learning rate."""
    kept_scenes: Annotated[int, Field(ge=1)] = 64
    """Scenes whose Gaussians are kept in memory: about 20 MB each at 128 pixels, 80 MB at 256."""

    @model_validator(mode="after")
    def _side_folds(self) -> "SceneTrainingConfig":
        if self.side & (self.side - 1):
            raise ValueError(f"side = {self.side} must be a power of two")
        if len(self.stages) != 1 or self.stages[0].batch != 1:
            raise ValueError("the 3D stage trains in one stage of batch 1: stages = [{size = 128, batch = 1}]")
        return self
