"""Configurations of trainings: their fields here, presets as TOML beside them."""
