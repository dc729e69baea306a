"""The root of this project's errors: the command line prints them as one line, all others are its own faults."""


class MultilightError(Exception):
    """Something is not as it must be; the message names the value or the file, what is allowed, and the remedy."""
