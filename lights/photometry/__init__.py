"""Arithmetic on light: colour, radiometry, irradiance, luminaire profiles, angles."""
