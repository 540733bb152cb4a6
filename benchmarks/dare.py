"""Run the planners of DARE's Table I with other scanners.

    python benchmarks/dare.py --maps DIR [--episodes 100] [--scanners ariadne bare]

`jexplore reproduce dare` has the scanner of DARE's public code.
"""

import argparse

from jexplore.studies.dare.rules import SCANNERS
from jexplore.studies.dare.table import MAPS, reproduce_dare


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", required=True, help="folder of 1.png to 100.png")
    parser.add_argument("--episodes", type=int, default=MAPS, help="number of maps")
    parser.add_argument("--scanners", nargs="+", choices=tuple(SCANNERS), default=["ariadne", "bare"])
    options = parser.parse_args()
    for scanner in options.scanners:
        print(f"scanner {scanner}\n")
        print(reproduce_dare(options.maps, episodes=options.episodes, scanner=scanner).to_markdown())


if __name__ == "__main__":
    main()
