"""The training of the 2D stage: one process or many (torchrun)."""

import contextlib
import copy
import os
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from multilight.datagen.files.outputs import check_folder
from multilight.datagen.report import Report, silent
from multilight.model.configs.stage2d import TrainingConfig
from multilight.model.device import chosen_device
from multilight.model.networks.checkpoint import load_network
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.training.batches import ALONE, Batch, Process, stage_at, training_batches, validation_batches
from multilight.model.training.losses import glow_loss, light_loss
from multilight.model.training.optimization import denormals_as_zero
from multilight.model.training.trainer import Images, Trainer, remove_run


@denormals_as_zero()
def train(config: TrainingConfig, *, fresh: bool = False, report: Report = silent) -> dict[str, float]:
    """Train, and write the averaged weights to `model.safetensors`; returns the last validation.

    Goes on from the newest checkpoint in `config.out`, unless `fresh`. Raises `UserError` for data that cannot be
    read, a loss that is not finite (naming the samples) and memory that does not suffice (naming the remedy).
    """
    check_folder(config.out)
    with processes(config) as (process, device):
        if fresh and process.rank == 0 and config.out.exists():
            remove_run(config)
        if process.world > 1:
            torch.distributed.barrier()
        return Trainer2D(config, device, process).run(report)


class Trainer2D(Trainer[Batch]):
    """A training of the 2D stage."""

    network: Compositing2D

    def __init__(self, config: TrainingConfig, device: torch.device, process: Process = ALONE) -> None:
        super().__init__(config, device, process)
        able = device.type == "cuda" and torch.cuda.is_bf16_supported()
        self.bf16 = config.precision == "bf16" or (config.precision == "auto" and able)
        self.module: nn.Module = DistributedDataParallel(self.network) if process.world > 1 else self.network
        self._batches: Iterator[dict[str, Any]] | None = None

    def _make_network(self) -> Compositing2D:
        start = self.config.start
        return load_network(start) if start else Compositing2D(self.config.network)

    def _validation(self) -> list[Batch]:
        return validation_batches(self.config.data, self.config.stages[-1], self.device)

    def _next_sample(self, done: float) -> Batch:
        stage = stage_at(self.config, done)
        if self._batches is None or stage != self.stage:
            self.stage = stage
            self._batches = training_batches(self.config, stage, self.progress.step, self.process)
        return Batch.of(next(self._batches), self.device)

    def _losses(self, sample: Batch) -> dict[str, Tensor]:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
            image, guess = self.module(sample.composite, sample.background, sample.depth, sample.mask, told=True)
        losses: dict[str, Tensor] = self.loss(image.float(), sample.target, sample.mask, sample.effect)
        if guess is not None:
            losses |= {"lights": light_loss(guess.lights, sample), "glow": glow_loss(guess.glow, sample)}
            for name, weight in (("lights", self.config.loss.lights), ("glow", self.config.loss.glow)):
                losses["loss"] = losses["loss"] + weight * losses[name]
        return losses

    def _images(self, sample: Batch) -> Images:
        image = self.average(sample.composite, sample.background, sample.depth, sample.mask)
        return {"composite": sample.composite, "network": image}

    def _finished(self) -> nn.Module:
        finished = copy.deepcopy(self.average)
        if isinstance(finished, Compositing2D) and self.config.network.head == "light":
            finished.calibrate(self.config.shadows, self.config.glow)
        return finished

    def _about(self, found: dict[str, float]) -> dict[str, str]:
        return super()._about(found) | {"size": str(self.config.stages[-1].size)}


@contextlib.contextmanager
def processes(config: TrainingConfig) -> Iterator[tuple[Process, torch.device]]:
    """Join the other processes where torchrun started several; yields which of them this is, and its device."""
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        yield ALONE, chosen_device(config.device)
        return
    local = int(os.environ["LOCAL_RANK"])
    if torch.cuda.is_available():
        torch.cuda.set_device(local)
    kind = chosen_device(config.device).type
    torch.distributed.init_process_group("nccl" if kind == "cuda" else "gloo")
    try:
        device = torch.device(kind, local) if kind == "cuda" else torch.device(kind)
        yield Process(torch.distributed.get_rank(), world), device
    finally:
        torch.distributed.destroy_process_group()
