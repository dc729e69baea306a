"""The training loop: one process or many (torchrun), by steps or by the clock, resumable."""

import contextlib
import copy
import math
import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel
from torch.optim import AdamW, Optimizer

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_folder
from multilight.model.configs.stage2d import TrainingConfig
from multilight.model.networks.checkpoint import (
    Progress,
    load_checkpoint,
    newest_checkpoint,
    save_checkpoint,
    save_network,
)
from multilight.model.networks.compositing2d import Compositing2D
from multilight.model.training.batches import Batch, Share, stage_at, training_batches, validation_batches
from multilight.model.training.losses import CompositingLoss
from multilight.model.training.monitor import Log, sample_sheet, validate

FINISHED = "model.safetensors"


def train(config: TrainingConfig, *, fresh: bool = False) -> dict[str, float]:
    """Train, and write the averaged weights to `model.safetensors`; returns the last validation.

    Goes on from the newest checkpoint in `config.out`, unless `fresh`. Raises `UserError` for data that cannot be
    read, a loss that is not finite (naming the samples) and memory that does not suffice (naming the remedy).
    """
    check_folder(config.out)
    with _processes(config) as (share, device):
        if fresh and share.rank == 0 and config.out.exists():
            remove_run(config)
        if share.world > 1:
            torch.distributed.barrier()
        return Trainer(config, share, device).run()


