"""Mitsuba 3 as a backend: the only room for `mitsuba` and `drjit`."""

from typing import TYPE_CHECKING

from multilight.datagen.backends.machine.variants import choose_variant, prepare_environment

CHOICE = choose_variant()
prepare_environment(CHOICE)

import mitsuba  # noqa: E402

mitsuba.set_variant(CHOICE.variant)

# The other variants' kernels are made of arrays that the scalar variant has not.
if TYPE_CHECKING or CHOICE.variant != "scalar_rgb":
    from multilight.datagen.backends.mitsuba.backend import MitsubaBackend
else:
    from multilight.datagen.backends.mitsuba.scalar import ScalarBackend as MitsubaBackend

__all__ = ["CHOICE", "MitsubaBackend"]
