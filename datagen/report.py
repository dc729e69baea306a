"""How work tells of its progress and of what happens, whoever shows it or writes it down."""

import logging
from typing import Protocol

LOG = logging.getLogger("multilight")
"""Where `event` writes; silent until a handler is added."""


class Report(Protocol):
    """Called now and then with how much is done of how much, and a word on what is going on."""

    def __call__(self, done: float, total: float, note: str = "") -> None:
        """Take in where the work is; `note` stays until another one is given."""


def silent(done: float, total: float, note: str = "") -> None:
    """Show nothing."""


def event(name: str, **about: object) -> None:
    """Write down that something happened, where a log was asked for."""
    LOG.info(name, extra={"about": about})
