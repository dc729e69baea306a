"""Captures of many views, as COLMAP and nerfstudio read them."""
