"""Mitsuba where only its scalar variant runs (no GPU, no LLVM): light by light, with its built-in plugins.

Slower than the vectorized variants: a render for each light and each removed object. Lights agree with them within
noise; what looks different:

- Surfaces are Mitsuba's `principled`: Disney's diffuse lobe instead of Lambert's (about 4 % brighter plastics), no
  light restored that rough metal loses to multiple scattering (6 % darker at roughness 0.5), and a clear coat with
  longer tails over an undimmed base (up to 15 % brighter). Without any specular lobe they are Lambertian here too.
- A spot's size is made of a few points; a lamp with a profile has none. Closed glowing parts shine outwards only.
- Random numbers are not stratified, so that noise is higher at equal samples.
- On partly see-through objects (not cut-outs) the foreground's share of samples is drawn apart from the picture's,
  so that some of what lies behind shows in it.
"""

from multilight.datagen.backends.mitsuba.scalar.backend import ScalarBackend

__all__ = ["ScalarBackend"]
