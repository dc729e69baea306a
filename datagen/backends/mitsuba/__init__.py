"""Mitsuba 3 as a backend: the only room for `mitsuba` and `drjit`."""

from multilight.datagen.backends.machine.mitsuba_variant import choose_variant, prepare_environment

CHOICE = choose_variant()
if CHOICE.variant is None:
    raise ImportError(CHOICE.why)
prepare_environment(CHOICE)

import mitsuba  # noqa: E402

mitsuba.set_variant(CHOICE.variant)

from multilight.datagen.backends.mitsuba.backend import MitsubaBackend  # noqa: E402

__all__ = ["CHOICE", "MitsubaBackend"]
