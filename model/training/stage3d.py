"""The training of the 3D stage: one scene a step, on one device, resumable."""

import copy
import time
from collections.abc import Iterator

import torch
from torch import Tensor, nn

from multilight.datagen.errors import UserError
from multilight.datagen.files.outputs import check_folder
from multilight.model.configs.stage3d import SceneTrainingConfig
from multilight.model.networks.checkpoint import (
    Progress,
    load_checkpoint,
    load_network,
    newest_checkpoint,
    save_checkpoint,
    save_network,
)
from multilight.model.networks.compositing3d import harmonize_scene, scene_network
from multilight.model.training.losses import CompositingLoss
from multilight.model.training.monitor import Log, regional_psnr
from multilight.model.training.samples3d import SceneSample, SceneSamples
from multilight.model.training.stage2d import (
    FINISHED,
    average_into,
    chosen_device,
    learning_rate,
    make_optimizer,
    remove_run,
)


class SceneTrainer:
    """A training of the 3D stage: network, its average, optimizer, and how far it is."""

    def __init__(self, config: SceneTrainingConfig, device: torch.device) -> None:
        self.config, self.device = config, device
        torch.manual_seed(config.seed)
        self.stage2d = load_network(config.weights_2d).to(device).requires_grad_(False)
        self.network = scene_network(config.network).to(device)
        self.average = copy.deepcopy(self.network).requires_grad_(False).eval()
        self.optimizer = make_optimizer(self.network, config)
        self.loss = CompositingLoss(config.loss).to(device)
        self.checkpoints = config.out / "checkpoints"
        path = newest_checkpoint(self.checkpoints)
        self.progress = Progress()
        if path is not None:
            self.progress = load_checkpoint(
                path, config, model=self.network, average=self.average, optim=self.optimizer
            )

    def done(self) -> float:
        """Return the share of the training that is done, in [0, 1]."""
        if self.config.steps is not None:
            return min(1.0, self.progress.step / self.config.steps)
        assert self.config.minutes is not None
        return min(1.0, self.progress.seconds / (60.0 * self.config.minutes))

    def run(self) -> dict[str, float]:
        """Train to the end and return the last validation."""
        log = Log(self.config.out)
        parameters = sum(p.numel() for p in self.network.parameters())
        log.line(f"training {parameters / 1e6:.2f} M parameters on {self.device.type}, from step {self.progress.step}")
        samples = SceneSamples(self.config, self.device)
        count = self.config.data.validation_samples
        watched = SceneSamples(self.config, self.device, validation=True) if count else None
        try:
            self._steps(log, samples, watched)
            found = self._save(log, watched)
        finally:
            log.close()
        about = {"made_by": "multilight train", "config": self.config.model_dump_json(exclude={"out"})}
        about |= {"steps": str(self.progress.step), "minutes": f"{self.progress.seconds / 60:.1f}"}
        about["validation_db"] = ", ".join(f"{name} {value:.2f}" for name, value in found.items())
        save_network(self.config.out / FINISHED, self.average, self.config.network, about)
        log.line(f"weights: {self.config.out / FINISHED}")
        return found

    def _steps(self, log: Log, samples: SceneSamples, watched: SceneSamples | None) -> None:
        started, before = time.monotonic(), self.progress.seconds
        while (done := self.done()) < 1.0:
            loss = self._step(samples[self.progress.step], done)
            self.progress = Progress(self.progress.step + 1, before + time.monotonic() - started)
            if self.progress.step % self.config.log_every == 0:
                log.scalars({"train/loss": loss}, self.progress.step)
                log.line(f"step {self.progress.step}  loss {loss:.5f}  {done:.0%} done")
            if self.progress.step % self.config.save_every == 0:
                self._save(log, watched)

    def _step(self, sample: SceneSample, done: float) -> float:
        """Take one step and return the loss: half on the map, half on the views."""
        rate = learning_rate(self.config, self.progress.step, done)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.network.train()
        self.optimizer.zero_grad(set_to_none=True)
        colors, views = harmonize_scene(
            self.network, sample.scene, sample.composite, self._harmonized(sample), sample.background
        )
        on_map = ((colors - sample.scene.carry(sample.target)) ** 2).mean()
        on_views = self.loss(views, sample.target, sample.mask, sample.effect)["loss"].mean()
        loss = 0.5 * on_map + 0.5 * on_views
        if not torch.isfinite(loss.detach()):
            raise UserError(f"step {self.progress.step}: the loss is not finite; lower learning_rate; {sample.name}")
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip)
        self.optimizer.step()
        average_into(self.average, self.network, self.config.ema, self.progress.step)
        return float(loss.detach())

    @torch.no_grad()
    def _harmonized(self, sample: SceneSample) -> Tensor:
        return self.stage2d(sample.composite, sample.background, sample.depth, sample.mask)

    def _save(self, log: Log, watched: SceneSamples | None) -> dict[str, float]:
        """Write a checkpoint and validate, where there is anything to validate on."""
        save_checkpoint(
            self.checkpoints, self.config, self.progress, model=self.network, average=self.average, optim=self.optimizer
        )
        if watched is None:
            return {}
        found = self._validate(watched[number] for number in range(self.config.data.validation_samples))
        log.scalars({f"validation/{name}": value for name, value in found.items()}, self.progress.step)
        shown = ", ".join(f"{name} {value:.2f} dB" for name, value in found.items())
        log.line(f"step {self.progress.step}  validation, object and effect: {shown}")
        return found

    @torch.no_grad()
    def _validate(self, samples: Iterator[SceneSample]) -> dict[str, float]:
        """Return mean regional PSNR [dB] of composite, 2D stage and 3D stage over the validation samples."""
        found: dict[str, list[Tensor]] = {"composite": [], "2D": [], "3D": []}
        for sample in samples:
            harmonized = self._harmonized(sample)
            _, views = harmonize_scene(self.average, sample.scene, sample.composite, harmonized, sample.background)
            for name, image in zip(found, (sample.composite, harmonized, views), strict=True):
                found[name].append(regional_psnr(image, sample.target, sample.mask, sample.effect))
        return {name: float(torch.cat(values).mean()) for name, values in found.items()}


def train_scenes(config: SceneTrainingConfig, *, fresh: bool = False) -> dict[str, float]:
    """Train the 3D stage, and write the averaged weights to `model.safetensors`; returns the last validation.

    Goes on from the newest checkpoint in `config.out`, unless `fresh`. Raises `UserError` for weights or data that
    cannot be read and for a loss that is not finite.
    """
    check_folder(config.out)
    if fresh:
        remove_run(config)
    return SceneTrainer(config, chosen_device(config)).run()
