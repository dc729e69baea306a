"""The front door: the console script `multilight`, which joins the generator's commands and the model's."""

import sys

import datagen.cli
import model.cli


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(datagen.cli.main(commands=datagen.cli.COMMANDS | model.cli.COMMANDS))


if __name__ == "__main__":
    main()
