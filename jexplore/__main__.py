"""`python -m jexplore`."""

import sys

from jexplore.cli import main

if __name__ == "__main__":
    sys.exit(main())
