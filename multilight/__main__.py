"""The command line, `multilight` or `python -m multilight`: the generator's commands and the model's."""

import sys

from multilight.datagen import cli as generator
from multilight.model import cli as learner


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(generator.main(commands=generator.COMMANDS | learner.COMMANDS))


if __name__ == "__main__":
    main()
