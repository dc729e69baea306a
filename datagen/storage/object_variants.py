"""The variants of a view: the whole scene, the scene without an object, an object alone; and how they are named."""

from collections.abc import Iterable
from typing import Self

RAW = "raw_"
"""Stands before the name of a variant as it was rendered, where the denoised one is kept beside it."""


class Variant(str):
    """A variant by its name in jobs, records and files: `all`, `without_<object>` or `foreground_<object>`."""

    __slots__ = ()

    @classmethod
    def without(cls, name: str) -> Self:
        """Return the variant in which an object is removed for good: no shadow, no reflection."""
        return cls(f"without_{name}")

    @classmethod
    def foreground(cls, name: str) -> Self:
        """Return the variant of what the camera sees of an object, as lit in the whole scene."""
        return cls(f"foreground_{name}")

    @property
    def action(self) -> str:
        """`all`, `without` or `foreground`."""
        return self.partition("_")[0]

    @property
    def object(self) -> str:
        """The object's name; empty for `all`."""
        return self.partition("_")[2]


ALL = Variant("all")


def variants_of(objects: Iterable[str]) -> list[Variant]:
    """List the variants of a scene with these insertable objects."""
    return [ALL, *(make(name) for name in objects for make in (Variant.without, Variant.foreground))]
