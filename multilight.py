"""The front door: the console script `multilight`."""

import sys

from datagen import cli


def main() -> None:
    """Run the command line and exit with its code."""
    sys.exit(cli.main())


if __name__ == "__main__":
    main()
