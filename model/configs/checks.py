"""What a user may have mistaken, found before torch is loaded and anything long starts."""

from collections.abc import Sequence
from pathlib import Path

from multilight.datagen.errors import StoreError, UserError
from multilight.datagen.storage.open_dataset import open_dataset
from multilight.model.configs.ready_made import weights_config
from multilight.model.configs.stage2d import NetworkConfig, TrainingConfig
from multilight.model.configs.stage3d import SceneTrainingConfig

LEAST_SIDE, MOST_SIDE = 16, 4096
"""Pixels a side of pictures that networks see."""


def check_range(option: str, value: float, least: float, most: float) -> None:
    """Raise `UserError` where a number is not within its range."""
    if not least <= value <= most:
        raise UserError(f"{option} {value} must be {least} to {most}")


def check_file(option: str, path: Path | None) -> None:
    """Raise `UserError` where an option that is given names no file."""
    if path is not None and not path.is_file():
        raise UserError(f"{option} {path} {'is a folder; name a file' if path.is_dir() else 'does not exist'}")


def check_splits(address: str, splits: Sequence[str]) -> None:
    """Raise `UserError` where a dataset is none, or has no scene of any of these splits."""
    there = set(open_dataset(address).table["split"])
    if not there & set(splits):
        has = f"its scenes are of {', '.join(sorted(there))}" if there else "it has no scene at all"
        raise UserError(f"{address} has no scene of {', '.join(splits)}; {has}: choose others with --splits")


def check_training(config: TrainingConfig) -> None:
    """Raise `UserError` where a training has nothing to learn from, or to validate on, or lacks a file."""
    views = 1
    if isinstance(config, SceneTrainingConfig):
        views = config.views
        weights_config(config.weights_2d, NetworkConfig)
    check_start(config)
    check_file("loss.vgg", config.loss.vgg)
    data = config.data
    _check_scenes("data.train", data.train, "train", data.where, views, "name another dataset with --data")
    if data.validation_samples:
        remedy = "set data.validation_split, or data.validation_samples = 0"
        _check_scenes("validation", data.validation or data.train, data.validation_split, None, views, remedy)


def check_start(config: TrainingConfig) -> None:
    """Raise `UserError` where the weights to learn on from, if any, are of another network."""
    if config.start is None:
        return
    asked = config.network.model_dump()
    for key, value in weights_config(config.start, type(config.network)).model_dump().items():
        if value != asked[key]:
            raise UserError(f"start = '{config.start}' has network.{key} = {value!r}, not {asked[key]!r}; say the same")


def _check_scenes(key: str, address: str, split: str, where: str | None, views: int, remedy: str) -> None:
    """Raise `UserError` where no scene of a split has as many views."""
    try:
        scenes = open_dataset(address, where=where).table
    except StoreError as error:
        raise UserError(f"{key}: {error}; {remedy}") from None
    chosen = f"{address} where {where}" if where else address
    found = scenes.filter(scenes["split"] == split)["views"].to_list()
    if not found:
        raise UserError(f"{key}: {chosen} has no scene of split {split!r}; {remedy}")
    if max(found) < views:
        raise UserError(f"{key}: {chosen} has scenes of at most {max(found)} views; lower views = {views}")
