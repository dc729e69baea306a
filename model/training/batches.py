"""Batches for training, endless and resumable: batch `n` is the same whatever came before it."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from multilight.datagen.errors import StoreError, UserError
from multilight.model.configs.stage2d import DataConfig, StageConfig, TrainingConfig
from multilight.model.data import MultiLightDataset, SampleSettings

ENDLESS = 1 << 40  # samples; the dataset's order is a pure function of the sample's number
STAGE_SAMPLES = 1 << 32  # every stage draws from numbers of its own
FIELDS = (
    "composite", "background", "depth", "target", "mask", "glow", "effect", "K", "light_towards", "light_fraction"
)  # fmt: skip


@dataclass(frozen=True)
class Process:
    """Which of `world` training processes this is."""

    rank: int = 0
    world: int = 1


ALONE = Process()


@dataclass(frozen=True)
class Batch:
    """Pictures of one step: (B, 3, S, S), `depth`, `mask` and `glow` (B, 1, S, S); `meta` says where they come from.

    `K` and lights are those of `MultiLightDataset`.
    """

    composite: Tensor
    background: Tensor
    depth: Tensor
    target: Tensor
    mask: Tensor
    glow: Tensor
    effect: Tensor
    K: Tensor
    light_towards: Tensor
    light_fraction: Tensor
    meta: dict[str, Any]

    @classmethod
    def of(cls, sample: dict[str, Any], device: torch.device) -> "Batch":
        """Put a collated sample on a device."""
        return cls(**{name: sample[name].to(device, non_blocking=True) for name in FIELDS}, meta=sample["meta"])

    def names(self, wrong: Tensor | None = None) -> str:
        """Name the samples for which `wrong` (B,) bool holds, or all."""
        meta = self.meta
        numbers = range(len(self.target)) if wrong is None else wrong.nonzero().flatten().tolist()
        return "; ".join(
            f"scene {int(meta['scene'][i])} view {int(meta['view'][i])} object {meta['object'][i]}" for i in numbers
        )


@dataclass(frozen=True)
class _BatchSampler:
    """Yields the sample numbers of one process' part of each step's batch, from step `first` on."""

    base: int
    first: int
    batch: int
    process: Process

    def __iter__(self) -> Iterator[list[int]]:
        part = self.batch // self.process.world
        for step in itertools.count(self.first):
            start = self.base + step * self.batch + self.process.rank * part
            yield list(range(start, start + part))


def training_samples(data: DataConfig, size: int, *, views: int = 1, augment: bool = False) -> MultiLightDataset:
    """Open the training samples, without end."""
    settings = SampleSettings(
        size=size, views=views, seed=data.seed, where=data.where, lighting=data.lighting, length=ENDLESS,
        augment=augment, faults=data.faults if augment else 0.0, repeat=True,
    )  # fmt: skip
    return MultiLightDataset(data.train, settings)


def validation_samples(data: DataConfig, size: int, *, views: int = 1) -> MultiLightDataset:
    """Open the validation samples, always the same: stored lighting, whole pictures."""
    settings = SampleSettings(
        size=size, views=views, split=data.validation_split, lighting="stored", length=data.validation_samples,
        augment=False, repeat=True,
    )  # fmt: skip
    try:
        return MultiLightDataset(data.validation or data.train, settings)
    except StoreError:
        raise
    except UserError as error:
        raise UserError(f"validation: {error}; set data.validation_split, or data.validation_samples = 0") from None


def training_batches(config: TrainingConfig, number: int, first: int, process: Process) -> Iterator[dict[str, Any]]:
    """Return the endless batches of stage `number` from step `first` on: collated samples."""
    stage, data = config.stages[number], config.data
    if stage.batch % process.world:
        raise UserError(f"stages.batch = {stage.batch} cannot be shared by {process.world} processes")
    loader = DataLoader(
        training_samples(data, stage.size, augment=data.augment),
        batch_sampler=_BatchSampler(number * STAGE_SAMPLES, first, stage.batch, process),
        num_workers=data.workers,
        # Forked, a loader process waits for ever on whatever lock another thread held.
        multiprocessing_context="spawn" if data.workers else None,
        pin_memory=torch.cuda.is_available(),
    )
    return _one_line_errors(loader)


def _one_line_errors(loader: DataLoader[Any]) -> Iterator[dict[str, Any]]:
    """Yield batches; what a loader process could not read is told without that process' traceback."""
    try:
        yield from loader
    except UserError as error:
        line = str(error).strip().splitlines()[-1]
        raise UserError(line.removeprefix(f"{type(error).__module__}.{type(error).__qualname__}: ")) from None


def validation_batches(data: DataConfig, stage: StageConfig, device: torch.device) -> list[Batch]:
    """Load the validation samples; empty where there are none."""
    if not data.validation_samples:
        return []
    loader = DataLoader(validation_samples(data, stage.size), batch_size=8, shuffle=False)
    return [Batch.of(sample, device) for sample in loader]


def stage_at(config: TrainingConfig, done: float) -> int:
    """Return the number of the stage when the fraction `done` of the training, in [0, 1], is done."""
    return next((i for i, stage in enumerate(config.stages) if done < stage.until), len(config.stages) - 1)
