"""Which pictures of a dataset models are compared on; imports no torch."""

from dataclasses import dataclass

from multilight.model.configs.stage2d import Lighting
from multilight.scenes.assets.splits import Split


@dataclass(frozen=True)
class CaseSettings:
    """Which pictures of a dataset: the same ones whenever these are the same."""

    splits: tuple[Split, ...] = ("test", "test_ood")
    """Splits to evaluate on; each is a subset of the tables."""
    groups: int = 32
    """Most objects a split, each under one pair of lightings."""
    views: int = 4
    """Most views of a scene that show an object under one lighting; what is averaged over views has no more."""
    seed: int = 0
    """Seed of the order and the lightings."""
    size: int = 256
    """Side of the pictures in pixels."""
    lighting: Lighting = "random"
    """Lighting: drawn as in training, wild (in saturated colours), or two of the scene's stored conditions."""
    variants: bool = False
    """Compare also on the same objects lit rightly already, and with each of the faults that users' inputs have; each
    is a subset of its own, which counts in no other."""
