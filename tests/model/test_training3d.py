"""The 3D stage's training: resumable, keeps the scenes' Gaussians, and is evaluated view by view."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from multilight.datagen.config.loading import validated
from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import NetworkConfig
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.evaluation.cases import dataset_groups
from multilight.model.evaluation.method3d import scene_method
from multilight.model.evaluation.settings import CaseSettings
from multilight.model.networks.checkpoint import load_network3d, save_network
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.training.samples3d import SceneSamples
from multilight.model.training.stage3d import Trainer3D, train_scenes

TINY = {"body": "attention", "width": 16, "heads": 2, "groups": 1, "blocks": 2, "window": 4, "pooled": 2}
CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def weights2d(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "2d.safetensors"
    network = NetworkConfig.model_validate(TINY)
    save_network(path, Compositing2D(network), network, {})
    return path


def config(dataset: Path, weights: Path, out: Path, **changes: Any) -> SceneTrainingConfig:
    values: dict[str, Any] = {
        "out": out, "weights_2d": weights, "network": TINY | {"stride": 2, "head": "residual", "cues": False},
        "steps": 4, "save_every": 2, "warmup": 1, "views": 3, "side": 16, "device": "cpu",
        "data": {"train": str(dataset), "workers": 0, "validation_split": "train", "validation_samples": 1},
        "stages": [{"size": 32, "batch": 1}],
    }  # fmt: skip
    return validated(values | changes, SceneTrainingConfig, "test")


def test_resuming_is_exact(spheres_dataset: Path, weights2d: Path, tmp_path: Path) -> None:
    whole = config(spheres_dataset, weights2d, tmp_path / "whole")
    train_scenes(whole)
    first = Trainer3D(config(spheres_dataset, weights2d, tmp_path / "again"), CPU)
    for step in range(4):
        first._step(step / 4)
        first.progress = type(first.progress)(step + 1, 0.0)
    stored = load_file(tmp_path / "whole" / "checkpoints" / "step_000004.safetensors")
    for name, tensor in first.network.state_dict().items():
        assert torch.equal(stored[f"model.{name}"], tensor), name
    resumed = Trainer3D(whole, CPU)
    assert resumed.progress.step == 4
    for name, tensor in resumed.average.state_dict().items():
        assert torch.equal(first.average.state_dict()[name], tensor), name
    with pytest.raises(UserError, match="trained with side"):
        train_scenes(config(spheres_dataset, weights2d, tmp_path / "whole", side=32))


def test_gaussians_lie_where_the_sample_shows_them(spheres_dataset: Path, weights2d: Path, tmp_path: Path) -> None:
    samples = SceneSamples(config(spheres_dataset, weights2d, tmp_path), CPU)
    first, again = samples[0], samples[0]
    assert first.scene is again.scene
    assert first.composite.shape == (3, 3, 32, 32)
    shown = first.scene.render(first.scene.carry(first.target))
    covered = (first.scene.covered() > 0.9).expand_as(shown)
    assert ((shown - first.target)[covered] ** 2).mean() < 0.02


def test_views_without_enough_scenes_are_refused(spheres_dataset: Path, weights2d: Path, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="view"):
        SceneSamples(config(spheres_dataset, weights2d, tmp_path, views=9), CPU)[0]


@pytest.mark.parametrize(
    ("changes", "told"),
    [({"side": 100}, "power of two"), ({"stages": [{"batch": 2}]}, "batch 1"), ({"sides": 3}, "did you mean 'side'")],
)
def test_bad_values_are_named(tmp_path: Path, changes: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        config(tmp_path, tmp_path / "w.safetensors", tmp_path, **changes)


def test_evaluated_together_and_consistent(spheres_dataset: Path, weights2d: Path, tmp_path: Path) -> None:
    made = config(spheres_dataset, weights2d, tmp_path / "run", steps=1)
    train_scenes(made)
    weights = made.out / "model.safetensors"
    assert load_network3d(weights).config == made.network
    on = Trainer3D(config(spheres_dataset, weights2d, tmp_path / "on", start=weights, seed=1), CPU)
    for name, tensor in load_network3d(weights).state_dict().items():
        assert torch.equal(on.network.state_dict()[name], tensor), name
    method = scene_method(weights2d, weights, "cpu")
    method.side = 32
    settings = CaseSettings(splits=("train",), groups=8, size=64)
    group = next(g for g in (load() for load in dataset_groups(str(spheres_dataset), settings)) if len(g.cases) > 1)
    method.begin(group)
    pictures = [method(case) for case in group.cases]
    for case, picture in zip(group.cases, pictures, strict=True):
        assert picture.shape == case.composite.shape
        assert np.isfinite(picture).all()
        nothing = case.depth >= 1.0
        np.testing.assert_allclose(picture[nothing], method._flat(case)[nothing], atol=0.05)


def test_weights_of_the_other_stage_are_refused(weights2d: Path) -> None:
    with pytest.raises(UserError, match="of the 2D stage, those of the 3D stage are asked for"):
        load_network3d(weights2d)
