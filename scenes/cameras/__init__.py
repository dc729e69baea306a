"""Cameras: the pinhole, paths, trajectories and close-ups."""
