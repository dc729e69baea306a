"""How work tells of its progress, whoever shows it."""

from typing import Protocol


class Report(Protocol):
    """Called now and then with how much is done of how much, and a word on what is going on."""

    def __call__(self, done: float, total: float, note: str = "") -> None:
        """Take in where the work is; `note` stays until another one is given."""


def silent(done: float, total: float, note: str = "") -> None:
    """Show nothing."""
