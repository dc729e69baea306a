"""Independent random streams: every draw is keyed by (dataset seed, scene index, attempt, stage)."""

import zlib
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Streams:
    """Hands out generators that depend on nothing but their key, so order and worker count change no scene.

    `attempt` counts the draws of this scene that were thrown away because a check failed.
    """

    seed: int
    scene: int
    attempt: int = 0

    def __call__(self, stage: str) -> np.random.Generator:
        """Return a fresh generator for a stage such as `placement` or `placement/3`."""
        key = zlib.crc32(stage.encode())
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence([self.seed, self.scene, self.attempt, key])))
