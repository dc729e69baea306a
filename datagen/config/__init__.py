"""The configuration of a dataset: its fields, named presets, and the table that shows them."""
