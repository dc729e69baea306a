"""From radiance to what is shown: tone curves."""
