"""Synthetic multi-light data: scenes rendered once, light by light, mixed later; and a model that learns from them.

The folders `scenes`, `lights`, `datagen` and `model` of the repository are this package's own, through links.
"""
