"""How weights move: the optimizer, its learning rate, and their average; and in which arithmetic."""

import contextlib
import math
from collections.abc import Iterator

import torch
from torch import nn
from torch.optim import AdamW, Optimizer

from multilight.model.configs.stage2d import TrainingConfig


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
    fraction = 1.0 - min(decay, (1 + step) / (10 + step))
    with torch.no_grad():
        torch._foreach_lerp_(list(average.parameters()), list(network.parameters()), fraction)


@contextlib.contextmanager
def denormals_as_zero() -> Iterator[None]:
    """Take floats below 1e-38 as zero: a trained network's gradients hold many, each as dear as a hundred others.

    Of processors that can; for this thread, and for those that are started inside. Afterwards it is off, as by default.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
