"""Gaussians of a scene: rendering as a sparse product, and refinement on views."""
