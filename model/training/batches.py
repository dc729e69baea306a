"""Batches for training, endless and resumable: batch `n` is the same whatever came before it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import DataLoader

from multilight.datagen.errors import UserError
from multilight.model.configs.stage2d import DataConfig, StageConfig, TrainingConfig
from multilight.model.data import MultiLightDataset, SampleSettings

ENDLESS = 1 << 40  # samples; the dataset's order is a pure function of the sample's number
STAGE_SAMPLES = 1 << 32  # every stage draws from numbers of its own
FIELDS = ("composite", "background", "depth", "target", "mask", "effect")


@dataclass(frozen=True)
class Share:
    """Which of `world` processes this is."""

    rank: int = 0
    world: int = 1


@dataclass(frozen=True)
class Batch:
    """Pictures of one step: (B, 3, S, S), `depth` and `mask` (B, 1, S, S); `meta` says where they come from."""

    composite: Tensor
    background: Tensor
    depth: Tensor
    target: Tensor
    mask: Tensor
    effect: Tensor
    meta: dict[str, Any]

    @classmethod
    def of(cls, sample: dict[str, Any], device: torch.device) -> "Batch":
        """Put a collated sample on a device."""
        return cls(**{name: sample[name].to(device, non_blocking=True) for name in FIELDS}, meta=sample["meta"])

    def names(self, wrong: Tensor) -> str:
        """Name the samples for which `wrong` (B,) bool holds."""
        meta = self.meta
        found = [
            f"scene {int(meta['scene'][i])} view {int(meta['view'][i])} object {meta['object'][i]}"
            for i in wrong.nonzero().flatten().tolist()
        ]
        return "; ".join(found)


@dataclass(frozen=True)
class _Numbers:
    """Yields the sample numbers of one process' part of each step's batch, from `first` on."""

    base: int
    first: int
    batch: int
    share: Share

    def __iter__(self) -> Iterator[list[int]]:
        part = self.batch // self.share.world
        step = self.first
        while True:
            start = self.base + step * self.batch + self.share.rank * part
            yield list(range(start, start + part))
            step += 1


def training_batches(config: TrainingConfig, number: int, first: int, share: Share) -> Iterator[dict[str, Any]]:
    """Return the endless batches of stage `number` from step `first` on: collated samples."""
    stage, data = config.stages[number], config.data
    if stage.batch % share.world:
        raise UserError(f"stages.batch = {stage.batch} cannot be shared by {share.world} processes")
    settings = SampleSettings(
        size=stage.size, seed=data.seed, where=data.where, lighting=data.lighting, length=ENDLESS,
        augment=data.augment, repeat=True,
    )  # fmt: skip
    loader = DataLoader(
        MultiLightDataset(data.train, settings),
        batch_sampler=_Numbers(number * STAGE_SAMPLES, first, stage.batch, share),
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


def validation_batches(data: DataConfig, stage: StageConfig, device: torch.device, *, batch: int = 8) -> list[Batch]:
    """Load the validation samples, always the same: stored lighting, whole pictures; empty where there are none."""
    if not data.validation_samples:
        return []
    settings = SampleSettings(
        size=stage.size, split=data.validation_split, lighting="stored", length=data.validation_samples,
        augment=False, repeat=True,
    )  # fmt: skip
    try:
        dataset = MultiLightDataset(data.validation or data.train, settings)
    except UserError as error:
        raise UserError(f"validation: {error}; set data.validation_split, or data.validation_samples = 0") from None
    return [Batch.of(sample, device) for sample in DataLoader(dataset, batch_size=batch, shuffle=False)]


def stage_at(config: TrainingConfig, done: float) -> int:
    """Return the number of the stage at a share `done` in [0, 1] of the training."""
    return next((i for i, stage in enumerate(config.stages) if done < stage.until), len(config.stages) - 1)
