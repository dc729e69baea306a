"""Rigs of lights, drawn for each kind of scene."""
