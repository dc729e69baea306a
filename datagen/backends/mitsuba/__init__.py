"""Mitsuba 3 as a backend: the only room for `mitsuba` and `drjit`."""

from typing import TYPE_CHECKING

from datagen.backends.variants import choose_variant, prepare_environment

CHOICE = choose_variant()
prepare_environment(CHOICE)

import mitsuba  # noqa: E402

mitsuba.set_variant(CHOICE.variant)

# The other variants' kernels are made of arrays that the scalar variant has not.
if TYPE_CHECKING or CHOICE.variant != "scalar_rgb":
    from datagen.backends.mitsuba.backend import MitsubaBackend
else:
    from datagen.backends.mitsuba.scalar import ScalarBackend as MitsubaBackend

__all__ = ["CHOICE", "MitsubaBackend"]