class Trainer:
    """A training in one process: network, its average, optimizer, and how far it is."""

    def __init__(self, config: TrainingConfig, share: Share, device: torch.device) -> None:
        self.config, self.share, self.device = config, share, device
        torch.manual_seed(config.seed)
        self.network = Compositing2D(config.network).to(device)
        self.average = copy.deepcopy(self.network).requires_grad_(False).eval()
        self.optimizer = make_optimizer(self.network, config)
        self.loss = CompositingLoss(config.loss).to(device)
        self.bf16 = _use_bf16(config, device)
        self.checkpoints = config.out / "checkpoints"
        self.progress = self._resumed()
        self.module: nn.Module = DistributedDataParallel(self.network) if share.world > 1 else self.network

    def _resumed(self) -> Progress:
        path = newest_checkpoint(self.checkpoints)
        if path is None:
            return Progress()
        return load_checkpoint(path, self.config, model=self.network, average=self.average, optim=self.optimizer)

    def done(self) -> float:
        """Return the share of the training that is done, in [0, 1]; equal in all processes."""
        if self.config.steps is not None:
            return min(1.0, self.progress.step / self.config.steps)
        assert self.config.minutes is not None
        done = torch.tensor(min(1.0, self.progress.seconds / (60.0 * self.config.minutes)), dtype=torch.float64)
        if self.share.world > 1:
            done = done.to(self.device)
            torch.distributed.broadcast(done, src=0)
        return float(done)

    def run(self) -> dict[str, float]:
        """Train to the end and return the last validation."""
        log = Log(self.config.out, quiet=self.share.rank > 0)
        stages = self.config.stages
        parameters = sum(p.numel() for p in self.network.parameters())
        log.line(
            f"training {parameters / 1e6:.2f} M parameters on {self.device.type}, "
            f"loss {self.config.loss.pixels} + {self.loss.label}, from step {self.progress.step}"
        )
        watched = validation_batches(self.config.data, stages[-1], self.device) if self.share.rank == 0 else []
        try:
            with _stop_asked() as asked:
                self._steps(log, watched, asked)
            if asked.is_set():
                self._save(log, [])
                raise KeyboardInterrupt
            found = self._save(log, watched)
        finally:
            log.close()
        if self.share.rank == 0:
            save_network(self.config.out / FINISHED, self.average, self.config.network, self._about(found))
            log.line(f"weights: {self.config.out / FINISHED}")
        return found

    def _steps(self, log: Log, watched: list[Batch], asked: threading.Event) -> None:
        number = -1
        batches: Iterator[dict[str, Any]] = iter(())
        started, logged = time.monotonic(), self.progress
        before = self.progress.seconds
        while (done := self.done()) < 1.0 and not asked.is_set():
            if stage_at(self.config, done) != number:
                number = stage_at(self.config, done)
                batches = training_batches(self.config, number, self.progress.step, self.share)
            figures = self._step(Batch.of(next(batches), self.device), done, number)
            self.progress = Progress(self.progress.step + 1, before + time.monotonic() - started)
            if self.progress.step % self.config.log_every == 0:
                self._report(log, figures, logged, number)
                logged = self.progress
            if self.progress.step % self.config.save_every == 0:
                self._save(log, watched)

    def _step(self, batch: Batch, done: float, number: int) -> dict[str, Tensor | float]:
        """Take one step and return its figures."""
        rate = learning_rate(self.config, self.progress.step, done)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        self.optimizer.zero_grad(set_to_none=True)
        with _memory_told(self.config, number):
            with torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16):
                image = self.module(batch.composite, batch.background, batch.depth, batch.mask)
            losses = self.loss(image.float(), batch.target, batch.mask, batch.effect)
            _check_finite(losses["loss"], batch, self.progress.step)
            losses["loss"].mean().backward()
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        if not torch.isfinite(norm):
            raise UserError(
                f"step {self.progress.step}: the gradient is {float(norm)}; lower learning_rate = "
                f"{self.config.learning_rate}; samples: {batch.names(losses['loss'] == losses['loss'])}"
            )
        self.optimizer.step()
        average_into(self.average, self.network, self.config.ema, self.progress.step)
        return {name: value.mean().detach() for name, value in losses.items()} | {"norm": norm, "rate": rate}

    def _report(self, log: Log, figures: dict[str, Tensor | float], since: Progress, number: int) -> None:
        now = self.progress
        stage = self.config.stages[number]
        seconds = max(now.seconds - since.seconds, 1e-9)
        pictures = (now.step - since.step) * stage.batch / seconds
        values = {f"train/{name}": float(value) for name, value in figures.items()} | {"train/pictures_s": pictures}
        log.scalars(values, now.step)
        done = max(self.done(), 1e-9)
        left = now.seconds * (1.0 - done) / done
        log.line(
            f"step {now.step}  loss {values['train/loss']:.5f}  pixels {values['train/pixels']:.5f}  "
            f"norm {values['train/norm']:.2f}  lr {values['train/rate']:.1e}  {stage.size} px  "
            f"{pictures:.1f} pictures/s  {left / 60:.1f} min left"
        )

    def _save(self, log: Log, watched: list[Batch]) -> dict[str, float]:
        """Write a checkpoint; validate and show samples, where there are any."""
        if self.share.rank > 0:
            return {}
        save_checkpoint(
            self.checkpoints, self.config, self.progress, model=self.network, average=self.average, optim=self.optimizer
        )
        if not watched:
            return {}
        found = validate(self.average, watched)
        step = self.progress.step
        log.scalars({f"validation/{name}": value for name, value in found.items()}, step)
        log.sheet(sample_sheet(self.average, watched[0]), step)
        log.line(
            f"step {step}  validation, object and effect: composite {found['composite']:.2f} dB, "
            f"network {found['network']:.2f} dB ({found['network'] - found['composite']:+.2f})"
        )
        return found

    def _about(self, found: dict[str, float]) -> dict[str, str]:
        """Return what the weights say about themselves."""
        return {
            "made_by": "multilight train",
            "config": self.config.model_dump_json(exclude={"out"}),
            "perceptual_loss": self.loss.label,
            "steps": str(self.progress.step),
            "minutes": f"{self.progress.seconds / 60:.1f}",
            "validation_db": ", ".join(f"{name} {value:.2f}" for name, value in found.items()),
            "torch": torch.__version__,
        }


def learning_rate(config: TrainingConfig, step: int, done: float) -> float:
    """Return the learning rate: a linear rise over `warmup` steps, then half a cosine over the whole training."""
    fall = config.final_rate + (1.0 - config.final_rate) * 0.5 * (1.0 + math.cos(math.pi * done))
    return config.learning_rate * fall * min(1.0, (step + 1) / max(config.warmup, 1))


