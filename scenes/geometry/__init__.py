"""Geometry of placed meshes: rays, support, contact, overlap."""
