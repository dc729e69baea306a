"""Trainings that differ in one thing, and their table."""
