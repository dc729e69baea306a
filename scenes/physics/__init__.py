"""Exact contact between meshes, and physics that lets things fall into place."""
