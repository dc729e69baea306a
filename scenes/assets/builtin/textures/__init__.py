"""Procedural textures: surfaces, patterns, grounds, screens, gobos."""
