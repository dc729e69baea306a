"""The samplers, one for each kind of scene."""
