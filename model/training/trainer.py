"""What the trainings of both stages have in common: by steps or by the clock, resumable, stopped between two steps."""

import contextlib
import copy
import shutil
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from multilight.datagen.errors import UserError
from multilight.datagen.report import Report, silent
from multilight.datagen.text import duration, size
from multilight.model.configs.checks import check_start
from multilight.model.configs.stage2d import TrainingConfig
from multilight.model.networks.checkpoint import (
    Progress,
    load_checkpoint,
    newest_checkpoint,
    save_checkpoint,
    save_network,
)
from multilight.model.training.batches import ALONE, Batch, Process
from multilight.model.training.losses import CompositingLoss
from multilight.model.training.monitor import Log, regional_psnr, sample_sheet
from multilight.model.training.optimization import average_into, learning_rate, make_optimizer

FINISHED = "model.safetensors"

Sample = TypeVar("Sample", bound=Batch)
Images = dict[str, Tensor]


class Trainer(ABC, Generic[Sample]):
    """A training in one process: network, its average, optimizer, and how far it is."""

    config: TrainingConfig
    network: nn.Module

    def __init__(self, config: TrainingConfig, device: torch.device, process: Process = ALONE) -> None:
        """Make the network; goes on from the newest checkpoint in `config.out`, where there is one."""
        check_start(config)
        self.config, self.device, self.process = config, device, process
        torch.manual_seed(config.seed)
        self.network = self._make_network().to(device)
        self.average = copy.deepcopy(self.network).requires_grad_(False).eval()
        self.optimizer = make_optimizer(self.network, config)
        self.loss = CompositingLoss(config.loss).to(device)
        self.stage = 0
        self.checkpoints = config.out / "checkpoints"
        self.progress = Progress()
        self._show: Report = silent
        if path := newest_checkpoint(self.checkpoints):
            self.progress = load_checkpoint(
                path, config, model=self.network, average=self.average, optim=self.optimizer
            )

    @abstractmethod
    def _make_network(self) -> nn.Module:
        """Make the network, untrained or with the weights to learn on from."""

    @abstractmethod
    def _validation(self) -> Iterable[Sample]:
        """Open what is validated on, in the first process only; empty for no validation."""

    @abstractmethod
    def _next_sample(self, done: float) -> Sample:
        """Return what the next step learns from, `done` of the training being done."""

    @abstractmethod
    def _losses(self, sample: Sample) -> dict[str, Tensor]:
        """Return figures to log, of each picture or of all together; their mean "loss" is minimized."""

    @abstractmethod
    def _images(self, sample: Sample) -> Images:
        """Return what is compared with the target in validation, by name, the network's own last."""

    def done(self) -> float:
        """Return the fraction of the training that is done, in [0, 1]; equal in all processes."""
        if self.config.steps is not None:
            return min(1.0, self.progress.step / self.config.steps)
        assert self.config.minutes is not None
        done = torch.tensor(min(1.0, self.progress.seconds / (60.0 * self.config.minutes)), dtype=torch.float64)
        if self.process.world > 1:
            done = done.to(self.device)
            torch.distributed.broadcast(done, src=0)
        return float(done)

    def run(self, report: Report = silent) -> dict[str, float]:
        """Train to the end, write the averaged weights and return the last validation [dB].

        `report` is told of steps, as many as there will be at the present rate where the training goes by the clock.
        """
        log = Log(self.config.out, quiet=self.process.rank > 0)
        self._show = report
        parameters = sum(p.numel() for p in self.network.parameters())
        log.line(
            f"training {parameters / 1e6:.2f} M parameters on {self.device.type}, "
            f"loss {self.config.loss.pixels} + {self.loss.label}, from step {self.progress.step}"
        )
        try:
            validation = self._validation() if self.process.rank == 0 else ()
            self._tell("training")
            with _stop_asked() as asked:
                self._steps(log, validation, asked)
            if asked.is_set():
                self._save(log, ())
                raise KeyboardInterrupt
            found = self._save(log, validation)
        finally:
            log.close()
        if self.process.rank == 0:
            save_network(self.config.out / FINISHED, self._finished(), self.config.network, self._about(found))
            log.line(
                f"{self.config.out / FINISHED}: {size((self.config.out / FINISHED).stat().st_size)}, "
                f"{self.progress.step} steps in {duration(self.progress.seconds)}, {_in_words(found)}"
            )
        return found

    def _steps(self, log: Log, validation: Iterable[Sample], asked: threading.Event) -> None:
        started, logged = time.monotonic(), self.progress
        before = self.progress.seconds
        while (done := self.done()) < 1.0 and not asked.is_set():
            figures = self._step(done)
            self.progress = Progress(self.progress.step + 1, before + time.monotonic() - started)
            self._tell()
            if self.progress.step % self.config.log_every == 0:
                self._report(log, figures, logged)
                logged = self.progress
            if self.progress.step % self.config.save_every == 0:
                self._save(log, validation)

    def _step(self, done: float) -> dict[str, Tensor | float]:
        """Take one step and return its figures."""
        step, rate = self.progress.step, learning_rate(self.config, self.progress.step, done)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        sample = self._next_sample(done)
        self.network.train()
        self.optimizer.zero_grad(set_to_none=True)
        try:
            losses = self._losses(sample)
            _check_finite(losses["loss"], sample, step)
            losses["loss"].mean().backward()
        except torch.cuda.OutOfMemoryError as error:
            stage = self.config.stages[self.stage]
            raise UserError(
                f"the GPU's memory does not hold stages[{self.stage}] with batch = {stage.batch} and size = "
                f"{stage.size}: lower batch or size, or set precision = 'bf16' ({str(error).splitlines()[0]})"
            ) from None
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        if not torch.isfinite(norm):
            raise UserError(
                f"step {step}: the gradient is {float(norm)}; lower learning_rate = {self.config.learning_rate}; "
                f"samples: {sample.names()}"
            )
        self.optimizer.step()
        average_into(self.average, self.network, self.config.ema, step)
        return {**{name: value.mean().detach() for name, value in losses.items()}, "norm": norm, "rate": rate}

    def _report(self, log: Log, figures: dict[str, Tensor | float], since: Progress) -> None:
        now, stage = self.progress, self.config.stages[self.stage]
        rate = (now.step - since.step) * stage.batch / max(now.seconds - since.seconds, 1e-9)
        values = {name: float(value) for name, value in figures.items()} | {"pictures_s": rate}
        log.scalars({f"train/{name}": value for name, value in values.items()}, now.step)
        self._tell(f"training, loss {values['loss']:.4f}")

    def _tell(self, note: str = "") -> None:
        step, seconds, minutes = self.progress.step, self.progress.seconds, self.config.minutes
        total = self.config.steps or round(step * max(60.0 * (minutes or 0.0) / seconds, 1.0) if seconds else step)
        self._show(step, total, note)

    def _save(self, log: Log, validation: Iterable[Sample]) -> dict[str, float]:
        """Write a checkpoint; validate and show samples, where there are any."""
        if self.process.rank > 0:
            return {}
        save_checkpoint(
            self.checkpoints, self.config, self.progress, model=self.network, average=self.average, optim=self.optimizer
        )
        self._tell("validating")
        if found := self._validate(log, validation):
            log.scalars({f"validation/{name}": value for name, value in found.items()}, self.progress.step)
            log.line(f"step {self.progress.step}: {_in_words(found)}")
        self._tell("training")
        return found

    @torch.no_grad()
    def _validate(self, log: Log, validation: Iterable[Sample]) -> dict[str, float]:
        """Return mean regional PSNR [dB] over the validation samples by name, and show the first of them."""
        found: dict[str, list[Tensor]] = {}
        for sample in validation:
            images = self._images(sample)
            if not found:
                log.sheet(sample_sheet(sample, list(images.values())[-1]), self.progress.step)
            for name, image in images.items():
                psnr = regional_psnr(image, sample.target, sample.mask, sample.effect)
                found.setdefault(name, []).append(psnr)
        return {name: float(torch.cat(values).mean()) for name, values in found.items()}

    def _finished(self) -> nn.Module:
        """Return the network whose weights are written at the end."""
        return self.average

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