def make_optimizer(network: nn.Module, config: TrainingConfig) -> Optimizer:
    """Make AdamW with weight decay on matrices and kernels only."""
    named = list(network.named_parameters())
    decayed = [p for n, p in named if p.ndim >= 2 and not n.endswith("bias")]
    plain = [p for n, p in named if p.ndim < 2 or n.endswith("bias")]
    groups = [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}]
    return AdamW(groups, lr=config.learning_rate, betas=config.betas)


def average_into(average: nn.Module, network: nn.Module, decay: float, step: int) -> None:
    """Move the average towards the network; the decay rises to its value: min(decay, (1 + t) / (10 + t))."""
    share = 1.0 - min(decay, (1 + step) / (10 + step))
    with torch.no_grad():
        torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), share)


def chosen_device(config: TrainingConfig) -> torch.device:
    """Return where to train; raises `UserError` where CUDA is asked for and missing."""
    cuda = torch.cuda.is_available()
    if config.device == "cuda" and not cuda:
        raise UserError("device = 'cuda', but torch finds no CUDA device; set device = 'auto'")
    return torch.device("cuda" if cuda and config.device != "cpu" else "cpu")


@contextlib.contextmanager
def _processes(config: TrainingConfig) -> Iterator[tuple[Share, torch.device]]:
    """Join the other processes where torchrun started several; yields this one's share and device."""
    kind = chosen_device(config).type
    world = int(os.environ.get("WORLD_SIZE", "1"))
    if world == 1:
        yield Share(), torch.device(kind)
        return
    local = int(os.environ["LOCAL_RANK"])
    if kind == "cuda":
        torch.cuda.set_device(local)
    torch.distributed.init_process_group("nccl" if kind == "cuda" else "gloo")
    try:
        device = torch.device(kind, local) if kind == "cuda" else torch.device(kind)
        yield Share(torch.distributed.get_rank(), world), device
    finally:
        torch.distributed.destroy_process_group()


@contextlib.contextmanager
def _stop_asked() -> Iterator[threading.Event]:
    """Yield what Ctrl-C sets, so that a training stops between two steps; a second one ends it at once."""
    asked = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def stop(*_: object) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    signal.signal(signal.SIGINT, stop)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _memory_told(config: TrainingConfig, number: int) -> Iterator[None]:
    """Turn a lack of GPU memory into a `UserError` that names the key to lower."""
    try:
        yield
    except torch.cuda.OutOfMemoryError as error:
        stage = config.stages[number]
        raise UserError(
            f"the GPU's memory does not hold stages[{number}] with batch = {stage.batch} and size = {stage.size}: "
            f"lower batch or size, or set precision = 'bf16' ({str(error).splitlines()[0]})"
        ) from None


def _check_finite(losses: Tensor, batch: Batch, step: int) -> None:
    wrong = ~torch.isfinite(losses.detach())
    if not wrong.any():
        return
    tensors = (batch.composite, batch.background, batch.depth, batch.target, batch.mask)
    bad_input = torch.stack([~torch.isfinite(t).flatten(1).all(1) for t in tensors]).any(0)
    if bad_input.any():
        raise UserError(f"step {step}: NaN or infinite pixels in the data: {batch.names(bad_input)}")
    raise UserError(
        f"step {step}: the loss is not finite, though the data are; lower the learning rate; samples: "
        f"{batch.names(wrong)}"
    )


def _use_bf16(config: TrainingConfig, device: torch.device) -> bool:
    if config.precision == "auto":
        return device.type == "cuda" and torch.cuda.is_bf16_supported()
    return config.precision == "bf16"


def remove_run(config: TrainingConfig) -> None:
    """Remove what a training writes, and nothing else."""
    for name in ("checkpoints", "tensorboard", "samples"):
        shutil.rmtree(config.out / name, ignore_errors=True)
    (config.out / FINISHED).unlink(missing_ok=True)
