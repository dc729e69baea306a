"""Output folders and files that a user names: locks, and looks before the work."""