def _in_words(found: Mapping[str, float]) -> str:
    """Say what a validation found [dB], by method; the network is the last."""
    if not found:
        return "without validation"
    first, *_, last = found.values()
    told = ", ".join(f"{name} {value:.2f} dB" for name, value in found.items())
    return f"validation, object and effect: {told} ({last - first:+.2f})"


def remove_run(config: TrainingConfig) -> None:
    """Remove what a training writes, and nothing else."""
    for name in ("checkpoints", "tensorboard", "samples"):
        shutil.rmtree(config.out / name, ignore_errors=True)
    (config.out / FINISHED).unlink(missing_ok=True)


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


def _check_finite(losses: Tensor, sample: Batch, step: int) -> None:
    wrong = ~torch.isfinite(losses.detach())
    if not wrong.any():
        return
    tensors = (sample.composite, sample.background, sample.depth, sample.target, sample.mask)
    bad_input = torch.stack([~torch.isfinite(t).flatten(1).all(1) for t in tensors]).any(0)
    if bad_input.any():
        raise UserError(f"step {step}: NaN or infinite pixels in the data: {sample.names(bad_input)}")
    raise UserError(
        f"step {step}: the loss is not finite, though the data are; lower the learning rate; samples: "
        f"{sample.names(wrong)}"
    )
