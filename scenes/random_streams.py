"""Independent random streams: every draw is keyed by (dataset seed, scene index, attempt, stage); and common draws."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Self, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike
from pydantic import model_validator

from multilight.scenes.frozen import Settings

Rng = np.random.Generator
K = TypeVar("K")
"""What is drawn."""


@dataclass(frozen=True)
class Streams:
    """Hands out generators that depend on nothing but their key, so order and worker count change no scene.

    `attempt` counts the draws of this scene that were thrown away because a check failed.
    """

    seed: int
    scene: int
    attempt: int = 0

    def __call__(self, stage: str) -> Rng:
        """Return a fresh generator for a stage such as `placement` or `placement/3`."""
        key = zlib.crc32(stage.encode())
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence([self.seed, self.scene, self.attempt, key])))


def generator_of(name: str) -> Rng:
    """Return the generator that goes with a name, always in the same state."""
    return np.random.Generator(np.random.PCG64(zlib.crc32(name.encode())))


def pick(rng: Rng, choices: Sequence[K], weights: ArrayLike | None = None) -> K:
    """Draw one of several things, each as likely as the others, or in proportion to its weight."""
    if weights is None:
        return choices[int(rng.integers(len(choices)))]
    return choices[int(rng.choice(len(choices), p=np.asarray(weights) / np.sum(weights)))]


def log_uniform(rng: Rng, low: float, high: float) -> float:
    """Draw between two positive numbers, evenly in their logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def weighted_pick(rng: Rng, weights: Mapping[K, float]) -> K:
    """Draw a key with a probability in proportion to its weight."""
    return pick(rng, list(weights), list(weights.values()))


def pick_at(place: float, weights: Mapping[K, float]) -> K:
    """Return the key on which `place` in [0, 1) falls when the weights are laid end to end."""
    rest = place * sum(weights.values())
    for key, weight in weights.items():
        if rest < weight:
            return key
        rest -= weight
    return next(key for key, weight in reversed(list(weights.items())) if weight > 0)


class Weights(Settings, Generic[K]):
    """How often each of several kinds comes, relative to the others: a field each, not all of them 0."""

    @model_validator(mode="after")
    def _some_weight(self) -> Self:
        if not sum(self.weights().values()) > 0:
            raise ValueError(f"at least one of {', '.join(type(self).model_fields)} needs a share above 0")
        return self

    def weights(self) -> dict[K, float]:
        """Return the weight of each kind."""
        return cast(dict[K, float], self.model_dump())

    def draw(self, rng: Rng) -> K:
        """Draw a kind."""
        return weighted_pick(rng, self.weights())

    def at(self, place: float) -> K:
        """Return the kind at `place` in [0, 1) of the whole."""
        return pick_at(place, self.weights())
