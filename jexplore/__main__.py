"""`python -m jexplore`."""

import sys

from jexplore.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
