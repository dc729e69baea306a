"""Mitsuba where only its scalar variant runs (no GPU, no LLVM): light by light, with its built-in plugins.

Slower by far, and not the same picture as the vectorized variants': surfaces are Mitsuba's `principled` (Disney's
diffuse lobe, which brightens towards grazing angles on rough surfaces, and its weaker-tailed clear coat; surfaces
without any specular lobe are Lambertian as there), emission is one-sided on closed parts, a spot's and a profiled
lamp's size is made of a few points, and random numbers are not stratified, so that noise is higher at equal samples.
"""

from datagen.backends.mitsuba.scalar.backend import ScalarBackend

__all__ = ["ScalarBackend"]
