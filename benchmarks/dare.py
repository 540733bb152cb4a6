"""Run the planners of DARE's Table I with a scanner that shows only the cells of a beam.

    python benchmarks/dare.py --maps DIR [--episodes 100]

`jexplore reproduce dare` has the scanner of the public code, which also enters the cells round it.
"""

import argparse

from jexplore.studies.dare.table import MAPS, reproduce_dare


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", required=True, help="folder of 1.png to 100.png")
    parser.add_argument("--episodes", type=int, default=MAPS, help="number of maps")
    options = parser.parse_args()
    print(reproduce_dare(options.maps, episodes=options.episodes, wide=False).to_markdown())


if __name__ == "__main__":
    main()
