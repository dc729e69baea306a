"""Gaussians of a scene: made from views, ordered along curves, splatted, stored."""
