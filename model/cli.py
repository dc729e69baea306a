"""The model's commands, by name; nothing here imports torch before a command runs."""

COMMANDS: dict[str, type] = {}
"""Each command's name and its options, as a dataclass whose `run` returns the exit code."""
