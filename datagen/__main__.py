"""`python -m datagen`: the same as the console script, without the model's commands."""

import sys

from datagen.cli import main

if __name__ == "__main__":
    sys.exit(main())
