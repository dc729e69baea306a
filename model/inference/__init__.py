"""The model at use on one's own pictures."""
