"""Mitsuba 3 as a backend: the only room for `mitsuba` and `drjit`."""

from datagen.backends.variants import choose_variant, prepare_environment

CHOICE = choose_variant()
prepare_environment(CHOICE)

import mitsuba  # noqa: E402

mitsuba.set_variant(CHOICE.variant)

from datagen.backends.mitsuba.backend import MitsubaBackend  # noqa: E402

__all__ = ["CHOICE", "MitsubaBackend"]
